// `pleat enhance`: coarse frames of another simulator through a live session.
#include <chrono>
#include <cstdio>
#include <optional>

#include "common/base/progress.hpp"
#include "common/base/scratch_folder.hpp"
#include "common/base/signals.hpp"
#include "common/base/terminal.hpp"
#include "common/base/text_file.hpp"
#include "common/client/adapter/adapter.hpp"
#include "common/client/cpp/client.hpp"
#include "common/mesh/garment.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/cli/command.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/cli/output.hpp"
#include "services/cli/result_recorder.hpp"
#include "services/presentation/input/obstacle_input.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr double kDefaultFramesPerSecond = 25;
constexpr std::chrono::milliseconds kPatience{60'000};  // a service that is started again takes its time
constexpr std::uint64_t kAllFrames = ~std::uint64_t{0};

struct EnhanceOptions {
  std::vector<std::string> frames;
  std::string rest, out, up = "y", model, detail, material, coordinator;
  std::vector<std::string> obstacles;
  double fps = 0, timeout_s = 30, scale = 1;
  bool json = false;
  std::uint32_t window = 0;
  std::optional<std::uint32_t> rounds;
  std::vector<std::uint32_t> held;
  std::uint64_t start = 0, end = kAllFrames, count = kAllFrames;
  rpc::TlsOptions tls;
};

/// What a frame gets that could not be enhanced: the upsampled coarse mesh, as in the files of jobs.
class StandIn {
 public:
  StandIn(const Topology& coarse, const client::Mesh& fine) : coarse_(coarse), fine_(fine) {}

  std::vector<float> positions(const Positions& coarse) {
    if (!subdivision_) {
      const auto spec = find_subdivision(coarse_, client::to_topology(fine_));
      if (!spec) throw_internal("the session's fine mesh is not a subdivision of the coarse one");
      subdivision_ = subdivide(coarse_, *spec);
    }
    return client::from_positions(upsample(*subdivision_, coarse_.faces, coarse));
  }

 private:
  const Topology& coarse_;
  const client::Mesh& fine_;
  std::optional<Subdivision> subdivision_;
};

int enhance(EnhanceOptions options) {
  const v1::Detail detail = choose_detail(options.detail, options.model);
  std::vector<std::string> notes;
  const presentation::AxesAndUnit files{options.scale, options.up == "z"};
  presentation::RestMesh garment =
      options.rest.empty() ? presentation::rest_of_frames(options.frames, options.scale, notes)
                           : presentation::RestMesh{options.rest, read_garment(options.rest, notes, options.scale)};
  // Its scale is the reader's, which takes material coordinates along.
  garment.mesh.rest_positions = presentation::AxesAndUnit{1, files.z_up}(std::move(garment.mesh.rest_positions));
  const Topology& rest = garment.mesh;
  const std::string& source = options.frames.front();
  const auto sequence = presentation::open_frame_sequence(options.frames, rest);
  if (!sequence->warning().empty()) notes.push_back(sequence->warning());
  const presentation::ObstacleInput obstacles(options.obstacles, files);
  notes.insert(notes.end(), obstacles.notes().begin(), obstacles.notes().end());
  const bool own_obstacles = !options.obstacles.empty();
  const std::uint64_t end = std::min<std::uint64_t>(sequence->frame_count(), options.end);
  if (options.start >= end) {
    throw_invalid_argument(source + ": no frame from " + std::to_string(options.start) + " to " + std::to_string(end) +
                           " of " + std::to_string(sequence->frame_count()));
  }
  const std::uint64_t start = options.start, count = std::min(end - start, options.count);
  const auto frame = [&](std::uint64_t k) { return files(sequence->positions(start + k)); };
  require_frame_of(frame(0), rest, source + " frame " + std::to_string(start), garment.name);
  print_notes(notes);
  double frame_time = sequence->frame_time_s() > 0 ? sequence->frame_time_s() : 1 / kDefaultFramesPerSecond;
  if (options.fps > 0) frame_time = 1 / options.fps;
  const fs::path out = options.out;
  std::optional<ScratchFolder> work;
  std::optional<Launcher> launcher;
  const std::string material =
      options.material.empty() ? "" : read_text_file(shipped_or(options.material, "materials"));
  ModelChoice model{options.model, {}};
  if (options.coordinator.empty() && uses_network(detail)) model = choose_model(options.model);
  make_output_folder(out);
  std::string address = options.coordinator;
  if (address.empty()) {
    LauncherOptions launch;
    launch.models = model.folder;
    launch.model = model.name;
    launch.network = uses_network(detail);
    launch.fold = uses_fold(detail);
    work.emplace(out, kWorkPrefix);
    launch.data = work->path();
    launch.logs = out / "logs";
    launcher.emplace(launch);
    address = launcher->coordinator();
  }
  client::Client client(address, options.tls, traceparent());
  client.wait_ready(std::chrono::milliseconds(static_cast<long>(options.timeout_s * 1000)));

  const auto while_away = [&launcher] {
    if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
    if (!launcher) return;
    for (const std::string& line : launcher->supervise()) std::fprintf(stderr, "%s\n", line.c_str());
  };
  const std::vector<ObstacleShape> shapes = own_obstacles ? obstacles.shapes() : sequence->obstacle_shapes();
  client::EnhanceSession session = client.enhance({.coarse = client::from_topology(rest),
                                                   .model = model.name,
                                                   .frame_time_s = frame_time,
                                                   .obstacles = client::from_shapes(shapes),
                                                   .window = options.window,
                                                   .subdivision_rounds = options.rounds,
                                                   .detail = launcher ? detail : detail_named(options.detail),
                                                   .material_json = material,
                                                   .held = options.held,
                                                   .patience = kPatience,
                                                   .away = while_away});
  const client::SessionInfo& info = session.info();
  say("session of " + std::to_string(count) + " frames at " + address + ": " + std::to_string(rest.vertex_count()) +
      " -> " + std::to_string(info.fine.vertex_count()) + " vertices, detail " + std::string(name_of(info.detail)) +
      (info.model.empty() ? "" : ", model " + info.model));
  ResultRecorder recorder({out / "result.h5",
                           {rest, client::to_topology(info.fine), info.feature_vertices},
                           count,
                           frame_time,
                           info.model,
                           "",
                           shapes,
                           detail});
  StandIn stand_in(rest, info.fine);
  std::optional<Error> first_error;
  Progress progress("frames", count);
  const Clock::time_point began = Clock::now();
  try {
    session.run(
        count,
        [&](std::uint64_t k) {
          while_away();
          client::CoarseFrame coarse;
          coarse.index = k;
          coarse.time_s = frame_time * static_cast<double>(k);
          coarse.positions = client::from_positions(frame(k));
          coarse.obstacles =
              client::from_obstacles(own_obstacles ? obstacles.at(start + k) : sequence->obstacles(start + k));
          return coarse;
        },
        [&](client::EnhancedFrame answer, const client::CoarseFrame& input) {
          if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
          Positions coarse = client::to_positions(input.positions);
          if (answer.error) {
            if (!first_error) first_error = answer.error;
            progress.line(std::string(answer.error->what()) + "; the upsampled coarse mesh stands in its place");
            answer.time_s = input.time_s;
            answer.positions = stand_in.positions(coarse);
          }
          recorder.add(answer, std::move(coarse), client::to_obstacles(input.obstacles));
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
  if (recorder.frame_errors() == count)
    throw Error(first_error->code(), std::string("no frame could be enhanced; ") + first_error->what());
  if (launcher) launcher->stop();
  presentation::ReportSummary summary;
  summary.title = fs::path(garment.name).stem().string();
  summary.model = info.model;
  summary.device = info.device;
  summary.precision = info.precision;
  summary.wall_s = wall_s;
  summary.extra["detail"] = name_of(info.detail);
  summary.extra["frame_errors"] = recorder.frame_errors();
  return write_reports(out, std::move(summary), options.json);
}

}  // namespace

std::vector<Command> add_enhance(CLI::App& root) {
  CLI::App* app = root.add_subcommand("enhance", "enhance coarse frames made elsewhere; leaves result.h5 and a report");
  const auto options = std::make_shared<EnhanceOptions>();
  app->add_option("frames,--frames", options->frames,
                  "coarse frames: mesh files, a folder of them, cloth_%04d.obj, FILE.abc, .fbx, .glb, .usda, .pc2, "
                  ".mdd, .npy, .h5:/array, result.h5, DATASET/sequences/NAME.h5")
      ->required();
  app->add_option("--rest", options->rest,
                  "the coarse garment at rest, a mesh with material coordinates (vt) (default: the frames' own, or "
                  "FILE.obj beside FILE.pc2)");
  app->add_option("--out", options->out, "folder for result.h5, report.json, report.html and logs")->required();
  app->add_option(
      "--model", options->model,
      "model bundle: a file, or a name in deploy/models, or none: smooth upsampling (default: the service's)");
  add_detail_option(*app, options->detail);
  app->add_option("--material", options->material,
                  "what the cloth is made of, for the fold step: a material file, or the name of a shipped one "
                  "(default: gray-interlock)");
  app->add_option("--held", options->held,
                  "coarse vertices that the cloth is held at, for the fold step: indices with commas")
      ->delimiter(',');
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
  app->add_option("--scale", options->scale, "metres per unit of the files, obstacles too: 0.01 for centimetres")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--up", options->up, "the axis that is up in the files")
      ->capture_default_str()
      ->check(CLI::IsMember({"y", "z"}));
  app->add_option("--rounds", options->rounds,
                  "rounds of subdivision from the coarse to the fine mesh (default: the bundle's)")
      ->check(CLI::Range(0, 5));
  app->add_option("--window", options->window, "frames in flight, 1 to 64 (default: 4)")->check(CLI::Range(1, 64));
  app->add_option("--coordinator", options->coordinator,
                  "address of a running coordinator (default: start all services for this run)");
  app->add_option("--timeout", options->timeout_s, "seconds to wait for the coordinator")
      ->capture_default_str()
      ->check(positive_number());
  add_json_option(*app, options->json, "print report.json instead of a summary");
  add_tls_options(*app, options->tls);
  return {{app, [options] { return enhance(*options); }}};
}

}  // namespace pleat::cli
