#include "services/dataset/commands.hpp"

#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "common/base/error.hpp"
#include "common/base/process.hpp"
#include "common/base/program.hpp"
#include "common/base/signals.hpp"
#include "services/dataset/shards.hpp"
#include "services/dataset/verify.hpp"

namespace pleat::dataset {
namespace {

void print(const VerifyReport& report) {
  for (const std::string& problem : report.problems) std::printf("problem: %s\n", problem.c_str());
  std::printf(
      "%llu sequences, %llu frames, %llu judged: %llu self-intersections, %llu penetrations; feature vertices %.4f m "
      "off on average, %.4f m at most\n",
      static_cast<unsigned long long>(report.sequences), static_cast<unsigned long long>(report.frames),
      static_cast<unsigned long long>(report.frames_judged), static_cast<unsigned long long>(report.self_intersections),
      static_cast<unsigned long long>(report.penetrations), report.feature_distance_mean_m,
      report.feature_distance_max_m);
  if (report.unmerged) {
    std::printf("made by shards, not merged yet: %llu sequences to be made\n",
                static_cast<unsigned long long>(report.pending));
  }
}

}  // namespace

void add_generate_options(CLI::App& app, GenerateChoice& choice) {
  CLI::Option* set = app.add_option("--set", choice.set, "built-in scenes");
  set->capture_default_str()->check(
      CLI::IsMember({"draping", "hitting", "sheet", "disk", "skirt", "tshirt", "pants", kFamily}));
  app.add_option("--scale", choice.scale,
                 "frames a sequence; small: 150 or 60, full: the papers' 400 (draping), 1,000 (hitting) or 200 (sheet, "
                 "disk), whole motions (skirt, tshirt, pants), 120 (family)")
      ->capture_default_str()
      ->check(CLI::IsMember({"small", "full"}));
  CLI::Option* scenes =
      app.add_option("--scene", choice.scenes, "variations of one's own scene files instead of a set");
  scenes->excludes(set);
  app.add_option("--sequences", choice.sequences,
                 "with --scene: variations (default: 12), besides the scenes themselves")
      ->check(positive_number())
      ->needs(scenes);
  app.add_option("--fine", choice.fine,
                 "the fine cloth follows the coarse one, by averages (default) or by the paper's springs, or goes its "
                 "own way (the default of sheet, disk, tshirt and pants)")
      ->check(CLI::IsMember({"tracked", "springs", "free"}));
  app.add_option("--frequency", choice.frequency,
                 "rad/s with which the averages follow; the higher, the more of a fold's place is in the coarse frame, "
                 "and the fewer folds there are (default: the set's; 7, skirt 20)")
      ->check(positive_number());
  app.add_option(
         "--rounds", choice.rounds,
         "2, 3 or 4: 16, 64 or 256 fine faces for each coarse one, for sheet by another coarse mesh (default: 2; disk, "
         "tshirt, pants: 3)")
      ->check(positive_number());
  app.add_option("--frames", choice.frames, "frames a sequence, instead of the scale's")->check(positive_number());
  app.add_option("--train", choice.train,
                 "sequences for training (default: draping 10, hitting 27, sheet 16, disk 8, skirt 5, tshirt and pants "
                 "18, family 96)")
      ->check(natural_number());
  app.add_option("--test", choice.test,
                 "sequences for testing (default: draping 3, hitting 8, sheet 4, family 12, others 2)")
      ->check(natural_number());
  app.add_option("--extra", choice.extra, "further sequences for training, behind the others, which stay the same")
      ->capture_default_str()
      ->check(natural_number());
  app.add_option("--seed", choice.seed, "seed of the scenes")->capture_default_str()->check(natural_number());
  app.add_option("--workers", choice.workers, "processes (default: one a processor)")->check(positive_number());
  app.add_option("--garment", choice.garment, "coarse garment, OBJ or PLY (default: the set's own)");
  app.add_option("--garment-scale", choice.garment_scale, "metres per unit of the garment's file: 0.01 for centimetres")
      ->capture_default_str()
      ->check(positive_number());
  app.add_option("--material", choice.material,
                 "material, ARCSim JSON (default: gray interlock; skirt, tshirt, pants: isotropic medium)");
  app.add_option("--body", choice.body,
                 "character that wears the garment at rest (skirt, tshirt, pants; default: the "
                 "shipped young woman)");
  app.add_option("--motions", choice.motions,
                 "BVH and AMC files, or folders of them (skirt, tshirt, pants; default: what is shipped)");
  app.add_option("--shard", choice.shard,
                 "I/N: this is worker I of N on one shared folder, and others run with the same options; none: it is "
                 "not (default: SLURM_ARRAY_TASK_ID or JOB_COMPLETION_INDEX with JOB_COMPLETIONS, where they are set)");
  app.add_option("--lease", choice.lease_s, "with shards: seconds after which a silent worker is taken for dead")
      ->capture_default_str()
      ->check(positive_number());
  app.add_flag("--deflate,!--no-deflate", choice.deflate, "compress finished sequences (default: yes)");
}

namespace {

/// What a scene says itself, or what sets alone have.
void require_no_set_options(const GenerateChoice& choice) {
  const std::pair<const char*, bool> given[] = {{"--garment", !choice.garment.empty()},
                                                {"--garment-scale", choice.garment_scale != 1},
                                                {"--material", !choice.material.empty()},
                                                {"--body", !choice.body.empty()},
                                                {"--motions", !choice.motions.empty()},
                                                {"--train", choice.train >= 0},
                                                {"--test", choice.test >= 0},
                                                {"--extra", choice.extra > 0},
                                                {"--scale", choice.scale != GenerateChoice().scale}};
  for (const auto& [name, is_given] : given) {
    if (is_given) throw_invalid_argument(std::string(name) + " is for sets, not for --scene");
  }
}

constexpr const char* kFamilyMaterials[] = {"silk",
                                            "cotton-shirting",
                                            "denim",
                                            "felt",
                                            "wool-suiting",
                                            "gray-interlock",
                                            "isotropic-light",
                                            "isotropic-medium",
                                            "isotropic-heavy",
                                            "isotropic-latex"};

void require_no_garment(const GenerateChoice& choice) {
  const std::pair<const char*, bool> given[] = {{"--garment", !choice.garment.empty()},
                                                {"--garment-scale", choice.garment_scale != 1},
                                                {"--material", !choice.material.empty()},
                                                {"--body", !choice.body.empty()},
                                                {"--motions", !choice.motions.empty()}};
  for (const auto& [name, is_given] : given) {
    if (is_given) throw_invalid_argument(std::string(name) + " is not for the set family, which makes its own");
  }
}

GenerateOptions own_scenes_options(const GenerateChoice& choice) {
  require_no_set_options(choice);
  GenerateOptions options;
  options.scenes.set = kOwnScenes;
  options.scenes.own_scenes.assign(choice.scenes.begin(), choice.scenes.end());
  if (choice.sequences > 0) options.scenes.sequences = choice.sequences;
  options.scenes.frames = choice.frames;  // 0: the scene's
  options.scenes.tracked = choice.fine != "free";
  return options;
}

GenerateOptions set_options(const GenerateChoice& choice) {
  const SetSize size = set_size(choice.set, choice.scale == "full");
  const SetDefaults defaults = set_defaults(choice.set, choice.rounds);
  GenerateOptions options;
  options.scenes.set = choice.set;
  options.scenes.train = choice.train >= 0 ? choice.train : size.train;
  options.scenes.test = choice.test >= 0 ? choice.test : size.test;
  options.scenes.extra = choice.extra;
  options.scenes.frames = choice.frames > 0 ? choice.frames : size.frames;
  options.scenes.tracked = choice.fine.empty() ? defaults.tracked : choice.fine != "free";
  if (choice.set == kFamily) {
    require_no_garment(choice);
    for (const char* preset : kFamilyMaterials) {
      options.scenes.materials.push_back(shipped_file("materials/" + std::string(preset) + ".json"));
    }
    return options;
  }
  options.scenes.garment = choice.garment;
  if (choice.garment.empty()) options.scenes.garment = shipped_file(defaults.garment);
  options.scenes.garment_scale = choice.garment_scale;
  options.scenes.material = choice.material;
  if (choice.material.empty()) options.scenes.material = shipped_file(defaults.material);
  if (is_dressed_set(choice.set)) {
    options.scenes.body = choice.body;
    if (choice.body.empty()) options.scenes.body = shipped_file("bodies/young-female.glb");
    options.scenes.motions.assign(choice.motions.begin(), choice.motions.end());
    if (choice.motions.empty()) options.scenes.motions = {shipped_file("bodies")};
  } else if (!choice.body.empty() || !choice.motions.empty()) {
    throw_invalid_argument("--body and --motions are for the sets skirt, tshirt and pants");
  }
  return options;
}

}  // namespace

GenerateOptions generate_options(const GenerateChoice& choice, const std::string& git_revision) {
  GenerateOptions options = choice.scenes.empty() ? set_options(choice) : own_scenes_options(choice);
  options.folder = choice.folder;
  options.scenes.rounds = choice.rounds;
  options.scenes.seed = choice.seed;
  options.scenes.springs = choice.fine == "springs";
  options.scenes.frequency = choice.frequency;
  options.workers = choice.workers;
  options.deflate = choice.deflate;
  options.git_revision = git_revision;
  return options;
}

int generate_chosen(const GenerateChoice& choice, const std::string& git_revision,
                    const std::function<void(const Progress&)>& progress) {
  const GenerateOptions options = generate_options(choice, git_revision);
  const std::optional<Shard> shard = choose_shard(choice.shard, [](const char* name) { return std::getenv(name); });
  if (!shard) {
    // The work resumes from disk: being stopped at once is the fastest clean end.
    restore_signal_handlers();
    generate(options, progress);
    return kExitDone;
  }
  install_signal_handlers();
  const auto expiry = std::chrono::milliseconds(std::llround(1000 * choice.lease_s));
  switch (generate_shard(options, {*shard, expiry, interrupted}, progress)) {
    case ShardEnd::kDone:
      std::fprintf(stderr, "all sequences are made; next: pleat dataset merge %s\n", choice.folder.c_str());
      return kExitDone;
    case ShardEnd::kOthersWork:
      std::fprintf(stderr, "other workers make what is left; run again if they may die (exit code %d)\n",
                   kExitRunAgain);
      return kExitRunAgain;
    case ShardEnd::kInterrupted:
      std::fprintf(stderr, "interrupted, with check-points; run again to go on (exit code %d)\n", kExitRunAgain);
      return kExitRunAgain;
  }
  throw_internal("unknown end of a shard");
}

int merge_and_print(const std::string& folder, bool json) {
  std::FILE* lines = json ? stderr : stdout;
  const ShardEnd end = merge(folder, GenerateOptions().margin, [lines](const std::string& line) {
    std::fprintf(lines, "%s\n", line.c_str());
    std::fflush(lines);
  });
  if (end != ShardEnd::kDone) return kExitRunAgain;
  print_description(folder, json);
  return kExitDone;
}

void print_description(const std::string& folder, bool json) {
  const nlohmann::json description = describe(folder);
  if (json) {
    std::printf("%s\n", description.dump(2).c_str());
    return;
  }
  for (const std::string& line : to_lines(description)) std::printf("%s\n", line.c_str());
}

void verify_and_print(const std::string& folder, std::uint64_t stride, bool json) {
  const auto report = verify(folder, {stride}, [json](const std::string& line) {
    if (json) return;
    std::printf("%s\n", line.c_str());
    std::fflush(stdout);
  });
  if (json) {
    std::printf("%s\n", to_json(report).dump(2).c_str());
  } else {
    print(report);
  }
  std::fflush(stdout);
  if (report.problems.empty()) return;
  throw_internal(folder + ": " + std::to_string(report.problems.size()) +
                 " problems, the first: " + report.problems[0]);
}

}  // namespace pleat::dataset
