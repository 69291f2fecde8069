// Benchmarks that need processes: the network, and the whole pipeline.
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <random>
#include <span>
#include <string>
#include <thread>

#include "common/base/process.hpp"
#include "common/base/scratch_folder.hpp"
#include "common/base/signals.hpp"
#include "common/base/statistics.hpp"
#include "common/client/adapter/adapter.hpp"
#include "common/client/cpp/client.hpp"
#include "common/frame/detail.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/obj.hpp"
#include "common/rpc/status.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/conversion/spec_messages.hpp"
#include "services/evaluation/bench.hpp"
#include "services/evaluation/bench_inputs.hpp"
#include "services/evaluation/superres_process.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::evaluation {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr std::size_t kWarmUp = 3;

std::filesystem::path log_file(const BenchOptions& options, const std::string& precision) {
  return options.out / "logs" / ("superres-" + precision + ".log");
}

using Extents = std::array<std::int64_t, 2>;

/// Height and width of what a bundle reads: its own, or what its representation makes of the garment.
Extents input_size(const v1::Representation& message, const Topology& garment) {
  const auto spec = conversion::spec_from(message, conversion::ImageSpec{}.max_fine_texels);
  if (const auto own = conversion::answer_form(spec).input_size) return *own;
  const std::vector<std::int64_t> shape = conversion::make_representation(garment, spec)->input_shape();
  return {shape.at(1), shape.at(2)};
}

/// The shipped garment that a bundle was trained for; `fallback` if there is none, or the bundle serves any.
Topology garment_of(const v1::ModelDescription& model, const Topology& fallback) {
  if (model.topology_hash().empty()) return fallback;
  for (const auto& file : fs::directory_iterator(shipped_file("garments"))) {
    if (file.path().extension() != ".obj") continue;
    Topology garment = read_obj(file.path());
    if (topology_hash(garment) == model.topology_hash()) return garment;
  }
  return fallback;
}

/// Random values: (channels, height, width).
v1::Tensor random_image(std::int64_t channels, const Extents& size) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> value(0.3f, 0.7f);
  v1::Tensor image;
  for (const std::int64_t extent : {channels, size[0], size[1]}) image.add_shape(static_cast<std::uint32_t>(extent));
  for (std::int64_t i = 0; i < channels * size[0] * size[1]; ++i) image.add_values(value(random));
  return image;
}

/// Milliseconds of each inference of random images of the bundle's size, as the service measures them.
std::vector<double> infer(SuperresProcess& service, const std::string& model, const Topology& garment, std::size_t runs,
                          std::string* precision) {
  const auto stream = service.stream();
  const v1::ModelDescription description = service.describe(model);
  const v1::Representation& representation = description.representation();
  const Extents size = input_size(representation, garment_of(description, garment));
  v1::UpscaleRequest request;
  request.mutable_open()->set_model(model);
  request.mutable_open()->set_window(1);
  if (description.constant_channels() > 0) {
    *request.mutable_open()->mutable_constants() = random_image(description.constant_channels(), size);
  }
  const v1::ModelDescription opened = stream->open(request);
  *precision = opened.precision();
  const std::int64_t channels = representation.input().scale_size();
  *request.mutable_frame()->mutable_image() =
      random_image(std::max<std::int64_t>(1, representation.window()) * channels, size);
  *request.mutable_frame()->mutable_alignment() = to_message(RigidTransform{});
  std::vector<double> ms;
  for (std::size_t r = 0; r < runs + kWarmUp; ++r) {
    request.mutable_frame()->set_index(r);
    const v1::ImageFrame frame = upscale(*stream, request);
    double sum = 0;
    for (const v1::StageTime& time : frame.stage_times())
      if (time.stage() == "superres") sum += time.ms();
    if (r >= kWarmUp) ms.push_back(sum);
  }
  return ms;
}

double frames_per_second(const client::Client& client, const BenchOptions& options, v1::Detail detail) {
  v1::CreateJobRequest request;
  *request.mutable_scene() = presentation::read_scene_file(scene_or(options, "draping"));
  request.set_frames(static_cast<std::uint32_t>(options.frames));
  request.set_detail(detail);
  const v1::Job job = client.create_job(request);
  const client::JobWatcher watcher = client.watch_job(job.id());
  while (true) {
    const auto [latest, over] = watcher.wait(std::chrono::milliseconds(100));
    if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
    if (!over) continue;
    if (latest.state() != v1::Job::STATE_DONE)
      throw_internal("job " + job.id() + " " + client::state_name(latest.state()) + ": " + latest.error());
    return latest.summary().wall_s() > 0 ? latest.frames_complete() / latest.summary().wall_s() : 0;
  }
}

/// What a live session with one frame in flight takes, what of it each stage, and what is no stage's.
struct Latency {
  std::vector<double> ms, transport_share;
  std::map<std::string, std::vector<double>> stage_ms;
};

Latency live_latency(const client::Client& client, const simulation::Scene& scene,
                     const simulation::Simulation& simulation, std::span<const client::CoarseFrame> inputs,
                     v1::Detail detail) {
  client::EnhanceSession session =
      client.enhance({.coarse = client::from_topology(simulation.coarse()),
                      .frame_time_s = scene.frame_time_s,
                      .obstacles = client::from_shapes(simulation.obstacle_shapes()),
                      .window = 1,
                      .subdivision_rounds = static_cast<std::uint32_t>(scene.subdivision_rounds),
                      .detail = detail});
  Latency latency;
  Clock::time_point sent;
  session.run(
      inputs.size(),
      [&](std::uint64_t k) {
        if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
        sent = Clock::now();
        return inputs[k];
      },
      [&](const client::EnhancedFrame& frame, const client::CoarseFrame&) {
        const double ms = std::chrono::duration<double, std::milli>(Clock::now() - sent).count();
        if (frame.error) throw *frame.error;
        if (frame.index < kWarmUp) return;
        double stages = 0;
        for (const client::StageTime& time : frame.stage_times) {
          if (time.stage.find('.') != std::string::npos) continue;
          stages += time.ms;
          latency.stage_ms[time.stage].push_back(time.ms);
        }
        latency.ms.push_back(ms);
        latency.transport_share.push_back(1 - stages / ms);
      });
  return latency;
}

}  // namespace

Figures bench_superres(const BenchOptions& options) {
  const Topology garment = load_bench_scene(scene_or(options, "draping"), options.frames).garment;
  Figures figures;
  std::string precision;
  {
    SuperresProcess service(options.models, "auto", log_file(options, "auto"));
    const std::vector<double> ms = infer(service, service.describe().model(), garment, options.frames, &precision);
    figures.push_back({"infer", {median(ms), ms.size(), "ms"}});
  }
  for (const std::string wanted : {"float32", "bfloat16"}) {
    std::optional<SuperresProcess> service;
    try {
      service.emplace(options.models, wanted, log_file(options, wanted));
    } catch (const Error& error) {
      if (error.code() == ErrorCode::kCancelled) throw;
      std::fprintf(stderr, "%s is left out: %s\n", wanted.c_str(), error.what());
      continue;
    }
    for (const v1::ModelDescription& model : service->models()) {
      const std::vector<double> ms = infer(*service, model.model(), garment, options.frames, &precision);
      if (precision != wanted) continue;  // the bundle refuses it
      figures.push_back({"infer/" + model.model() + "/" + wanted, {median(ms), ms.size(), "ms"}});
    }
  }
  return figures;
}

Figures bench_pipeline(const BenchOptions& options) {
  simulation::Scene scene = simulation::scene_from_message(presentation::read_scene_file(scene_or(options, "draping")));
  scene.frames = static_cast<int>(options.frames);
  simulation::Simulation simulation(scene, simulation::Mode::kCoarse);
  std::vector<client::CoarseFrame> inputs;
  for (std::size_t k = 0; k < options.frames; ++k) {
    const simulation::SimulatedFrame frame = simulation.next_frame();
    inputs.push_back({.index = k,
                      .time_s = scene.frame_time_s * static_cast<double>(k),
                      .positions = client::from_positions(frame.coarse.positions),
                      .velocities = {},
                      .obstacles = client::from_obstacles(frame.obstacles)});
  }
  cli::LauncherOptions launch;
  launch.models = options.models;
  std::filesystem::create_directories(options.out);
  const ScratchFolder work(options.out, cli::kWorkPrefix);
  launch.data = work.path();
  launch.logs = options.out / "logs";
  cli::Launcher launcher(launch);
  const client::Client client(launcher.coordinator());
  Figures figures;
  for (const v1::Detail detail : {v1::DETAIL_NETWORK, v1::DETAIL_FOLD}) {
    const std::string prefix = detail == v1::DETAIL_NETWORK ? "" : std::string(name_of(detail)) + "/";
    const double rate = frames_per_second(client, options, detail);
    const Latency latency = live_latency(client, scene, simulation, inputs, detail);
    figures.push_back({prefix + "frames_per_s", {rate, 1, "1/s"}});
    figures.push_back({prefix + "latency", {median(latency.ms), latency.ms.size(), "ms"}});
    figures.push_back({prefix + "transport_share", {median(latency.transport_share), latency.ms.size(), "1"}});
    for (const auto& [stage, ms] : latency.stage_ms)
      figures.push_back({prefix + "latency/" + stage, {median(ms), ms.size(), "ms"}});
  }
  launcher.stop();
  return figures;
}

nlohmann::json to_json(const std::string& name, const Figures& figures) {
  nlohmann::json json = nlohmann::json::object();
  json[name] = nlohmann::json::object();
  for (const auto& [figure, value] : figures)
    json[name][figure] = {{"median", value.median}, {"runs", value.runs}, {"unit", value.unit}};
  return json;
}

}  // namespace pleat::evaluation
