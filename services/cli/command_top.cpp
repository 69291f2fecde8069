// `pleat top`: what services do at the moment, from their metrics pages.
#include <httplib.h>

#include <chrono>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/error.hpp"
#include "common/base/signals.hpp"
#include "services/cli/command.hpp"
#include "services/cli/top.hpp"

namespace pleat::cli {
namespace {

using Clock = std::chrono::steady_clock;

struct TopOptions {
  std::vector<std::string> addresses;
  double interval_s = 2;
  int looks = 0;
  bool json = false;
};

/// Samples of all pages; who does not answer is named on stderr, once all are silent it is an error.
std::vector<MetricSample> look(const std::vector<std::string>& addresses) {
  std::vector<MetricSample> all;
  std::string silent;
  std::size_t answers = 0;
  for (const std::string& address : addresses) {
    httplib::Client client(address.find("://") == std::string::npos ? "http://" + address : address);
    client.set_connection_timeout(2);
    client.set_read_timeout(2);
    const auto answer = client.Get("/metrics");
    if (!answer || answer->status != 200) {
      silent += (silent.empty() ? "" : ", ") + address;
      continue;
    }
    ++answers;
    auto samples = parse_metrics(answer->body);
    std::move(samples.begin(), samples.end(), std::back_inserter(all));
  }
  if (answers == 0) {
    throw Error(ErrorCode::kUnavailable, silent + ": no metrics page there (services have one with --metrics-listen)");
  }
  if (!silent.empty()) std::fprintf(stderr, "no answer from %s\n", silent.c_str());
  return all;
}

nlohmann::ordered_json to_json(const ServiceLoad& service) {
  nlohmann::ordered_json stages = nlohmann::ordered_json::object();
  for (const auto& [name, load] : service.stages) {
    stages[name] = {{"frames_per_s", load.frames_per_s},
                    {"in_flight", load.in_flight},
                    {"window", load.window},
                    {"p50_ms", load.p50_ms},
                    {"p95_ms", load.p95_ms},
                    {"errors", load.errors}};
  }
  return {{"service", service.service},
          {"sessions", service.sessions},
          {"waiting", service.waiting},
          {"counts", service.counts},
          {"stages", std::move(stages)}};
}

int run(const TopOptions& options) {
  install_signal_handlers();
  std::vector<MetricSample> before = look(options.addresses);
  auto then = Clock::now();
  for (int shown = 0; options.looks == 0 || shown < options.looks; ++shown) {
    const auto next =
        then + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(options.interval_s));
    while (Clock::now() < next && !interrupted()) std::this_thread::sleep_for(std::chrono::milliseconds(50));
    if (interrupted()) break;
    std::vector<MetricSample> now = look(options.addresses);
    const std::chrono::duration<double> passed = Clock::now() - then;
    then = Clock::now();
    const auto services = loads(before, now, passed.count());
    if (options.json) {
      auto all = nlohmann::ordered_json::array();
      for (const ServiceLoad& service : services) all.push_back(to_json(service));
      std::printf("%s\n", all.dump().c_str());
    } else {
      std::printf("%s%s", shown > 0 ? "\n" : "", table_of(services).c_str());
    }
    std::fflush(stdout);
    before = std::move(now);
  }
  return kExitDone;
}

}  // namespace

std::vector<Command> add_top(CLI::App& root) {
  const auto options = std::make_shared<TopOptions>();
  CLI::App* app = root.add_subcommand("top", "what services do at the moment, from their metrics pages, until Ctrl-C");
  app->add_option("address", options->addresses, "metrics pages, HOST:PORT, as --metrics-listen names them")
      ->required();
  app->add_option("--interval", options->interval_s, "seconds between two looks")
      ->capture_default_str()
      ->check(CLI::Range(0.1, 3600.0));
  app->add_option("--looks", options->looks, "end after so many (default: with Ctrl-C)")->check(CLI::PositiveNumber);
  add_json_option(*app, options->json, "an array of services a line");
  return {{app, [options] { return run(*options); }}};
}

}  // namespace pleat::cli
