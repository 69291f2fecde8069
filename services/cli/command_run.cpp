// `pleat run`: simulate a scene and enhance it, with services of our own or a coordinator that is there. `pleat
// simulate`: the simulation alone.
#include <chrono>
#include <cstdio>
#include <numeric>

#include "common/base/own_file.hpp"
#include "common/base/progress.hpp"
#include "common/base/scratch_folder.hpp"
#include "common/base/signals.hpp"
#include "common/base/terminal.hpp"
#include "common/client/adapter/adapter.hpp"
#include "common/client/cpp/client.hpp"
#include "common/frame/scene_json.hpp"
#include "common/store/hdf5.hpp"
#include "services/cli/command.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/cli/output.hpp"
#include "services/cli/result_recorder.hpp"
#include "services/presentation/input/scene_file.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr std::chrono::seconds kCancelPatience{20};

struct RunOptions {
  std::string scene, out, model, detail, coordinator;
  std::string mode;  ///< coarse, tracked or free: only simulate; empty: enhance
  std::uint32_t frames = 0;
  bool reference = false;
  bool untangle = false;
  bool json = false;
  double timeout_s = 30, scale = 1;
  rpc::TlsOptions tls;
};

/// The job's frames as they come from a coordinator elsewhere, into DIR/result.h5, as the coordinator's own file has
/// them. Lives in the watcher's thread, until the watching is over.
class RemoteFrames {
 public:
  explicit RemoteFrames(RecordingOptions options) : options_(std::move(options)) {}

  client::JobSinks sinks() {
    return {.opened = [this](const client::JobMeshes& meshes) { open(meshes); },
            .frame = [this](const client::EnhancedFrame& frame) { add(frame); }};
  }
  void finish() {
    if (recorder_) recorder_->finish();
  }

 private:
  void open(const client::JobMeshes& meshes) {
    if (recorder_) return;
    options_.topology.coarse = client::to_topology(meshes.coarse);
    options_.topology.fine = client::to_topology(meshes.fine);
    options_.topology.feature_vertices.resize(meshes.coarse.vertex_count());
    std::iota(options_.topology.feature_vertices.begin(), options_.topology.feature_vertices.end(), 0u);
    options_.obstacles = client::to_shapes(meshes.obstacles);
    recorder_.emplace(options_);
  }
  void add(const client::EnhancedFrame& frame) {
    if (!recorder_) throw_internal("the coordinator sent a frame before the meshes");
    if (frame.error && frame.positions.empty()) throw *frame.error;  // an older coordinator sends nothing in its place
    recorder_->add(frame, client::to_positions(frame.coarse), client::to_obstacles(frame.obstacles));
  }

  RecordingOptions options_;
  std::optional<ResultRecorder> recorder_;
};

class Run {
 public:
  explicit Run(const RunOptions& options) : options_(options), out_(options.out) {}

  int operator()() {
    const v1::Detail detail =
        options_.mode.empty() ? choose_detail(options_.detail, options_.model) : detail_named(options_.mode);
    std::vector<std::string> notes;
    v1::Scene scene = presentation::read_scene_file(shipped_or(options_.scene, "scenes"),
                                                    {options_.frames, options_.scale, &notes, &bodies_});
    print_notes(notes);
    if (options_.untangle) scene.set_untangle(true);
    const bool local = options_.coordinator.empty();
    ModelChoice model{options_.model, {}};
    if (local && uses_network(detail)) model = choose_model(options_.model);
    make_output_folder(out_);

    if (local) {
      LauncherOptions launch;
      launch.models = model.folder;
      launch.model = model.name;
      launch.network = uses_network(detail);
      launch.fold = uses_fold(detail);
      work_.emplace(out_, kWorkPrefix);
      launch.data = work_->path();
      launch.logs = out_ / "logs";
      launcher_.emplace(launch);
      client_.emplace(launcher_->coordinator(), rpc::TlsOptions{}, traceparent());
    } else {
      client_.emplace(options_.coordinator, options_.tls, traceparent());
      client_->wait_ready(std::chrono::milliseconds(static_cast<long>(options_.timeout_s * 1000)));
    }

    v1::CreateJobRequest request;
    request.set_model(model.name);
    request.set_frames(options_.frames);
    request.set_reference(options_.reference);
    // Without the option another coordinator takes its own default.
    request.set_detail(local || is_simulated(detail) ? detail : detail_named(options_.detail));
    const std::uint32_t frames = options_.frames > 0 ? options_.frames : scene.frames();
    const double frame_time = scene.frame_time_s() > 0 ? scene.frame_time_s() : kDefaultFrameTime;
    RemoteFrames remote({out_ / "result.h5", {}, frames, frame_time, model.name, scene_json(scene), {}, detail});
    *request.mutable_scene() = std::move(scene);

    v1::Job job = client_->create_job(request);
    say("job " + job.id() + " of " + std::to_string(frames) + " frames at " + client_->address() + ", detail " +
        std::string(name_of(detail)) + (model.name.empty() ? "" : ", model " + model.name));
    try {
      job = follow(job, local ? client::JobSinks{} : remote.sinks());
    } catch (const Error& error) {
      if (!local) throw;
      const fs::path kept = take_result(job.id());
      throw Error(error.code(), error.what() + (kept.empty() ? "" : "; what there is is in " + kept.string()));
    }
    const fs::path kept = local ? take_result(job.id()) : finish_remote(remote, job);
    return end(job, kept);
  }

 private:
  /// Shows the job's progress until it has ended; Ctrl-C cancels it.
  v1::Job follow(v1::Job job, client::JobSinks sinks) {
    const client::JobWatcher watcher = client_->watch_job(job.id(), std::move(sinks));
    std::optional<Progress> progress;
    v1::Job::State shown = v1::Job::STATE_UNSPECIFIED;
    std::optional<Clock::time_point> cancelled;
    int warned = 0;
    while (true) {
      const auto [latest, over] = watcher.wait(std::chrono::milliseconds(50));
      if (!latest.id().empty()) job = latest;
      const bool reference = job.state() == v1::Job::STATE_REFERENCE;
      if (job.state() != shown && (reference || job.state() == v1::Job::STATE_RUNNING)) {
        if (progress) {
          progress->update(job.frames_complete());
          progress->finish();
        }
        progress.emplace(reference ? "reference" : "frames", job.frames());
        shown = job.state();
      }
      for (; progress && warned < job.warnings_size(); ++warned) progress->line("warning: " + job.warnings(warned));
      if (progress && !over) progress->update(reference ? job.reference_frames_complete() : job.frames_complete());
      if (over) {
        if (progress) {
          const bool of_reference = shown == v1::Job::STATE_REFERENCE;
          progress->update(of_reference ? job.reference_frames_complete() : job.frames_complete());
          progress->finish(job.state() == v1::Job::STATE_DONE ? "" : client::state_name(job.state()));
        }
        return job;
      }
      if (launcher_) {
        for (const std::string& line : launcher_->supervise()) std::fprintf(stderr, "%s\n", line.c_str());
      }
      if (interrupted() && !cancelled) {
        cancelled = Clock::now();
        client_->cancel_job(job.id());
      }
      if (cancelled && Clock::now() - *cancelled > kCancelPatience)
        throw Error(ErrorCode::kDeadlineExceeded, "interrupted, and the job did not end");
    }
  }

  /// The job's file comes to us. Returns what was kept, if anything.
  fs::path take_result(const std::string& job) {
    launcher_->stop();
    fs::path kept;
    std::error_code failed;
    const fs::path source = work_->path() / "jobs" / job / "result.h5";
    for (const char* ending : {"", ".partial"}) {
      const fs::path from = source.string() + ending;
      const fs::path to = (out_ / "result.h5").string() + ending;
      if (!fs::is_regular_file(from, failed)) continue;
      // It was ours or absent when we began; what has come since may be somebody's.
      if (!hdf5::is_own(to)) set_aside(to);
      fs::rename(from, to, failed);
      if (failed) throw Error(ErrorCode::kResourceExhausted, to.string() + ": " + failed.message());
      take_over(to);
      kept = to;
      break;
    }
    return kept;
  }

  fs::path finish_remote(RemoteFrames& remote, const v1::Job& job) {
    if (job.frames_complete() == 0) return {};
    remote.finish();
    return out_ / "result.h5";
  }

  int end(const v1::Job& job, const fs::path& kept) {
    const std::string state =
        kept.empty() ? "nothing was kept" : std::to_string(job.frames_complete()) + " frames are in " + kept.string();
    if (job.state() == v1::Job::STATE_CANCELLED)
      throw Error(ErrorCode::kCancelled, "job " + job.id() + " was cancelled; " + state);
    if (job.state() != v1::Job::STATE_DONE)
      throw Error(ErrorCode::kInternal, "job " + job.id() + " failed: " + job.error() + "; " + state);
    if (kept.empty()) throw_internal("job " + job.id() + " is done but left no result");
    presentation::ReportSummary summary;
    summary.title = job.scene_name();
    summary.model = job.summary().model();
    summary.device = job.summary().device();
    summary.precision = job.summary().precision();
    summary.wall_s = job.summary().wall_s();
    // An older coordinator says nothing, and has a network.
    const v1::Detail detail = job.summary().detail();
    summary.extra["detail"] = name_of(detail == v1::DETAIL_UNSPECIFIED ? v1::DETAIL_NETWORK : detail);
    summary.extra["frame_errors"] = job.summary().frame_errors();
    summary.extra["pinched_frames"] = job.summary().pinched_frames();
    summary.extra["pinch_depth_mm"] = 1e3 * static_cast<double>(job.summary().pinch_depth_m());
    return write_reports(out_, std::move(summary), options_.json, bodies_);
  }

  RunOptions options_;
  fs::path out_;
  std::vector<presentation::SceneBody> bodies_;
  std::optional<ScratchFolder> work_;  // after the services' end it goes, with what they kept
  std::optional<Launcher> launcher_;
  std::optional<client::Client> client_;
};

/// What `run` and `simulate` have in common.
void add_scene_options(CLI::App& app, RunOptions& options) {
  app.add_option("scene", options.scene, "scene file, or the name of a shipped one: draping, curtain, dancer")
      ->required();
  app.add_option("--out", options.out, "folder for result.h5, report.json, report.html and logs")->required();
  app.add_option("--frames", options.frames, "frames to make (default: the scene's)")->check(positive_number());
  app.add_option("--coordinator", options.coordinator,
                 "address of a running coordinator (default: start all services for this run)");
  app.add_flag("--untangle", options.untangle,
               "relax a start with self-intersections or penetrations until it is clean, instead of refusing it");
  app.add_option("--scale", options.scale, "metres per unit of the garment's file: 0.01 for centimetres")
      ->capture_default_str()
      ->check(positive_number());
  app.add_option("--timeout", options.timeout_s, "seconds to wait for the coordinator")
      ->capture_default_str()
      ->check(positive_number());
  add_json_option(app, options.json, "print report.json instead of a summary");
  add_tls_options(app, options.tls);
}

}  // namespace

std::vector<Command> add_run(CLI::App& root) {
  CLI::App* app = root.add_subcommand("run", "simulate a scene and enhance it; leaves result.h5 and a report");
  const auto options = std::make_shared<RunOptions>();
  add_scene_options(*app, *options);
  app->add_option(
      "--model", options->model,
      "model bundle: a file, or a name in deploy/models, or none: smooth upsampling (default: the service's)");
  add_detail_option(*app, options->detail);
  app->add_flag("--reference,!--no-reference", options->reference,
                "also simulate the tracked fine cloth, for comparison; the time of the run excludes it");
  return {{app, [options] { return Run(*options)(); }}};
}

std::vector<Command> add_simulate(CLI::App& root) {
  CLI::App* app =
      root.add_subcommand("simulate", "simulate a scene alone; leaves result.h5 and a report as `run` does");
  const auto options = std::make_shared<RunOptions>();
  add_scene_options(*app, *options);
  options->mode = "coarse";
  app->add_option("--mode", options->mode,
                  "coarse, or with a fine cloth that tracks the coarse one as data sets have it, or is free of it")
      ->capture_default_str()
      ->check(CLI::IsMember({"coarse", "tracked", "free"}));
  return {{app, [options] { return Run(*options)(); }}};
}

}  // namespace pleat::cli
