// `pleat dataset`: paired data sets.
#include <cstdio>

#include "common/base/machine.hpp"
#include "common/base/progress.hpp"
#include "services/cli/command.hpp"
#include "services/dataset/commands.hpp"

namespace pleat::cli {
namespace {

int generate(const dataset::GenerateChoice& choice, bool json) {
  std::unique_ptr<Progress> shown;
  const int code = dataset::generate_chosen(choice, git_revision(), [&shown](const dataset::Progress& progress) {
    if (!shown) shown = std::make_unique<Progress>("frames", progress.frames);
    char left[32] = "";
    if (progress.left_s > 0) std::snprintf(left, sizeof left, "%.0f s left", progress.left_s);
    shown->update(progress.frames_done, left);
    if (!progress.message.empty()) shown->line(progress.message);
  });
  if (shown) shown->finish();
  if (code == kExitDone) dataset::print_description(choice.folder, json);
  return code;
}

}  // namespace

std::vector<Command> add_dataset(CLI::App& root) {
  CLI::App* app = root.add_subcommand("dataset", "paired data sets: generate, merge, info, verify");
  app->require_subcommand(0, 1);

  CLI::App* make = app->add_subcommand("generate", "simulate what is missing of a data set; resumes");
  make->footer(
      "With --shard, exit code 75: run again, for others still work or a signal came. Then `pleat dataset merge`.");
  const auto choice = std::make_shared<dataset::GenerateChoice>();
  make->add_option("folder", choice->folder, "folder of the data set")->required();
  dataset::add_generate_options(*make, *choice);
  const auto json = std::make_shared<bool>(false);
  const std::string form = "print one JSON object: meshes, splits, sequences";
  add_json_option(*make, *json, form);

  CLI::App* join = app->add_subcommand("merge", "put together what shards made; exit code 75 if they are not done");
  const auto join_folder = std::make_shared<std::string>();
  join->add_option("folder", *join_folder, "folder of the data set")->required();
  add_json_option(*join, *json, form);

  CLI::App* info = app->add_subcommand("info", "what is in a data set");
  const auto info_folder = std::make_shared<std::string>();
  info->add_option("folder", *info_folder, "folder of the data set")->required();
  add_json_option(*info, *json, form);

  CLI::App* check = app->add_subcommand("verify", "check every invariant; exit code 1 if one is broken");
  const auto check_folder = std::make_shared<std::string>();
  const auto stride = std::make_shared<std::uint64_t>(1);
  check->add_option("folder", *check_folder, "folder of the data set")->required();
  check->add_option("--stride", *stride, "judge intersections of every n-th frame only")
      ->capture_default_str()
      ->check(positive_number());
  add_json_option(*check, *json, "print one JSON object: problems, counts, distances of feature vertices");

  return {{make, [choice, json] { return generate(*choice, *json); }},
          {join, [join_folder, json] { return dataset::merge_and_print(*join_folder, *json); }},
          {info,
           [info_folder, json] {
             dataset::print_description(*info_folder, *json);
             return kExitDone;
           }},
          {check, [check_folder, stride, json] {
             dataset::verify_and_print(*check_folder, *stride, *json);
             return kExitDone;
           }}};
}

}  // namespace pleat::cli
