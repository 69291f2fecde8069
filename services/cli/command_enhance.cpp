// `pleat enhance`: coarse frames of another simulator through a live session.
#include <chrono>
#include <cstdio>

#include "common/base/progress.hpp"
#include "common/base/scratch_folder.hpp"
#include "common/mesh/garment.hpp"
#include "services/cli/command.hpp"
#include "services/cli/enhance_session.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/cli/output.hpp"
#include "services/cli/result_recorder.hpp"
#include "services/presentation/input/obstacle_input.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr double kDefaultFramesPerSecond = 25;
constexpr std::uint64_t kAllFrames = ~std::uint64_t{0};

struct EnhanceOptions {
  std::string rest, frames, out, model, coordinator;
  std::vector<std::string> obstacles;
  double fps = 0, timeout_s = 30, scale = 1;
  std::uint32_t window = 0, rounds = 2;
  std::uint64_t start = 0, end = kAllFrames, count = kAllFrames;
  rpc::TlsOptions tls;
};

int enhance(const EnhanceOptions& options) {
  std::vector<std::string> notes;
  const Topology rest = read_garment(options.rest, notes, options.scale);
  const auto sequence = presentation::open_frame_sequence(options.frames, rest);
  if (!sequence->warning().empty()) notes.push_back(sequence->warning());
  const presentation::ObstacleInput obstacles(options.obstacles);
  notes.insert(notes.end(), obstacles.notes().begin(), obstacles.notes().end());
  const bool own_obstacles = !options.obstacles.empty();
  const std::uint64_t end = std::min<std::uint64_t>(sequence->frame_count(), options.end);
  if (options.start >= end) {
    throw_invalid_argument(options.frames + ": no frame from " + std::to_string(options.start) + " to " +
                           std::to_string(end) + " of " + std::to_string(sequence->frame_count()));
  }
  const std::uint64_t start = options.start, count = std::min(end - start, options.count);
  const auto frame = [&](std::uint64_t k) -> Positions {
    return static_cast<float>(options.scale) * sequence->positions(start + k);
  };
  require_frame_of(frame(0), rest, options.frames + " frame " + std::to_string(start), options.rest);
  print_notes(notes);
  double frame_time = sequence->frame_time_s() > 0 ? sequence->frame_time_s() : 1 / kDefaultFramesPerSecond;
  if (options.fps > 0) frame_time = 1 / options.fps;
  const fs::path out = options.out;
  std::optional<ScratchFolder> work;
  std::optional<Launcher> launcher;
  ModelChoice model{options.model, {}};
  if (options.coordinator.empty()) model = choose_model(options.model);
  make_output_folder(out);
  std::string address = options.coordinator;
  if (address.empty()) {
    LauncherOptions launch;
    launch.models = model.folder;
    launch.model = model.name;
    work.emplace(out, kWorkPrefix);
    launch.data = work->path();
    launch.logs = out / "logs";
    launcher.emplace(launch);
    address = launcher->coordinator();
  }
  const auto channel = rpc::create_channel(address, options.tls);
  rpc::wait_healthy(channel, "pleat.v1.Coordinator", address,
                    std::chrono::milliseconds(static_cast<long>(options.timeout_s * 1000)));

  EnhanceSessionOptions open;
  open.coarse = rest;
  open.model = model.name;
  open.frame_time_s = frame_time;
  open.obstacles = own_obstacles ? obstacles.shapes() : sequence->obstacle_shapes();
  open.window = options.window;
  open.subdivision_rounds = options.rounds;
  EnhanceSession session(channel, address, open);
  ResultRecorder recorder(
      {out / "result.h5", session.topology(), count, frame_time, session.model(), "", open.obstacles});
  Progress progress("frames", count);
  const Clock::time_point began = Clock::now();
  try {
    session.run(
        count,
        [&](std::uint64_t k) {
          return CoarseInput{frame(k), own_obstacles ? obstacles.at(start + k) : sequence->obstacles(start + k)};
        },
        [&](const v1::EnhancedFrame& frame, const CoarseInput& input) {
          recorder.add(frame, input.positions, input.obstacles);
          progress.update(recorder.frames());
        });
  } catch (const Error& error) {
    if (recorder.frames() == 0) throw;
    recorder.finish();
    throw Error(error.code(), std::string(error.what()) + "; " + std::to_string(recorder.frames()) + " frames are in " +
                                  (out / "result.h5").string());
  }
  const double wall_s = std::chrono::duration<double>(Clock::now() - began).count();
  progress.finish();
  recorder.finish();
  if (launcher) launcher->stop();
  presentation::ReportSummary summary;
  summary.title = fs::path(options.rest).stem().string();
  summary.model = session.model();
  summary.device = session.device();
  summary.precision = session.precision();
  summary.wall_s = wall_s;
  return write_reports(out, std::move(summary));
}

}  // namespace

std::vector<Command> add_enhance(CLI::App& root) {
  CLI::App* app = root.add_subcommand("enhance", "enhance coarse frames made elsewhere; leaves result.h5 and a report");
  const auto options = std::make_shared<EnhanceOptions>();
  app->add_option("--rest", options->rest, "the coarse garment at rest, OBJ or PLY with material coordinates (vt)")
      ->required();
  app->add_option("--frames", options->frames,
                  "coarse frames: folder, 'glob*.obj', cloth_%04d.obj, FILE.pc2, .mdd, .npy, .h5:/array, result.h5, "
                  "DATASET/sequences/NAME.h5")
      ->required();
  app->add_option("--out", options->out, "folder for result.h5, report.json, report.html and logs")->required();
  app->add_option("--model", options->model,
                  "model bundle: a file, or a name in deploy/models (default: the service's)");
  app->add_option(
      "--obstacle", options->obstacles,
      "sphere:X,Y,Z,RADIUS, capsule:X,Y,Z,X,Y,Z,RADIUS, MESH.obj, or MESH.obj@FRAMES if it moves; may be repeated");
  app->add_option("--fps", options->fps, "frames a second of motion (default: the file's, or 25)")
      ->check(positive_number());
  app->add_option("--start", options->start, "the first frame, counted from 0")
      ->capture_default_str()
      ->check(natural_number());
  app->add_option("--end", options->end, "the frame after the last (default: all)")->check(positive_number());
  app->add_option("--count", options->count, "COUNT frames at most")->check(positive_number());
  app->add_option("--scale", options->scale, "metres per unit of the rest mesh and the frames: 0.01 for centimetres")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--rounds", options->rounds, "rounds of subdivision from the coarse to the fine mesh")
      ->capture_default_str()
      ->check(CLI::Range(0, 5));
  app->add_option("--window", options->window, "frames in flight, 1 to 64 (default: 4)")->check(CLI::Range(1, 64));
  app->add_option("--coordinator", options->coordinator,
                  "address of a running coordinator (default: start all services for this run)");
  app->add_option("--timeout", options->timeout_s, "seconds to wait for the coordinator")
      ->capture_default_str()
      ->check(positive_number());
  add_tls_options(*app, options->tls);
  return {{app, [options] { return enhance(*options); }}};
}

}  // namespace pleat::cli
