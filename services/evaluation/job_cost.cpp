#include "services/evaluation/job_cost.hpp"

#include <chrono>
#include <fstream>
#include <thread>

#include "common/base/error.hpp"
#include "common/base/scratch_folder.hpp"
#include "common/base/signals.hpp"
#include "common/client/cpp/client.hpp"
#include "services/cli/launcher/launcher.hpp"

namespace pleat::evaluation {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kWarmUp = 3;

/// VmHWM of /proc/PID/status, MiB; 0 if it can't be read.
double peak_mib(pid_t pid) {
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  const std::string key = "VmHWM:";
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with(key)) return std::stod(line.substr(key.size())) / 1024;  // in kB
  }
  return 0;
}

/// Looks often: a frame of the smallest size takes 5 ms.
void wait_job(const client::Client& client, v1::Job job, std::size_t frames, JobCost& cost) {
  Clock::time_point begin;
  std::size_t before = 0;
  while (!client::has_ended(job.state())) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
    job = client.get_job(job.id());
    if (before == 0 && job.frames_complete() >= kWarmUp) {
      before = job.frames_complete();
      begin = Clock::now();
    }
    if (job.frames_complete() >= frames) break;
  }
  const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
  while (!client::has_ended(job.state())) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    job = client.get_job(job.id());
  }
  if (job.state() != v1::Job::STATE_DONE) {
    throw_internal("job " + job.id() + " " + client::state_name(job.state()) + ": " + job.error());
  }
  cost.runs = frames - before;
  cost.frames_per_s = static_cast<double>(cost.runs) / seconds;
  cost.fine_vertices = job.summary().fine_vertices();
}

}  // namespace

JobCost job_cost(const v1::Scene& scene, const JobCostOptions& options) {
  if (options.frames <= 2 * kWarmUp) throw_invalid_argument("frames: more than " + std::to_string(2 * kWarmUp));
  std::filesystem::create_directories(options.out);
  const ScratchFolder work(options.out, cli::kWorkPrefix);
  cli::LauncherOptions launch;
  launch.models = options.models;
  launch.data = work.path();
  launch.logs = options.out / "logs";
  launch.network = options.detail != v1::DETAIL_FOLD;
  launch.fold = options.detail != v1::DETAIL_NETWORK;
  cli::Launcher launcher(launch);
  const client::Client client(launcher.coordinator());
  v1::CreateJobRequest request;
  *request.mutable_scene() = scene;
  request.set_frames(static_cast<std::uint32_t>(options.frames));
  request.set_detail(options.detail);
  request.set_model(options.model);
  JobCost cost;
  wait_job(client, client.create_job(request), options.frames, cost);
  for (const cli::Launcher::Service& service : launcher.services()) {
    cost.peak_mib.emplace_back(service.name, peak_mib(service.pid));
  }
  launcher.stop();
  return cost;
}

}  // namespace pleat::evaluation
