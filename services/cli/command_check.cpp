// `pleat check`: what is wrong or unusual with files.
#include <cstdio>
#include <nlohmann/json.hpp>

#include "services/cli/command.hpp"
#include "services/presentation/check/check.hpp"

namespace pleat::cli {
namespace {

struct Options {
  std::vector<std::string> files;
  presentation::CheckOptions check;
  bool json = false;
};

void print(const std::string& file, const presentation::Findings& findings) {
  std::printf("%s\n", file.c_str());
  for (const std::string& fact : findings.facts) std::printf("  %s\n", fact.c_str());
  for (const std::string& note : findings.notes) std::printf("  note: %s\n", note.c_str());
  for (const std::string& fault : findings.faults) std::printf("  fault: %s\n", fault.c_str());
}

int check(const Options& options) {
  nlohmann::json report = nlohmann::json::array();
  std::vector<std::string> faults;
  for (const std::string& file : options.files) {
    const presentation::Findings findings = presentation::check_file(file, options.check);
    faults.insert(faults.end(), findings.faults.begin(), findings.faults.end());
    report.push_back(
        {{"file", file}, {"facts", findings.facts}, {"notes", findings.notes}, {"faults", findings.faults}});
    if (!options.json) print(file, findings);
  }
  if (options.json) std::printf("%s\n", report.dump(2).c_str());
  std::fflush(stdout);
  if (faults.empty()) return kExitDone;
  print_error("pleat",
              (faults.size() == 1 ? "1 fault: " : std::to_string(faults.size()) + " faults, the first: ") + faults[0]);
  return kExitWrongInput;
}

}  // namespace

std::vector<Command> add_check(CLI::App& root) {
  CLI::App* app = root.add_subcommand("check", "say what is wrong or unusual with garments, bodies, caches and scenes");
  const auto options = std::make_shared<Options>();
  app->add_option("files", options->files, "meshes, frames (as of `enhance --frames`), scenes")->required();
  app->add_option("--rest", options->check.rest, "the mesh that the files are frames of");
  app->add_option("--scale", options->check.scale, "metres per unit of garments and frames")
      ->capture_default_str()
      ->check(positive_number());
  add_json_option(*app, options->json, "print one JSON array: file, facts, notes, faults");
  return {{app, [options] { return check(*options); }}};
}

}  // namespace pleat::cli
