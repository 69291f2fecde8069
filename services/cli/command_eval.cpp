// `pleat eval`: bundles against the baselines on unseen sequences.
#include <algorithm>
#include <chrono>
#include <cstdio>

#include "common/base/progress.hpp"
#include "common/frame/detail.hpp"
#include "services/cli/command.hpp"
#include "services/cli/eval.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/cli/output.hpp"
#include "services/evaluation/session_method.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;

// In the order of the rows.
std::vector<v1::Detail> chosen_details(const EvalOptions& options) {
  std::vector<v1::Detail> details;
  if (options.details.empty() && !options.models.empty()) details.push_back(v1::DETAIL_NETWORK);
  for (const std::string& name : options.details) {
    const v1::Detail detail = detail_named(name);
    if (uses_network(detail) && options.models.empty())
      throw_invalid_argument("--detail " + name + " needs a bundle: name it with --model");
    if (std::find(details.begin(), details.end(), detail) == details.end()) details.push_back(detail);
  }
  if (!options.models.empty() && std::none_of(details.begin(), details.end(), uses_network))
    throw_invalid_argument("--model " + options.models.front() + ": --detail fold uses no bundle");
  return details;
}

}  // namespace

std::vector<evaluation::GarmentFigures> evaluate(const EvalOptions& options) {
  const std::vector<v1::Detail> details = chosen_details(options);
  const DatasetReader dataset(options.dataset);
  std::vector<evaluation::Method> methods{evaluation::barycentric_method()};
  if (options.baselines) methods.push_back(evaluation::zurdo_method(dataset));
  std::optional<Launcher> launcher;
  if (!details.empty()) {
    const bool network = std::any_of(details.begin(), details.end(), uses_network);
    std::vector<std::string> names;
    fs::path folder;
    std::string address = options.coordinator;
    for (const std::string& text : options.models) {
      if (!address.empty()) {
        names.push_back(text);
        continue;
      }
      const ModelChoice choice = choose_model(text);
      const fs::path own = choice.folder.empty() ? default_models_folder() : choice.folder;
      if (!folder.empty() && !fs::equivalent(folder, own))
        throw_invalid_argument("--model " + text + ": all bundles must lie in one folder, " + folder.string());
      folder = own;
      names.push_back(choice.name);
    }
    if (address.empty()) {
      LauncherOptions launch;
      launch.models = folder;
      if (network) launch.model = names.front();
      launch.network = network;
      launch.fold = std::any_of(details.begin(), details.end(), uses_fold);
      const fs::path logs = options.logs.empty() ? state_folder("eval") : fs::path(options.logs);
      launch.data = logs / "services";
      launch.logs = logs / "logs";
      launcher.emplace(launch);
      address = launcher->coordinator();
    }
    const auto client = std::make_shared<client::Client>(address, options.tls);
    client->wait_ready(std::chrono::milliseconds(static_cast<long>(options.timeout_s * 1000)));
    for (const v1::Detail detail : details) {
      const auto add = [&](const std::string& model) {
        methods.push_back(
            evaluation::session_method(client, {.model = model, .detail = detail, .refine = !options.skip_refinement}));
      };
      if (!uses_network(detail)) add("");
      for (const std::string& name : names)
        if (uses_network(detail)) add(name);
    }
  }
  std::optional<Progress> progress;
  auto figures =
      evaluation::evaluate_garments(dataset, methods, options.evaluation, [&](std::uint64_t done, std::uint64_t total) {
        if (!progress) progress.emplace("frames", total);
        progress->update(done);
      });
  if (progress) progress->finish();
  return figures;
}

namespace {

int evaluate_command(const EvalOptions& options, bool json) {
  const auto figures = evaluate(options);
  if (json)
    std::printf("%s\n", evaluation::to_json(figures).dump(2).c_str());
  else
    std::printf("%s", evaluation::to_table(figures).c_str());
  return kExitDone;
}

}  // namespace

std::vector<Command> add_eval(CLI::App& root) {
  CLI::App* app = root.add_subcommand("eval", "figures of model bundles and of the baseline on a data set");
  const auto options = std::make_shared<EvalOptions>();
  app->add_option("--dataset", options->dataset, "folder of the data set")->required();
  app->add_option("--model", options->models,
                  "model bundles: files, or names in deploy/models; none: the baseline only");
  app->add_option(
         "--detail", options->details,
         "what makes the wrinkles, a row each: network, fold (no bundle), both (default: network with --model)")
      ->check(CLI::IsMember({"network", "fold", "both"}));
  app->add_option("--sequences", options->evaluation.sequences, "names of sequences (default: the split 'test')");
  app->add_option("--frames", options->evaluation.frames, "the first FRAMES of each sequence only")
      ->check(positive_number());
  app->add_flag("--baselines", options->baselines,
                "also wrinkles by example (Zurdo et al. 2013) from the data set's training split");
  app->add_flag("--skip-refinement", options->skip_refinement, "the meshes as networks and fold step make them");
  const auto json = std::make_shared<bool>(false);
  add_json_option(*app, *json, "print one JSON object: method -> metric -> value; of several garments a list of these");
  app->add_option("--logs", options->logs,
                  "folder for the services' logs (default: out/eval in a build, else $XDG_STATE_HOME/pleat/eval)");
  app->add_option("--coordinator", options->coordinator,
                  "address of a running coordinator (default: start all services)");
  app->add_option("--timeout", options->timeout_s, "seconds to wait for the coordinator")
      ->capture_default_str()
      ->check(positive_number());
  add_tls_options(*app, options->tls);
  return {{app, [options, json] { return evaluate_command(*options, *json); }}};
}

}  // namespace pleat::cli
