// pleat-train CONFIG: trains a model bundle (docs/training.md).
#include "common/base/freed_memory.hpp"
#include "common/base/program.hpp"
#include "services/superres/training/program.hpp"

int main(int argc, char** argv) {
  CLI::App app(
      "Trains a model bundle as the JSON file CONFIG says (docs/training.md), or goes on from its check-point.",
      "pleat-train");
  app.footer(
      "Ctrl-C ends the training after the step at hand, with a check-point.\n"
      "Exit codes: 0 done, 1 failed, 2 wrong usage or input; with --rendezvous, 75: stopped, or a process was lost, "
      "run "
      "again.");
  pleat::superres::TrainArguments arguments;
  bool strict = false;
  app.add_option("config", arguments.config, "JSON file");
  app.add_option("--re-export", arguments.re_export, "OLD.pt: a bundle of an earlier version, written anew to --out");
  app.add_option("--any-mesh", arguments.any_mesh, "OLD.pt: a bundle of one mesh, written to --out to serve any");
  app.add_option("--out", arguments.out, "NEW.pt");
  app.add_option("--garment", arguments.garment,
                 "MESH: the coarse mesh of OLD.pt; with --re-export, to note its rest positions");
  app.add_option("--initial", arguments.initial, "BUNDLE: begins with its network, whatever CONFIG says of networks");
  app.add_option("--set", arguments.changes, "KEY=VALUE: changes a key, for example losses.normal=0; may be repeated")
      ->allow_extra_args(false);
  app.add_flag("--strict", strict, "a sequence that can't be used is an error, not a warning");
  app.add_option("--processes", arguments.processes, "data-parallel training by so many processes on this host")
      ->capture_default_str()
      ->check(CLI::Range(1, 1024));
  app.add_option("--rank", arguments.rank, "with --rendezvous: this is process RANK, from 0, of --processes")
      ->check(CLI::Range(0, 1023));
  app.add_option("--rendezvous", arguments.rendezvous,
                 "HOST:PORT: the processes are started elsewhere too, with the same options, and meet there");
  return pleat::run_program(app, argc, argv, [&] {
    pleat::keep_all_freed_memory();
    arguments.words.assign(argv + 1, argv + argc);
    if (strict) arguments.changes.emplace_back("strict=true");
    arguments.git_revision = PLEAT_GIT_REVISION;
    arguments.stop = pleat::superres::stop_on_signals(arguments);
    return pleat::superres::run_training(arguments);
  });
}
