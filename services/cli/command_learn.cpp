// `pleat learn`: from scenes of one's own to a bundle.
#include <cstdio>

#include "services/cli/command.hpp"
#include "services/cli/learn.hpp"

namespace pleat::cli {

std::vector<Command> add_learn(CLI::App& root) {
  CLI::App* app =
      root.add_subcommand("learn", "a bundle from scenes of one's own: data, training, evaluation; resumes");
  const auto options = std::make_shared<LearnOptions>();
  app->add_option("scenes", options->scenes, "scene files, or names in deploy/scenes; of one garment")->required();
  app->add_option("--out", options->out, "the bundle, NAME.pt; NAME.html compares it")->required();
  app->add_option("--base", options->base,
                  "bundle to begin with, a file or a name; 'none': fresh weights (default: 'any', if it is there)");
  app->add_option("--minutes", options->minutes, "for data, training and evaluation together")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--sequences", options->sequences,
                  "variations of the scenes (default: 12, or fewer so that the time suffices)")
      ->check(positive_number());
  app->add_option("--frames", options->frames,
                  "of each sequence (default: the scenes', at most 100, or fewer so that the time suffices)")
      ->check(positive_number());
  app->add_option("--seed", options->seed, "seed of the variations and of the training")
      ->capture_default_str()
      ->check(natural_number());
  app->add_option("--workers", options->workers, "processes that simulate (default: one a processor)")
      ->check(positive_number());
  app->add_option("--work", options->work, "folder of what is needed to go on (default: NAME.learn beside the bundle)");
  return {{app, [options] {
             const LearnResult result = learn(*options);
             std::printf("%s: %s\n%s\n", result.bundle.c_str(), result.verdict.c_str(), result.page.c_str());
             return kExitDone;
           }}};
}

}  // namespace pleat::cli
