#include "services/cli/learn.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/base/machine.hpp"
#include "common/base/own_file.hpp"
#include "common/base/parallel.hpp"
#include "common/base/process.hpp"
#include "common/base/progress.hpp"
#include "common/base/signals.hpp"
#include "common/base/text_file.hpp"
#include "common/base/whole_file.hpp"
#include "common/store/dataset.hpp"
#include "services/cli/eval.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/cli/learn_page.hpp"
#include "services/cli/output.hpp"
#include "services/dataset/generate.hpp"
#include "services/dataset/sequence.hpp"
#include "services/evaluation/superres_process.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using Clock = std::chrono::steady_clock;

constexpr const char* kFormat = "pleat.learn";
constexpr const char* kLearned = "learned";  // names of the bundles in the folder that is evaluated
constexpr const char* kBase = "base";
constexpr int kSequences = 12, kFewestSequences = 6, kFrames = 100, kFewestFrames = 30;
constexpr double kDataShare = 0.3, kEvaluationShare = 0.15;
constexpr double kFewestTrainingShare = 0.3;  // though the data took longer than they should
constexpr double kBusy = 1.4;                 // later frames touch more than the first ones
constexpr int kTriedFrames = 12;
constexpr double kTriedSeconds = 5;
// s, to enhance and judge a frame with one method, for each fine vertex.
constexpr double kJudgedVertex = 6e-6;
constexpr int kFewestJudgedFrames = 10;

double minutes_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count() / 60;
}

std::string bytes_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) throw_not_found(file.string() + ": no such file");
  return {std::istreambuf_iterator<char>(stream), {}};
}

std::string hash_of(const fs::path& file) { return Hash().add(bytes_of(file)).hex(); }

json read_json(const fs::path& file) {
  std::ifstream stream(file);
  return json::parse(stream, nullptr, false);
}

/// The file of the bundle to begin with; empty: none.
fs::path base_file(const std::string& base) {
  if (base == "none") return {};
  if (base.empty()) {
    const fs::path any = default_models_folder() / "any.pt";
    std::error_code ignored;
    return fs::is_regular_file(any, ignored) ? any : fs::path();
  }
  const ModelChoice choice = choose_model(base);
  return (choice.folder.empty() ? default_models_folder() : choice.folder) / (choice.name + ".pt");
}

class Learning {
 public:
  explicit Learning(const LearnOptions& options)
      : options_(options),
        work_(options.work.empty() ? fs::path(options.out).replace_extension(".learn") : options.work),
        page_(fs::path(options.out).replace_extension(".html")),
        base_(base_file(options.base)),
        state_file_(work_ / "learn.json") {
    if (options.out.extension() != ".pt" || options.out.stem().empty()) {
      throw_invalid_argument(options.out.string() + ": a bundle's name ends with .pt");
    }
    for (const std::string& text : options.scenes) scenes_.emplace_back(shipped_or(text, "scenes"));
  }

  LearnResult run() {
    open();
    make_data();
    train();
    judge();
    return finish();
  }

 private:
  /// The folder and what was done in it, if it is ours.
  void open() {
    json inputs = {{"base", base_.empty() ? "" : hash_of(base_)},
                   {"sequences", options_.sequences},
                   {"frames", options_.frames},
                   {"seed", options_.seed},
                   {"scenes", json::array()}};
    for (const fs::path& scene : scenes_) {
      inputs["scenes"].push_back({{"file", fs::absolute(scene).string()}, {"hash", hash_of(scene)}});
    }
    require_replaceable(page_, kLearnPageMarks);
    std::error_code error;
    if (fs::exists(state_file_, error)) {
      state_ = read_json(state_file_);
      if (!state_.is_object() || state_.value("format", "") != kFormat) {
        throw Error(ErrorCode::kAlreadyExists, state_file_.string() + ": not made by pleat learn");
      }
      if (state_.value("inputs", json()) != inputs) {
        throw Error(
            ErrorCode::kFailedPrecondition,
            work_.string() + ": begun with other scenes or options; remove the folder or choose another --work");
      }
    } else if (fs::exists(work_, error) && !fs::is_empty(work_, error)) {
      throw Error(ErrorCode::kAlreadyExists, work_.string() + ": has files that pleat learn did not make");
    } else {
      state_ = {{"format", kFormat}, {"version", 1}, {"inputs", std::move(inputs)}};
    }
    const bool own = fs::exists(options_.out, error) && state_.value("bundle", "") == hash_of(options_.out);
    require_absent_or(own, options_.out);
    // What is wrong with the input shows before anything is left behind.
    if (!state_.contains("plan")) plan();
    make_writable_folder(work_);
    if (options_.out.has_parent_path()) make_writable_folder(options_.out.parent_path());
    save();
  }

  void save() { write_whole_file(state_file_, state_.dump(2) + "\n"); }

  dataset::GenerateOptions generate_options(int sequences, int frames) const {
    dataset::GenerateOptions options;
    options.folder = work_ / "data";
    options.scenes.set = dataset::kOwnScenes;
    options.scenes.own_scenes = scenes_;
    options.scenes.sequences = sequences;
    options.scenes.frames = frames;
    options.scenes.seed = options_.seed;
    options.workers = options_.workers;
    options.deflate = false;  // read as often as written
    options.git_revision = git_revision();
    return options;
  }

  void plan() {
    const auto plans = dataset::plan_sequences(generate_options(1, options_.frames).scenes);
    if (!base_.empty()) check_base(topology_hash(plans.front().scene.garment));
    int longest = 0;
    for (const auto& plan : plans) longest = std::max(longest, plan.scene.frames);
    const double seconds = dataset::seconds_per_frame(plans.front(), kTriedFrames, kTriedSeconds);
    const LearnBudget wanted{options_.sequences > 0 ? options_.sequences : kSequences,
                             options_.frames > 0 ? options_.frames : std::min(longest, kFrames), 0};
    const int workers = options_.workers > 0 ? options_.workers : static_cast<int>(available_processors());
    const LearnBudget budget = plan_budget(options_.minutes, static_cast<int>(scenes_.size()), wanted,
                                           options_.sequences > 0, options_.frames > 0, seconds, workers);
    state_["plan"] = {{"sequences", budget.sequences}, {"frames", budget.frames}};
    char text[160];
    std::snprintf(text, sizeof text, "%zu + %d sequences of %d frames, about %.1f min; then training until %.1f min",
                  scenes_.size(), budget.sequences, budget.frames, budget.data_minutes,
                  (1 - kEvaluationShare) * options_.minutes);
    Progress("learn", 0).line(text);
  }

  /// That the service takes the bundle, for this garment.
  void check_base(const std::string& garment) const {
    const PrivateFolder folder;
    write_whole_file(folder.path() / (std::string(kBase) + ".pt"), bytes_of(base_));
    const fs::path log = folder.path() / "superres.log";
    v1::ModelDescription description;
    try {
      description = evaluation::SuperresProcess(folder.path(), "auto", log).describe(kBase);
    } catch (const Error& error) {
      if (error.code() == ErrorCode::kCancelled) throw;
      throw_invalid_argument(base_.string() + ": no bundle to begin with: " + error.what());
    }
    if (!description.topology_hash().empty() && description.topology_hash() != garment) {
      throw_invalid_argument(base_.string() + ": serves another garment than " + scenes_.front().string() + " has");
    }
  }

  void make_data() {
    const auto start = Clock::now();
    const double before = state_.value("data_minutes", 0.0);
    const int sequences = state_["plan"].at("sequences"), frames = state_["plan"].at("frames");
    std::unique_ptr<Progress> shown;
    // It goes on from what is on disk: being stopped at once is the fastest clean end.
    restore_signal_handlers();
    dataset::generate(generate_options(sequences, frames), [&](const dataset::Progress& progress) {
      if (!shown) shown = std::make_unique<Progress>("data, frames", progress.frames);
      char left[48] = "";
      if (progress.left_s > 0) std::snprintf(left, sizeof left, "%.1f min left of the data", progress.left_s / 60);
      shown->update(progress.frames_done, left);
      if (progress.message.empty()) return;
      state_["data_minutes"] = before + minutes_since(start);
      save();
    });
    install_signal_handlers();
    if (shown) shown->finish();
    state_["data_minutes"] = before + minutes_since(start);
    save();
  }

  /// A sequence of the training split chooses the best weights, so that the test split has no say in them.
  std::string validation_sequence() const {
    std::string last;
    std::size_t training = 0;
    for (const SequenceInfo& info : DatasetReader(work_ / "data").sequences()) {
      if (info.split != "train") continue;
      last = info.name;
      ++training;
    }
    return training > 2 ? last : "";
  }

  fs::path train_folder() const { return work_ / "train"; }
  fs::path trained() const { return train_folder() / (std::string(kLearned) + ".pt"); }

  void write_configuration(double minutes) const {
    json config = read_json(shipped_file("models/own-garment.train.json"));
    if (!config.is_object()) throw_not_found(shipped_file("models/own-garment.train.json").string() + ": unreadable");
    config["name"] = kLearned;
    config["dataset"] = (work_ / "data").string();
    config["output"] = train_folder().string();
    config["seed"] = options_.seed;
    config["epochs"] = 1000000;
    config["steps_per_epoch"] = 50;
    config["max_minutes"] = minutes;
    config["schedule"]["progress"] = "minutes";
    config["schedule"]["warm_up_steps"] = 20;
    // A short training ends before a long memory of its first weights does.
    config["optimizer"]["average"] = 0.995;
    if (!base_.empty()) {
      config["optimizer"]["learning_rate"] = 5e-4;
      // In units of the base's data, folds of livelier cloth are beyond what 16 bits hold.
      config["cache"] = "float32";
    }
    config["validation"]["every_epochs"] = 1;
    config["validation"]["every_frames"] = 5;
    if (const std::string name = validation_sequence(); !name.empty()) config["validation"]["sequences"] = {name};
    write_whole_file(work_ / "train.json", config.dump(2) + "\n");
  }

  void train() {
    const double minutes = std::max((1 - kEvaluationShare) * options_.minutes - state_.value("data_minutes", 0.0),
                                    kFewestTrainingShare * options_.minutes);
    if (state_.value("trained_minutes", 0.0) >= minutes && fs::exists(trained())) return;
    write_configuration(minutes);
    make_writable_folder(work_ / "logs");
    const fs::path log = work_ / "logs" / "train.log";
    begin_log(log, "pleat-train");
    std::vector<std::string> arguments{(work_ / "train.json").string()};
    if (!base_.empty()) arguments.insert(arguments.end(), {"--initial", base_.string()});
    ChildProcess child(executable_folder() / "pleat-train", arguments, log);
    Progress progress("training, seconds", static_cast<std::uint64_t>(60 * minutes));
    while (child.running()) {
      if (interrupted()) {
        child.send(SIGTERM);
        child.wait_until(Clock::now() + std::chrono::seconds(60));
        throw Error(ErrorCode::kCancelled, "interrupted; the same command goes on");
      }
      const auto curve = evaluation::read_convergence("", train_folder() / "log.csv");
      if (!curve.minutes.empty()) {
        const double done = std::min(curve.minutes.back(), minutes);
        char note[96];
        std::snprintf(note, sizeof note, "PSNR %.2f dB, about %.1f min left", curve.displacement_db.back(),
                      minutes - done + kEvaluationShare * options_.minutes);
        progress.update(static_cast<std::uint64_t>(60 * done), note);
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
    }
    if (child.end_reason() != "exit code 0") {
      throw_internal("training ended with " + child.end_reason() + ": " + last_lines(log, 1));
    }
    progress.finish();
    if (!fs::exists(trained())) throw_internal("training: no bundle; the time was too short for one step");
    state_["trained_minutes"] = minutes;
    save();
  }

  /// The bundles side by side under names of their own.
  void judge() {
    const fs::path models = work_ / "models";
    make_writable_folder(models);
    EvalOptions eval;
    const auto add = [&](const fs::path& from, const std::string& name) {
      write_whole_file(models / (name + ".pt"), bytes_of(from));
      eval.models.push_back((models / (name + ".pt")).string());
    };
    if (!base_.empty()) add(base_, kBase);
    add(trained(), kLearned);
    eval.dataset = (work_ / "data").string();
    eval.logs = (work_ / "evaluation").string();
    eval.details = {"network"};
    if (base_.empty()) eval.details.insert(eval.details.begin(), "fold");
    eval.evaluation.frames = judged_frames(2 + eval.models.size());
    figures_ = std::move(evaluate(eval).front().methods);  // its scenes have one garment
  }

  std::uint64_t judged_frames(std::size_t methods) const {
    const DatasetReader reader(work_ / "data");
    const double seconds = 60 * kEvaluationShare * options_.minutes;
    const double frame =
        kJudgedVertex * static_cast<double>(reader.topology().fine.vertex_count()) * static_cast<double>(methods);
    const std::size_t sequences = evaluation::chosen_sequences(reader, {}).size();
    return static_cast<std::uint64_t>(
        std::max<double>(kFewestJudgedFrames, seconds / frame / static_cast<double>(sequences)));
  }

  LearnResult finish() {
    LearnResult result;
    result.bundle = options_.out, result.page = page_;
    result.figures = figures_;
    result.verdict = verdict();
    write_page(result);
    write_whole_file(options_.out, bytes_of(trained()));
    state_["bundle"] = hash_of(options_.out);
    save();
    return result;
  }

  const evaluation::MethodFigures& figures_of(const std::string& name) const {
    const auto found = std::find_if(figures_.begin(), figures_.end(), [&](const auto& f) { return f.name == name; });
    if (found == figures_.end()) throw_internal("evaluation: no figures of " + name);
    return *found;
  }

  std::string verdict() const {
    const auto& own = figures_.back().metrics;
    const auto& other = base_.empty() ? figures_.front() : figures_of(std::string("pleat:") + kBase);
    const double gain = 10 * std::log10(other.metrics.vmse_m2 / own.vmse_m2);
    char text[320];
    std::snprintf(text, sizeof text,
                  "RMSE %.2f mm on %zu frames of sequences that it did not see, %s %.2f mm: %.1f dB %s; %llu "
                  "intersections",
                  1e3 * own.rmse_m, own.frames,
                  base_.empty() ? "upsampling" : ("bundle " + base_.stem().string()).c_str(),
                  1e3 * other.metrics.rmse_m, std::abs(gain), gain >= 0 ? "better" : "worse, so prefer that one",
                  static_cast<unsigned long long>(own.counts.penetrations + own.counts.self_intersections));
    return text;
  }

  void write_page(const LearnResult& result) const {
    LearnPage page;
    page.name = options_.out.stem().string();
    for (const fs::path& scene : scenes_) page.scenes.push_back(scene.filename().string());
    page.begun_with = base_.empty() ? "fresh weights" : "the bundle " + base_.stem().string();
    page.figures = result.figures;
    page.curve = evaluation::read_convergence(page.name, train_folder() / "log.csv");
    for (const SequenceInfo& info : evaluation::chosen_sequences(DatasetReader(work_ / "data"), {})) {
      page.judged.push_back(info.name);
    }
    page.verdict = result.verdict;
    write_whole_file(page_, to_html(page));
  }

  const LearnOptions& options_;
  const fs::path work_, page_, base_, state_file_;
  std::vector<fs::path> scenes_;
  json state_;
  std::vector<evaluation::MethodFigures> figures_;
};

}  // namespace

LearnBudget plan_budget(double minutes, int scenes, LearnBudget wanted, bool fixed_sequences, bool fixed_frames,
                        double seconds, int workers) {
  LearnBudget budget = wanted;
  const double affordable = 60 * kDataShare * minutes * workers / (kBusy * seconds);  // frames of all sequences
  const auto all = [&] { return static_cast<double>(scenes + budget.sequences); };
  if (!fixed_frames && all() * budget.frames > affordable) {
    budget.frames = std::max(std::min(budget.frames, kFewestFrames), static_cast<int>(affordable / all()));
  }
  if (!fixed_sequences && all() * budget.frames > affordable) {
    const int few = static_cast<int>(affordable / budget.frames) - scenes;
    budget.sequences = std::max(std::min(budget.sequences, kFewestSequences), few);
  }
  budget.data_minutes = all() * budget.frames * kBusy * seconds / workers / 60;
  return budget;
}

LearnResult learn(const LearnOptions& options) { return Learning(options).run(); }

}  // namespace pleat::cli
