// The trainer on synthetic waves: it learns them, resumes exactly, and says what is wrong.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/error.hpp"
#include "services/superres/bundle/folder.hpp"
#include "services/superres/engine.hpp"
#include "services/superres/training/checkpoint.hpp"
#include "services/superres/training/log.hpp"
#include "services/superres/training/sampler.hpp"
#include "services/superres/training/trainer.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/superres/example_dataset.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr int kChannels = 9, kHeight = 8, kWidth = 12;
constexpr double kFrameTime = 0.04;

/// A sheet whose coarse image decides its fine detail: waves of twice the frequency where the coarse ones are high.
PairData waves(int sequences, int frames) {
  PairData data;
  data.frame_time_s = kFrameTime;
  data.input_ranges = data.output_ranges = {std::vector<float>(kChannels, -1), std::vector<float>(kChannels, 2), 0};
  data.input_channels = data.answer_channels = frame_channel_names();
  conversion::GeometryImageSpec spec;
  spec.image.coarse_width = kWidth, spec.image.coarse_height = kHeight;
  data.representation.kind = spec;
  data.meshes[0].topology_hash = "00000000000000aa";
  data.meshes[0].answer_mask.assign(16 * kHeight * kWidth, 1);
  data.meshes[0].answer_mask[0] = 0;
  data.meshes[0].sheet_axes = {{1, 0, 0}, {0, 0, 1}};
  for (int s = 0; s < sequences; ++s) {
    PairSequence sequence;
    sequence.name = "wave" + std::to_string(s);
    sequence.validation = s == sequences - 1;
    sequence.input = ImageStore(kChannels, kHeight, kWidth, {});
    sequence.answer = ImageStore(kChannels, 4 * kHeight, 4 * kWidth, {});
    for (int f = 0; f < frames; ++f) {
      const auto value = [&](int c, double y, double x, bool detail) {
        const double base = std::sin(0.6 * x + 0.2 * f + s + c) * std::cos(0.4 * y + c);
        return static_cast<float>(0.5 + 0.2 * base + (detail ? 0.03 * (2 * base * base - 1) : 0.0));
      };
      std::vector<float> coarse, fine;
      for (int c = 0; c < kChannels; ++c) {
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) coarse.push_back(value(c, y, x, false));
        }
        for (int y = 0; y < 4 * kHeight; ++y) {
          for (int x = 0; x < 4 * kWidth; ++x) fine.push_back(value(c, (y + 0.5) / 4 - 0.5, (x + 0.5) / 4 - 0.5, true));
        }
      }
      sequence.input.append(coarse);
      sequence.answer.append(fine);
      sequence.rotations.push_back({1, 0, 0, 0, 1, 0, 0, 0, 1});
    }
    data.sequences.push_back(std::move(sequence));
  }
  return data;
}

/// A strip of triangles across the image that no reflection maps to itself; vertices read two texels each.
MeshRead strip() {
  MeshRead read;
  const std::vector<std::array<int, 2>> places{{2, 3}, {20, 4}, {9, 13}, {33, 15}, {5, 26}, {41, 22}};  // column, row
  for (int k = 0; k < 2; ++k) {
    for (const auto& [column, row] : places) {
      read.texels.push_back((row + k) * 4 * kWidth + column);
      read.weights.push_back(k == 0 ? 0.4F : 0.6F);
    }
  }
  for (const auto& [column, row] : places) read.rest.push_back(0.05F * static_cast<float>(column));
  read.rest.resize(2 * places.size(), 0.0F);
  for (const auto& [column, row] : places) read.rest.push_back(0.05F * static_cast<float>(row));
  read.faces = {0, 1, 2, 3, 1, 3, 3, 5, 2, 2, 4, 4};
  read.edges = {0, 1, 0, 1, 2, 2, 3, 3, 4, 1, 2, 2, 3, 3, 4, 4, 5, 5};
  return read;
}

class TrainerTest : public testing::Test {
 protected:
  TrainConfig config(const std::string& output = "out") const {
    TrainConfig c;
    c.name = "waves";
    c.dataset = "none";
    c.output = (root_ / output).string();
    c.architecture =
        complete({"mfsr", R"({"blocks": 1, "layers": 2, "growth": 8, "features": 8, "upsampling": "subpixel"})"});
    c.losses.frames = 2;
    c.losses.scaling = "deviation";
    c.optimizer.learning_rate = 1e-2;
    c.optimizer.beta2 = 0.99;
    c.optimizer.average = 0.9;
    c.schedule.kind = "cosine";
    c.validation.every_frames = 2;
    c.epochs = 4;
    c.batch = 2;
    c.patch = 6;
    c.steps_per_epoch = 6;
    c.threads = 1;
    c.device = "cpu";
    c.checkpoint_minutes = 0;
    return c;
  }

  static std::vector<std::string> rows(const std::string& file) {
    std::ifstream in(file);
    std::vector<std::string> result;
    for (std::string line; std::getline(in, line);) {
      // Minutes differ from run to run: columns are epoch, steps, minutes, ...
      const auto second = line.find(',', line.find(',') + 1), third = line.find(',', second + 1);
      result.push_back(line.substr(0, second) + line.substr(third));
    }
    return result;
  }

  const test::TemporaryFolder temporary_;
  const fs::path root_ = temporary_.path();
};

TEST_F(TrainerTest, LearnsDetailThatInterpolationLacks) {
  const PairData data = waves(3, 12);
  TrainConfig c = config();
  c.epochs = 80;
  c.steps_per_epoch = 20;
  c.mirror = false;
  const TrainResult result = train(c, data, nullptr, {});
  EXPECT_EQ(result.reason, StopReason::kEpochs);
  EXPECT_GT(result.best.psnr_db, result.baseline.plain_psnr_db + 3);
  EXPECT_EQ(result.bundle, c.output + "/waves.pt");

  EngineOptions options;
  options.folder = c.output;
  options.precision = Precision::kFloat32;
  options.use_cuda = false;
  options.threads = 1;
  Engine engine(options, "waves");
  EXPECT_EQ(engine.describe().topology_hash, "00000000000000aa");
  EXPECT_NEAR(engine.describe().metrics.at("psnr_db"), result.best.psnr_db, 1e-9);
  // The written bundle scores what the trainer said.
  double error = 0, count = 0;
  const auto& sequence = data.sequences.back();
  Tensor coarse{{kChannels, kHeight, kWidth}, {}, std::vector<float>(kChannels * kHeight * kWidth)};
  std::vector<float> fine(16 * coarse.values.size());
  for (std::size_t f = 0; f < 12; f += 2) {
    sequence.input.read(f, 0, 0, kHeight, kWidth, coarse.values.data());
    sequence.answer.read(f, 0, 0, 4 * kHeight, 4 * kWidth, fine.data());
    const auto output = engine.upscale({&coarse}).values;
    const std::size_t plane = data.meshes[0].answer_mask.size();
    for (std::size_t i = 0; i < 3 * plane; ++i) {
      if (data.meshes[0].answer_mask[i % plane] != 0) error += std::pow(output[i] - fine[i], 2), count += 1;
    }
  }
  EXPECT_NEAR(-10 * std::log10(error / count), result.best.psnr_db, 0.01);
}

TEST_F(TrainerTest, ResumedTrainingHasTheSameCurve) {
  const PairData data = waves(2, 8);
  TrainConfig whole = config("whole");
  whole.mirror = true;
  train(whole, data, nullptr, {});

  TrainConfig parts = config("parts");
  parts.mirror = true;
  std::atomic<bool> stop{false};
  int steps = 0;
  TrainHooks hooks;
  hooks.stop = &stop;
  hooks.progress = [&](int, double, double) {
    if (++steps == 9) stop = true;  // in the middle of the second epoch
  };
  EXPECT_EQ(train(parts, data, nullptr, hooks).reason, StopReason::kStopped);
  EXPECT_EQ(rows(parts.output + "/log.csv").size(), 2U);
  // What a kill in the third epoch would leave behind: rows that the check-point does not know.
  std::ofstream(parts.output + "/log.csv", std::ios::app) << "3,18,0,0,0,0,0,0,0,0,0,0,0,0,0\n4,2";
  const TrainResult result = train(parts, data, nullptr, {});
  EXPECT_EQ(result.reason, StopReason::kEpochs);
  EXPECT_EQ(rows(parts.output + "/log.csv"), rows(whole.output + "/log.csv"));
  EXPECT_EQ(rows(parts.output + "/log.csv").size(), 5U);

  // A third start has nothing left to do.
  EXPECT_EQ(train(parts, data, nullptr, {}).reason, StopReason::kEpochs);
  EXPECT_EQ(rows(parts.output + "/log.csv").size(), 5U);
}

TEST_F(TrainerTest, OtherConfigurationOrDataOrDamagedCheckpointIsRefused) {
  const PairData data = waves(2, 6);
  TrainConfig c = config();
  c.epochs = 1;
  train(c, data, nullptr, {});
  const auto refused = [&](const PairData& pairs, ErrorCode code, const char* part) {
    const Error error = pleat::test::error_of([&] { train(c, pairs, nullptr, {}); });
    EXPECT_EQ(error.code(), code) << error.what();
    EXPECT_THAT(error.what(), HasSubstr(part));
  };
  c.batch = 3;
  refused(data, ErrorCode::kFailedPrecondition, "'batch'");
  c.batch = 2;
  // The data set has grown, which may also change its normalisation.
  refused(waves(3, 6), ErrorCode::kFailedPrecondition, "'data/sequences/wave2'");
  PairData wider = data;
  wider.output_ranges.scale[4] = 3;
  refused(wider, ErrorCode::kFailedPrecondition, "'data/output/scale/4'");
  const auto path = c.output + "/checkpoint.pt";
  fs::resize_file(path, fs::file_size(path) / 2);
  refused(data, ErrorCode::kDataLoss, "checkpoint.pt");
}

TEST_F(TrainerTest, FilesOfOthersInTheOutputFolderAreNamedAndStay) {
  const PairData data = waves(2, 4);
  for (const char* name : {"waves.pt", "log.csv", "log.html"}) {
    TrainConfig c = config(name);
    const fs::path file = fs::path(c.output) / name;
    fs::create_directories(c.output);
    std::ofstream(file) << "mine";
    const Error error = pleat::test::error_of([&] { train(c, data, nullptr, {}); });
    EXPECT_EQ(error.code(), ErrorCode::kAlreadyExists);
    EXPECT_THAT(error.what(), HasSubstr(file.string()));
    std::ifstream kept(file);
    EXPECT_EQ(std::string(std::istreambuf_iterator<char>(kept), {}), "mine");
  }
}

TEST_F(TrainerTest, InitialWeightsComeFromAnotherTraining) {
  const PairData data = waves(2, 6);
  TrainConfig first = config("first");
  train(first, data, nullptr, {});
  TrainConfig second = config("second");
  second.initial = first.output + "/checkpoint.pt";
  second.epochs = 1;
  second.steps_per_epoch = 1;
  second.optimizer.learning_rate = 0;
  const double before = train(first, data, nullptr, {}).best.psnr_db;
  EXPECT_GE(train(second, data, nullptr, {}).best.psnr_db, before - 0.5);
}

TEST_F(TrainerTest, NonFiniteLossNamesTheBatch) {
  PairData data = waves(2, 6);
  TrainConfig c = config();
  c.optimizer.learning_rate = 10;
  std::vector<float> bad(9 * 16 * kHeight * kWidth, std::numeric_limits<float>::quiet_NaN());
  auto& sequence = data.sequences.front();
  ImageStore answer(kChannels, 4 * kHeight, 4 * kWidth, {});
  for (int i = 0; i < 6; ++i) answer.append(bad);
  sequence.answer = answer;
  try {
    train(c, data, nullptr, {});
    FAIL() << "went on";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("not finite"));
    EXPECT_THAT(error.what(), HasSubstr("wave0:"));
  }
}

/// A rate at which a difference by rounding stays one.
constexpr double kCalmRate = 1e-3;

TEST_F(TrainerTest, PassesOfFewerWindowsAddUpToTheSameStep) {
  PairData data = waves(2, 8);
  // Patches with different numbers of valid texels: their shares have to count.
  for (std::size_t i = 0; i < data.meshes[0].answer_mask.size() / 3; ++i) data.meshes[0].answer_mask[i] = 0;
  TrainConfig whole = config("whole");
  whole.batch = 5;
  whole.optimizer.learning_rate = kCalmRate;
  TrainConfig parts = whole;
  parts.output = config("parts").output;
  parts.micro_batch = 2;
  const TrainResult a = train(whole, data, nullptr, {}), b = train(parts, data, nullptr, {});
  EXPECT_NEAR(b.last.total, a.last.total, 1e-4 * a.last.total);
  EXPECT_NEAR(b.last.kinematic, a.last.kinematic, 1e-3 * a.last.kinematic);
  EXPECT_NEAR(b.last.psnr_db, a.last.psnr_db, 0.01);
}

TEST_F(TrainerTest, PassesAddUpWithLossesOnVertices) {
  PairData data = waves(2, 8);
  data.meshes[0].mesh_read = strip();
  const auto run = [&](const std::string& output, int micro_batch) {
    TrainConfig c = config(output);
    c.batch = 5, c.micro_batch = micro_batch, c.patch = 0, c.mirror = true;
    c.optimizer.learning_rate = kCalmRate;
    c.losses.vertices = 0.5, c.losses.vertex_normals = 0.2, c.losses.edges = 0.01, c.losses.wrinkles = 0.1;
    return train(c, data, nullptr, {});
  };
  const TrainResult a = run("whole", 0), b = run("parts", 2);
  EXPECT_GT(a.last.vertices, 0);
  EXPECT_NEAR(b.last.total, a.last.total, 1e-4 * a.last.total);
  EXPECT_NEAR(b.last.vertices, a.last.vertices, 1e-3 * a.last.vertices);
  EXPECT_NEAR(b.last.vertex_normals, a.last.vertex_normals, 1e-3 * a.last.vertex_normals);
  EXPECT_NEAR(b.last.edges, a.last.edges, 1e-3 * a.last.edges);
  EXPECT_NEAR(b.last.psnr_db, a.last.psnr_db, 0.01);
  const auto logged = read_log(config("whole").output + "/log.csv", 100);
  ASSERT_EQ(logged.size(), 4U);
  EXPECT_NEAR(logged.back().vertices, a.last.vertices, 1e-6 * a.last.vertices);
  EXPECT_NEAR(logged.back().edges, a.last.edges, 1e-6 * a.last.edges);
  EXPECT_GT(a.last.wrinkles, 0);
  EXPECT_NEAR(logged.back().wrinkles, a.last.wrinkles, 1e-6 * a.last.wrinkles);

  data.meshes[0].mesh_read = {};
  EXPECT_THROW(run("none", 0), Error);
}

TEST_F(TrainerTest, LogsFromBeforeTheLossesOnVerticesAreRead) {
  const std::string path = (root_ / "log.csv").string();
  std::ofstream(path) << "epoch,steps,minutes,learning_rate,total,displacement,normal,velocity,kinematic,psnr_db,"
                         "psnr_normal_db,psnr_velocity_db,vmse_m2,rmse_m,best\n1,6,0.5,0.1,2,3,4,5,6,30,31,32,9,3,1\n";
  const auto rows = read_log(path, 9);
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0].psnr_db, 30);
  EXPECT_TRUE(rows[0].best);
  EXPECT_EQ(rows[0].vertices, 0);

  std::ofstream(path) << "epoch,steps,minutes,learning_rate,total,displacement,normal,velocity,kinematic,psnr_db,"
                         "psnr_normal_db,psnr_velocity_db,vmse_m2,rmse_m,best,vertices,vertex_normals,edges\n"
                         "1,6,0.5,0.1,2,3,4,5,6,30,31,32,9,3,1,0.7,0.8,0.9\n";
  const auto later = read_log(path, 9);
  ASSERT_EQ(later.size(), 1U) << "from before the loss on wrinkles";
  EXPECT_EQ(later[0].edges, 0.9);
  EXPECT_EQ(later[0].wrinkles, 0);
}

TEST_F(TrainerTest, CurvesAreInTheLogThePageAndTheBundle) {
  const PairData data = waves(2, 6);
  TrainConfig c = config();
  c.name = "a-wave";
  const TrainResult result = train(c, data, nullptr, {});
  EXPECT_GT(result.last.psnr_normal_db, 12);
  EXPECT_GT(result.last.psnr_velocity_db, 12);
  std::ifstream file(c.output + "/log.html");
  const std::string page((std::istreambuf_iterator<char>(file)), {});
  EXPECT_THAT(page, HasSubstr("Training of a-wave"));
  EXPECT_THAT(page, HasSubstr("<path class=\"line\""));
  EXPECT_THAT(page, testing::Not(HasSubstr("http")));  // nothing comes from elsewhere
  const Metadata metadata = read_metadata(c.output, "a-wave");
  const std::size_t rows = result.best.epoch > 0 ? static_cast<std::size_t>(result.best.epoch) : 0;
  const nlohmann::json curve = nlohmann::json::parse(metadata.training).at("curve");
  ASSERT_EQ(curve.size(), rows);
  EXPECT_NEAR(curve.back().at(2).get<double>(), result.best.psnr_db, 1e-9);
}

TEST_F(TrainerTest, EveryRegisteredNetworkLearns) {
  const PairData data = waves(2, 6);
  for (const std::string& kind : network_kinds()) {
    TrainConfig c = config(kind);
    c.architecture = complete({kind, R"({"blocks": 2, "features": 8})"});
    c.patch = 0;
    c.losses.kinematic = 0;
    c.schedule.kind = "constant";
    c.optimizer.learning_rate = 2e-3;
    c.optimizer.average = 0;
    c.epochs = 12;
    double first = 0;
    TrainHooks hooks;
    hooks.progress = [&](int, double, double loss) { first = first > 0 ? first : loss; };
    if (kind == "published") {  // images are no meshes
      try {
        train(c, data, nullptr, hooks);
        ADD_FAILURE() << "trained without meshes";
      } catch (const Error& error) {
        EXPECT_THAT(error.what(), HasSubstr("needs the meshes"));
      }
      continue;
    }
    const TrainResult result = train(c, data, nullptr, hooks);
    EXPECT_LT(result.last.total, 0.5 * first) << kind;
    EXPECT_EQ(read_metadata(c.output, "waves").architecture.kind, kind);
  }
}

/// Detail in other axes, with constants, from two frames: what reaches the network, and the losses on vertices.
TEST_F(TrainerTest, LearnsDetailFromAWindowAndConstants) {
  PairData data = waves(2, 8);
  conversion::GeometryImageSpec spec;
  spec.layout = conversion::ImageLayout::kDetail;
  spec.image.coarse_width = kWidth, spec.image.coarse_height = kHeight;
  data.representation.kind = spec, data.representation.window = 2;
  data.input_channels = {"strain_uu", "velocity_normal"};
  data.answer_channels = {"detail_along", "detail_across", "detail_normal"};
  data.input_ranges = {{0, 0}, {1, 1}, 6}, data.output_ranges = {{0, 0, 0}, {0.01F, 0.01F, 0.01F}, 0};
  data.meshes[0].constants = {{2, kHeight, kWidth}, {}, std::vector<float>(2 * kHeight * kWidth)};
  for (std::size_t i = 0; i < data.meshes[0].constants.values.size(); ++i)
    data.meshes[0].constants.values[i] = std::sin(0.4F * static_cast<float>(i));
  data.meshes[0].mesh_read = strip();
  struct Turned final : FrameGeometry {
    void axes(std::size_t, std::size_t, Tensor& axes) const override {
      axes = {{9, kHeight, kWidth}, {}, std::vector<float>(9 * kHeight * kWidth, 0.0F)};
      // Along z, x and y.
      for (const std::size_t one : {2U, 3U, 7U}) {
        std::fill_n(axes.values.begin() + static_cast<std::ptrdiff_t>(one) * kHeight * kWidth, kHeight * kWidth, 1.0F);
      }
    }
    void base(std::size_t, std::size_t, Positions& positions) const override {
      const MeshRead read = strip();
      positions = Eigen::Map<const Eigen::Matrix<float, 6, 3>>(read.rest.data());
    }
  };
  data.geometry = std::make_shared<Turned>();
  for (PairSequence& sequence : data.sequences) {
    ImageStore input(4, kHeight, kWidth, {}), answer(3, 4 * kHeight, 4 * kWidth, kUnitDeviation);
    std::vector<float> nine(9 * kHeight * kWidth), answers(9 * 16 * kHeight * kWidth);
    for (std::size_t f = 0; f < sequence.input.size(); ++f) {
      sequence.input.read(f, 0, 0, kHeight, kWidth, nine.data());
      input.append({nine.data(), 4 * kHeight * kWidth});
      sequence.answer.read(f, 0, 0, 4 * kHeight, 4 * kWidth, answers.data());
      for (float& v : answers) v = 4 * (v - 0.5F);
      answer.append({answers.data(), 3 * 16 * kHeight * kWidth});
    }
    sequence.input = input, sequence.answer = answer;
  }
  TrainConfig c = config();
  c.losses.kinematic = 0, c.losses.vertices = 0.5, c.losses.vertex_normals = 0.1, c.losses.edges = 0.01;
  c.patch = 0, c.mirror = true, c.epochs = 30;
  double first = 0;
  TrainHooks hooks;
  hooks.progress = [&](int, double, double loss) { first = first > 0 ? first : loss; };
  const TrainResult result = train(c, data, nullptr, hooks);
  EXPECT_LT(result.last.total, 0.7 * first);
  EXPECT_GT(result.last.vertices, 0);
  EXPECT_EQ(result.last.normal, 0);
  const Metadata m = read_metadata(c.output, "waves");
  EXPECT_EQ(m.constants, 2);
  EXPECT_EQ(ports_of(m).inputs, 6);
  EXPECT_EQ(m.representation.window, 2);
}

TEST_F(TrainerTest, TimeLimitEndsWithABundle) {
  const PairData data = waves(2, 6);
  TrainConfig c = config();
  c.epochs = 1000000;
  c.max_minutes = 0.02;
  const TrainResult result = train(c, data, nullptr, {});
  EXPECT_EQ(result.reason, StopReason::kMinutes);
  EXPECT_TRUE(fs::exists(result.bundle));
}

class SeveralMeshes : public testing::Test {
 protected:
  void SetUp() override { write_two_meshes(temporary_.path() / "data"); }
  TrainConfig config(const std::string& output) const {
    TrainConfig c;
    c.name = "any";
    c.dataset = (temporary_.path() / "data").string();
    c.output = (temporary_.path() / output).string();
    c.serves = "any";
    c.images.layout = "detail", c.images.units = "coarse_edges";
    c.architecture = complete({"mfsr", R"({"blocks": 1, "layers": 2, "growth": 8, "features": 8})"});
    c.losses.kinematic = 0, c.losses.vertices = 0.9, c.losses.edges = 0.1;
    c.losses.scaling = "deviation";
    c.optimizer.learning_rate = 3e-3;
    c.schedule.kind = "constant";
    c.validation.every_frames = 2;
    c.mirror = true;
    c.batch = 5, c.patch = 0, c.epochs = 4, c.steps_per_epoch = 10;
    c.threads = 1, c.device = "cpu", c.checkpoint_minutes = 0;
    return c;
  }
  static LoadedPairs load(const TrainConfig& c) {
    return load_pairs(c, [](const std::string&) {});
  }
  const test::TemporaryFolder temporary_;
};

TEST_F(SeveralMeshes, ShareTheStepsAndEachPassIsOfOne) {
  const TrainConfig c = config("out");
  const LoadedPairs pairs = load(c);
  const Sampler sampler(c, pairs.data);
  std::set<std::size_t> seen;
  bool mixed = false;
  for (int step = 0; step < 6; ++step) {
    const std::vector<int> ends = sampler.passes(0, step, 0, c.batch, 2);
    EXPECT_EQ(ends.back(), c.batch);
    std::set<std::size_t> of_step;
    double texels = 0;
    int first = 0;
    for (const int end : ends) {
      ASSERT_GT(end, first);
      ASSERT_LE(end - first, 2);
      const Batch batch = sampler.batch(0, step, first, end);
      const PairMesh& mesh = pairs.data.meshes[batch.mesh];
      EXPECT_EQ(batch.vertex_base.size(2), mesh.mesh_read.vertex_count());
      EXPECT_EQ(batch.input.size(2), mesh.constants.shape[1]);
      texels += batch.mask.sum().item<double>();
      of_step.insert(batch.mesh);
      first = end;
    }
    EXPECT_EQ(texels, sampler.valid_texels(0, step));
    seen.insert(of_step.begin(), of_step.end());
    mixed |= of_step.size() > 1;
  }
  EXPECT_EQ(seen.size(), 2U);
  EXPECT_TRUE(mixed);
}

TEST_F(SeveralMeshes, AreLearntTogetherAndServedByOneBundle) {
  const TrainConfig c = config("out");
  LoadedPairs pairs = load(c);
  const TrainResult result = train(c, pairs.data, pairs.judge.get(), {});
  EXPECT_GT(result.best.gain_db, 0);
  EngineOptions options;
  options.folder = c.output;
  options.precision = Precision::kFloat32;
  options.use_cuda = false;
  options.threads = 1;
  Engine engine(options, "any");
  EXPECT_TRUE(engine.describe().topology_hash.empty());
  EXPECT_NEAR(engine.describe().metrics.at("gain_db"), result.best.gain_db, 1e-9);
  // What the trainer said is the mean of both sequences' gains, each in its own mesh.
  double gains = 0, count = 0;
  for (std::size_t s = 0; s < pairs.data.sequences.size(); ++s) {
    const PairSequence& sequence = pairs.data.sequences[s];
    if (!sequence.validation) continue;
    const ImageStore& input = sequence.input;
    const auto constants = engine.take_constants(pairs.data.mesh_of(sequence).constants);
    double error = 0, upsampling = 0;
    for (std::size_t f = 0; f < input.size(); f += 2) {
      Tensor frame{{input.channels(), input.height(), input.width()}, {}, {}};
      frame.values.resize(static_cast<std::size_t>(input.channels() * input.height() * input.width()));
      input.read(f, 0, 0, input.height(), input.width(), frame.values.data());
      const Tensor answer = engine.upscale(NetworkInput{&frame, constants});
      error += pairs.judge->squared_error(s, f, answer.values);
      upsampling += pairs.judge->barycentric_squared_error(s, f);
    }
    gains += 10 * std::log10(upsampling / error);
    count += 1;
  }
  EXPECT_EQ(count, 2);
  EXPECT_NEAR(gains / count, result.best.gain_db, 0.01);
}

TEST_F(SeveralMeshes, SmallPassesMakeTheSameCurveAndGoOnExactly) {
  TrainConfig c = config("whole");
  c.epochs = 2, c.steps_per_epoch = 4;
  LoadedPairs pairs = load(c);
  const TrainResult whole = train(c, pairs.data, pairs.judge.get(), {});
  TrainConfig small = c;
  small.output = (temporary_.path() / "small").string(), small.micro_batch = 1;
  const TrainResult parts = train(small, pairs.data, pairs.judge.get(), {});
  EXPECT_NEAR(parts.last.total, whole.last.total, 1e-4 * whole.last.total);
  TrainConfig cut = c;
  cut.output = (temporary_.path() / "cut").string(), cut.epochs = 1;
  train(cut, pairs.data, pairs.judge.get(), {});
  cut.epochs = 2;
  EXPECT_EQ(train(cut, pairs.data, pairs.judge.get(), {}).last.total, whole.last.total);
}

TEST_F(SeveralMeshes, NetworksThatRememberNeedOne) {
  TrainConfig c = config("out");
  c.architecture = complete({"mfsr", R"({"blocks": 1, "layers": 2, "growth": 8, "features": 8, "history": 1})"});
  c.mirror = false;
  c.history.frames = 3;
  const LoadedPairs pairs = load(c);
  EXPECT_THAT(test::error_of([&] { train(c, pairs.data, nullptr, {}); }).what(), HasSubstr("one mesh"));
}

TEST_F(TrainerTest, DataWithoutTrainingFramesIsRefused) {
  PairData data = waves(2, 6);
  data.sequences.front().validation = true;
  EXPECT_THROW(train(config(), data, nullptr, {}), Error);
  PairData one = waves(2, 2);  // shorter than a window of three
  EXPECT_THROW(train(config(), one, nullptr, {}), Error);
  PairData bent = waves(2, 6);
  bent.meshes[0].sheet_axes.clear();
  TrainConfig c = config();
  c.mirror = true;
  EXPECT_THROW(train(c, bent, nullptr, {}), Error);
}

TEST(ImageStore, FixedPointIsFineEnough) {
  ImageStore exact(9, 3, 4, {}), fixed(9, 3, 4, kUnitRange);
  std::vector<float> image;
  for (int i = 0; i < 9 * 12; ++i) image.push_back(-0.5F + 1.99F * static_cast<float>(i) / (9 * 12));
  exact.append(image), fixed.append(image);
  EXPECT_EQ(fixed.image_bytes() * 2, exact.image_bytes());
  std::vector<float> a(9 * 2 * 3), b(a.size());
  exact.read(0, 1, 1, 2, 3, a.data());
  fixed.read(0, 1, 1, 2, 3, b.data());
  EXPECT_FLOAT_EQ(a[0], image[5]);
  for (std::size_t i = 0; i < a.size(); ++i) EXPECT_NEAR(a[i], b[i], 1.6e-5);
}

}  // namespace
}  // namespace pleat::superres
