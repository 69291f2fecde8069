// Training of networks that remember, on a sheet of waves: they learn on their own answers, go on exactly after an
// interruption, and their bundles do what the trainer saw.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "common/base/error.hpp"
#include "services/superres/engine.hpp"
#include "services/superres/training/remembering.hpp"
#include "services/superres/training/trainer.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/superres/example_dataset.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using test::error_of;
using testing::HasSubstr;

void quiet(const std::string&) {}

class HistoryTraining : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override { write_example_dataset(folder_, example_master(), false); }

  TrainConfig config(const std::string& output = "out") const {
    TrainConfig c;
    c.name = "waves";
    c.dataset = folder_.string();
    c.output = (temporary_.path() / output).string();
    c.representation = "vertex_features";
    c.window = 3;
    c.patch = 0;
    c.losses.kinematic = 0;
    c.history.frames = 3;
    c.history.share = 0.5;
    c.validation.every_frames = 2;
    c.batch = 2;
    c.steps_per_epoch = 4;
    c.threads = 1;
    c.device = "cpu";
    c.checkpoint_minutes = 0;
    c.optimizer.learning_rate = 5e-3;
    c.optimizer.beta2 = 0.99;
    c.schedule.kind = "constant";
    if (std::string(GetParam()) == "tokens") {
      c.architecture = complete({"tokens", R"({"features": 8, "heads": 2, "hidden": 16, "blocks": 1, "history": 2})"});
      c.epochs = 4;
    } else {
      c.architecture =
          complete({"published", R"({"features": 8, "heads": 2, "hidden": 16, "blocks": 1, "latent": 6})"});
      c.vertex_features.answer = "features_alone";
      c.vertex_features.normalization = "range";
      c.vertex_features.passes = 0;
      c.losses.codes = 1;
      c.autoencoders.epochs = 2;
      c.epochs = 4;
    }
    return c;
  }

  static std::vector<std::string> rows(const std::string& file) {
    std::ifstream in(file);
    std::vector<std::string> result;
    for (std::string line; std::getline(in, line);) {
      const auto second = line.find(',', line.find(',') + 1), third = line.find(',', second + 1);
      result.push_back(line.substr(0, second) + line.substr(third));  // without minutes
    }
    return result;
  }

  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path() / "data";
};

TEST_P(HistoryTraining, ResumedTrainingHasTheSameCurve) {
  const TrainConfig whole = config("whole"), parts = config("parts");
  const LoadedPairs pairs = load_pairs(whole, quiet);
  const TrainResult result = train(whole, pairs.data, pairs.judge.get(), {});
  EXPECT_EQ(result.reason, StopReason::kEpochs);
  for (const int end : {3, 11}) {  // in the middle of an epoch, with and without autoencoders in training
    std::atomic<bool> stop{false};
    int steps = 0;
    TrainHooks hooks;
    hooks.stop = &stop;
    hooks.progress = [&](int epoch, double fraction, double) {
      steps = 4 * (epoch - 1) + static_cast<int>(std::lround(4 * fraction));
      if (steps == end) stop = true;
    };
    EXPECT_EQ(train(parts, pairs.data, pairs.judge.get(), hooks).reason, StopReason::kStopped);
  }
  EXPECT_EQ(train(parts, pairs.data, pairs.judge.get(), {}).reason, StopReason::kEpochs);
  EXPECT_EQ(rows(parts.output + "/log.csv"), rows(whole.output + "/log.csv"));
  EXPECT_EQ(rows(whole.output + "/log.csv").size(), 5U);
}

/// Frame after frame through the bundle, each with what the one before left, is what the trainer validated.
TEST_P(HistoryTraining, TheBundleDoesWhatTheTrainerSaw) {
  TrainConfig c = config();
  c.epochs += 2;
  const LoadedPairs pairs = load_pairs(c, quiet);
  const TrainResult result = train(c, pairs.data, pairs.judge.get(), {});
  ASSERT_FALSE(result.bundle.empty());
  EXPECT_GT(result.best.epoch, c.autoencoders.epochs) << "autoencoders alone answer nothing";
  EngineOptions options;
  options.folder = c.output;
  options.precision = Precision::kFloat32;
  options.use_cuda = false;
  options.threads = 1;
  Engine engine(options, "waves"), replica(options, "waves");
  const auto constants = engine.take_constants(pairs.data.meshes[0].constants);
  EXPECT_GT(memory_values(engine.describe()), 0U);
  const std::size_t index = pairs.data.sequences[0].validation ? 0 : 1;
  const PairSequence& sequence = pairs.data.sequences[index];
  const ImageStore& input = sequence.input;
  Tensor frames{{input.channels(), input.height(), input.width()}, {}, {}};
  frames.values.resize(static_cast<std::size_t>(input.channels()) * static_cast<std::size_t>(input.width()));
  std::vector<float> memory, left, other;
  double error = 0, count = 0;
  for (std::size_t f = 0; f < input.size(); ++f) {
    input.read(f, 0, 0, input.height(), input.width(), frames.values.data());
    const NetworkInput read{&frames, constants, memory, &left};
    const Tensor answer = engine.upscale(read);
    // A replica goes on with the same bits.
    const NetworkInput again{&frames, constants, memory, &other};
    ASSERT_EQ(replica.upscale(again).values, answer.values);
    ASSERT_EQ(other, left);
    if (f % 2 == 0) error += pairs.judge->squared_error(index, f, answer.values), ++count;
    std::swap(memory, left);
  }
  EXPECT_NEAR(error / count, result.best.vmse_m2, 1e-4 * result.best.vmse_m2);
}

TEST_P(HistoryTraining, LearnsOnItsOwnAnswers) {
  TrainConfig c = config();
  c.steps_per_epoch = 30;
  c.epochs = 8;
  if (c.autoencoders.epochs > 0) c.autoencoders.epochs = 3;
  const LoadedPairs pairs = load_pairs(c, quiet);
  std::vector<double> losses;
  TrainHooks hooks;
  hooks.progress = [&](int epoch, double, double loss) {
    if (epoch > c.autoencoders.epochs) losses.push_back(loss);
  };
  train(c, pairs.data, pairs.judge.get(), hooks);
  ASSERT_GE(losses.size(), 60U);
  double first = 0, last = 0;
  for (std::size_t i = 0; i < 20; ++i) first += losses[i], last += losses[losses.size() - 1 - i];
  EXPECT_LT(last, 0.8 * first);
}

/// A window behind a lead from the sequence's beginning is a piece of the run on the network's own answers.
TEST_P(HistoryTraining, ALongLeadIsTheWholeRun) {
  TrainConfig c = config();
  c.history.share = 1;
  c.history.lead = 50;
  c.autoencoders.epochs = 0;
  const LoadedPairs pairs = load_pairs(c, quiet);
  const PairData& data = pairs.data;
  const Network network(describe(c.architecture, ports_of(data)), 7);
  const Sampler sampler(c, data, network.description().remembered);
  const Remembering remembering(c, network, sampler, torch::kFloat32);
  const torch::NoGradGuard no_grad;
  for (int step = 0; step < 3; ++step) {
    const Batch batch = sampler.batch(0, step);
    ASSERT_TRUE(batch.lead.defined());
    torch::Tensor codes;
    const auto answers = remembering.answers(batch, 0, step, 0, codes);
    std::istringstream windows(sampler.describe(0, step));
    std::string window;
    for (std::int64_t w = 0; std::getline(windows >> std::ws, window, ','); ++w) {
      const auto colon = window.find(':');
      const auto sequence = std::find_if(data.sequences.begin(), data.sequences.end(),
                                         [&](const PairSequence& s) { return s.name == window.substr(0, colon); });
      ASSERT_NE(sequence, data.sequences.end());
      const auto first = static_cast<std::size_t>(std::stoi(window.substr(colon + 1)));
      const auto input = [&](std::size_t f) {
        auto x = batch.input.slice(0, 0, 1).clone();  // with the constants
        sequence->input.read(f, 0, 0, data.height(), data.width(), x.data_ptr<float>());
        return x;
      };
      run_on_own_answers(network, first + 3, torch::kFloat32, input, [&](const torch::Tensor& answer, std::size_t f) {
        if (f < first) return;
        const auto own = answers[3 * w + static_cast<std::int64_t>(f - first)];
        EXPECT_LT((own - answer[0]).abs().max().item<double>(), 1e-5) << window << " + " << f - first;
      });
    }
  }
  // Windows that read true answers have none, nor has a lead of nothing.
  c.history.share = 0;
  EXPECT_FALSE(Sampler(c, data, network.description().remembered).batch(0, 0).lead.defined());
}

TEST_P(HistoryTraining, FramesThatDoNotFollowEachOtherAreRefused) {
  TrainConfig c = config();
  const LoadedPairs pairs = load_pairs(c, quiet);
  c.every_frames = 2;
  EXPECT_THAT(error_of([&] { train(c, pairs.data, pairs.judge.get(), {}); }).what(), HasSubstr("every_frames"));
  c.every_frames = 1;
  c.history.frames = 100;
  EXPECT_THAT(error_of([&] { train(c, pairs.data, pairs.judge.get(), {}); }).what(), HasSubstr("100 frames"));
}

INSTANTIATE_TEST_SUITE_P(Kinds, HistoryTraining, testing::Values("tokens", "published"));

TEST(Autoencoders, NeedEpochs) {
  EXPECT_THAT(error_of([] {
                train_config_from_json(
                    R"({"name": "a", "dataset": "b", "output": "c", "epochs": 3, "autoencoders": {"epochs": 3}})", "f");
              }).what(),
              HasSubstr("autoencoders.epochs"));
}

}  // namespace
}  // namespace pleat::superres
