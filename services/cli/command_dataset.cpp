// `pleat dataset`: paired data sets.
#include <cstdio>

#include "common/base/machine.hpp"
#include "common/base/progress.hpp"
#include "common/base/signals.hpp"
#include "services/cli/command.hpp"
#include "services/dataset/generate.hpp"
#include "services/dataset/verify.hpp"

namespace pleat::cli {
namespace {

struct GenerateChoice {
  std::string folder, set = "draping", scale = "small", fine = "tracked";
  std::string garment, material = "deploy/materials/gray-interlock.json";
  int frames = 0, rounds = 0, train = -1, test = -1, extra = 0, workers = 0;
  std::uint64_t seed = 1;
  bool deflate = true;
};

int generate(const GenerateChoice& choice) {
  // The work resumes from disk: being stopped at once is the fastest clean end.
  restore_signal_handlers();
  dataset::GenerateOptions options;
  options.folder = choice.folder;
  options.scenes.set = choice.set;
  const dataset::SetSize size = dataset::set_size(choice.set, choice.scale == "full");
  options.scenes.train = choice.train >= 0 ? choice.train : size.train;
  options.scenes.test = choice.test >= 0 ? choice.test : size.test;
  options.scenes.extra = choice.extra;
  options.scenes.frames = choice.frames > 0 ? choice.frames : size.frames;
  options.scenes.seed = choice.seed;
  options.scenes.tracked = choice.fine == "tracked";
  options.scenes.rounds = choice.rounds;
  options.scenes.garment = choice.garment.empty() ? "deploy/" + dataset::default_garment(choice.set) : choice.garment;
  options.scenes.material = choice.material;
  options.workers = choice.workers;
  options.deflate = choice.deflate;
  options.git_revision = git_revision();
  std::unique_ptr<Progress> shown;
  dataset::generate(options, [&shown](const dataset::Progress& progress) {
    if (!shown) shown = std::make_unique<Progress>("frames", progress.frames);
    char left[32] = "";
    if (progress.left_s > 0) std::snprintf(left, sizeof left, "%.0f s left", progress.left_s);
    shown->update(progress.frames_done, left);
    if (!progress.message.empty()) shown->line(progress.message);
  });
  if (shown) shown->finish();
  for (const std::string& line : dataset::describe(options.folder)) std::printf("%s\n", line.c_str());
  return kExitDone;
}

int verify(const std::string& folder, std::uint64_t stride) {
  const auto report = dataset::verify(folder, {stride}, [](const std::string& line) {
    std::printf("%s\n", line.c_str());
    std::fflush(stdout);
  });
  for (const std::string& problem : report.problems) std::printf("problem: %s\n", problem.c_str());
  std::printf(
      "%llu sequences, %llu frames, %llu judged: %llu self-intersections, %llu penetrations; feature vertices %.4f m "
      "off on average, %.4f m at most\n",
      static_cast<unsigned long long>(report.sequences), static_cast<unsigned long long>(report.frames),
      static_cast<unsigned long long>(report.frames_judged), static_cast<unsigned long long>(report.self_intersections),
      static_cast<unsigned long long>(report.penetrations), report.feature_distance_mean_m,
      report.feature_distance_max_m);
  if (report.problems.empty()) return kExitDone;
  std::fflush(stdout);
  print_error(folder + ": " + std::to_string(report.problems.size()) + " problems, the first: " + report.problems[0]);
  return kExitFailed;
}

}  // namespace

std::vector<Command> add_dataset(CLI::App& root) {
  CLI::App* app = root.add_subcommand("dataset", "paired data sets: generate, info, verify");
  app->require_subcommand(0, 1);

  CLI::App* make = app->add_subcommand("generate", "simulate what is missing of a data set; resumes");
  const auto choice = std::make_shared<GenerateChoice>();
  make->add_option("folder", choice->folder, "folder of the data set")->required();
  make->add_option("--set", choice->set, "scenes")
      ->capture_default_str()
      ->check(CLI::IsMember({"draping", "hitting", "sheet", "disk"}));
  make->add_option("--scale", choice->scale,
                   "frames a sequence; small: 150 or 60, full: the papers' 400 (draping), 1,000 (hitting) or 200")
      ->capture_default_str()
      ->check(CLI::IsMember({"small", "full"}));
  make->add_option("--rounds", choice->rounds,
                   "2, 3 or 4: 16, 64 or 256 fine faces for each coarse one (default: 2; sheet, disk: 3)")
      ->check(positive_number());
  make->add_option("--fine", choice->fine,
                   "the fine cloth follows the coarse one, or goes its own way (sheet, disk: always)")
      ->capture_default_str()
      ->check(CLI::IsMember({"tracked", "free"}));
  make->add_option("--frames", choice->frames, "frames a sequence, instead of the scale's")->check(positive_number());
  make->add_option("--train", choice->train, "sequences for training (default: 10, 27, 16 or 8)")
      ->check(natural_number());
  make->add_option("--test", choice->test, "sequences for testing (default: 3, 8, 4 or 2)")->check(natural_number());
  make->add_option("--extra", choice->extra, "further sequences for training, behind the others, which stay the same")
      ->capture_default_str()
      ->check(natural_number());
  make->add_option("--seed", choice->seed, "seed of the scenes")->capture_default_str()->check(natural_number());
  make->add_option("--workers", choice->workers, "processes (default: one a processor)")->check(positive_number());
  make->add_option("--garment", choice->garment, "coarse garment, OBJ (default: the set's own)");
  make->add_option("--material", choice->material, "material, ARCSim JSON")->capture_default_str();
  make->add_flag("--deflate,!--no-deflate", choice->deflate, "compress finished sequences (default: yes)");

  CLI::App* info = app->add_subcommand("info", "what is in a data set");
  const auto info_folder = std::make_shared<std::string>();
  info->add_option("folder", *info_folder, "folder of the data set")->required();

  CLI::App* check = app->add_subcommand("verify", "check every invariant; exit code 1 if one is broken");
  const auto check_folder = std::make_shared<std::string>();
  const auto stride = std::make_shared<std::uint64_t>(1);
  check->add_option("folder", *check_folder, "folder of the data set")->required();
  check->add_option("--stride", *stride, "judge intersections of every n-th frame only")
      ->capture_default_str()
      ->check(positive_number());

  return {{make, [choice] { return generate(*choice); }},
          {info,
           [info_folder] {
             for (const std::string& line : dataset::describe(*info_folder)) std::printf("%s\n", line.c_str());
             return kExitDone;
           }},
          {check, [check_folder, stride] { return verify(*check_folder, *stride); }}};
}

}  // namespace pleat::cli
