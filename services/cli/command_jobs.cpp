// `pleat jobs list|cancel|remove`: the jobs of a running coordinator.
#include <algorithm>
#include <cstdio>
#include <ctime>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/runtime_folder.hpp"
#include "common/client/cpp/client.hpp"
#include "services/cli/command.hpp"

namespace pleat::cli {
namespace {

struct JobsOptions {
  std::string coordinator = default_address("coordinator");
  rpc::TlsOptions tls;
  std::vector<std::string> ids;
  bool json = false;
};

std::string when(double unix_s) {
  if (unix_s <= 0) return "-";
  const auto seconds = static_cast<std::time_t>(unix_s);
  std::tm parts{};
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%d %H:%M:%S", ::localtime_r(&seconds, &parts));
  return text;
}

/// Of a job that waits with its place: "queued #2".
std::string state_of(const v1::Job& job) {
  std::string state = client::state_name(job.state());
  if (job.queue_place() > 0) state += " #" + std::to_string(job.queue_place());
  return state;
}

nlohmann::ordered_json to_json(const v1::Job& job) {
  return {{"id", job.id()},
          {"scene", job.scene_name()},
          {"state", client::state_name(job.state())},
          {"queue_place", job.queue_place()},
          {"owner", job.owner()},
          {"frames", job.frames()},
          {"frames_complete", job.frames_complete()},
          {"created_s", job.created_s()},
          {"ended_s", job.ended_s()},
          {"bytes", job.bytes()},
          {"result", job.result_path()},
          {"error", job.error()}};
}

int list(const JobsOptions& options) {
  const std::vector<v1::Job> jobs = client::Client(options.coordinator, options.tls).list_jobs();
  if (options.json) {
    auto all = nlohmann::ordered_json::array();
    for (const v1::Job& job : jobs) all.push_back(to_json(job));
    std::printf("%s\n", all.dump(2, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
    return kExitDone;
  }
  std::size_t id_width = 2, owner_width = 5;
  for (const v1::Job& job : jobs) {
    id_width = std::max(id_width, job.id().size());
    owner_width = std::max(owner_width, job.owner().size());
  }
  std::printf("%-*s  %-*s  %-24s  %13s  %9s  %s\n", static_cast<int>(id_width), "job", static_cast<int>(owner_width),
              "owner", "state", "frames", "MB", "created");
  for (const v1::Job& job : jobs) {
    const std::string frames = std::to_string(job.frames_complete()) + "/" + std::to_string(job.frames());
    std::printf("%-*s  %-*s  %-24s  %13s  %9.1f  %s\n", static_cast<int>(id_width), job.id().c_str(),
                static_cast<int>(owner_width), job.owner().c_str(), state_of(job).c_str(), frames.c_str(),
                static_cast<double>(job.bytes()) * 1e-6, when(job.created_s()).c_str());
  }
  return kExitDone;
}

int cancel(const JobsOptions& options) {
  const client::Client client(options.coordinator, options.tls);
  for (const std::string& id : options.ids) {
    std::printf("%s is %s\n", id.c_str(), client::state_name(client.cancel_job(id).state()).c_str());
  }
  return kExitDone;
}

int remove(const JobsOptions& options) {
  const client::Client client(options.coordinator, options.tls);
  for (const std::string& id : options.ids) {
    const v1::Job job = client.remove_job(id);
    std::printf("%s is removed (%.1f MB)\n", id.c_str(), static_cast<double>(job.bytes()) * 1e-6);
  }
  return kExitDone;
}

}  // namespace

std::vector<Command> add_jobs(CLI::App& root) {
  CLI::App* jobs = root.add_subcommand("jobs", "list, cancel and remove the jobs of a running coordinator");
  jobs->require_subcommand(1);
  std::vector<Command> commands;
  const auto add = [&](const std::string& name, const std::string& help, int (*work)(const JobsOptions&), bool ids) {
    const auto options = std::make_shared<JobsOptions>();
    CLI::App* app = jobs->add_subcommand(name, help);
    if (ids) {
      app->add_option("job", options->ids, "their ids")->required();
    } else {
      app->add_flag("--json", options->json, "one array of objects");
    }
    app->add_option("--coordinator", options->coordinator, "its address, as `pleat up` prints it")
        ->capture_default_str()
        ->envname("PLEAT_COORDINATOR");
    add_tls_options(*app, options->tls);
    commands.push_back({app, [options, work] { return work(*options); }});
  };
  add("list", "the jobs that you may read, newest first", list, false);
  add("cancel", "end jobs; their complete frames stay", cancel, true);
  add("remove", "remove jobs that have ended, with their files", remove, true);
  return commands;
}

}  // namespace pleat::cli
