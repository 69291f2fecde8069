// pleat-generate: `pleat dataset` for machines without gRPC.
#include <cstdio>

#include "common/base/program.hpp"
#include "services/dataset/commands.hpp"

namespace {

void print(const pleat::dataset::Progress& progress) {
  static double last = -10;
  if (progress.message.empty() && progress.elapsed_s - last < 10) return;
  last = progress.elapsed_s;
  std::printf("%llu of %llu frames, %.0f s, %.0f s left%s%s\n", static_cast<unsigned long long>(progress.frames_done),
              static_cast<unsigned long long>(progress.frames), progress.elapsed_s, progress.left_s,
              progress.message.empty() ? "" : ": ", progress.message.c_str());
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Makes what is missing of a paired data set; resumes.", "pleat-generate");
  pleat::dataset::GenerateChoice choice;
  std::string revision;
  std::uint64_t stride = 1;
  bool info = false, verify = false, merge = false;
  app.add_option("folder", choice.folder, "folder of the data set")->required();
  pleat::dataset::add_generate_options(app, choice);
  app.add_option("--revision", revision, "git revision to note in the master file");
  const auto shown = app.add_flag("--info", info, "print what is in the data set instead");
  const auto checked =
      app.add_flag("--verify", verify, "check every invariant instead; exit code 1 if one is broken")->excludes(shown);
  app.add_flag("--merge", merge, "put together what shards made instead; exit code 75 if they are not done")
      ->excludes(shown)
      ->excludes(checked);
  app.add_option("--stride", stride, "with --verify: judge intersections of every n-th frame only")
      ->capture_default_str()
      ->check(pleat::positive_number());
  return pleat::run_program(app, argc, argv, [&] {
    if (verify) {
      pleat::dataset::verify_and_print(choice.folder, stride);
    } else if (info) {
      pleat::dataset::print_description(choice.folder);
    } else if (merge) {
      return pleat::dataset::merge_and_print(choice.folder);
    } else {
      return pleat::dataset::generate_chosen(choice, revision, print);
    }
    return pleat::kExitDone;
  });
}
