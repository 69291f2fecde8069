#include "services/dataset/sequence.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/base/own_file.hpp"
#include "common/base/whole_file.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "common/store/hdf5.hpp"
#include "services/dataset/dressed_sets.hpp"
#include "services/dataset/poses.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::dataset {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kCheckpointInterval = 20;

/// A note of drop_sequence; null if it is none.
nlohmann::json read_dropped(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  const nlohmann::json note = nlohmann::json::parse(stream, nullptr, false);
  const bool whole = note.is_object() && note.contains("reason") && note["reason"].is_string() &&
                     note.contains("scene") && note["scene"].is_string();
  return whole ? note : nlohmann::json();
}

simulation::Mode mode_of(const SequencePlan& plan) {
  return plan.tracked ? simulation::Mode::kTrackedFine : simulation::Mode::kFreeFine;
}

SequenceOptions options_of(const SequencePlan& plan, const simulation::Simulation& simulation, bool deflate) {
  SequenceOptions options;
  options.name = plan.name;
  options.split = plan.split;
  options.scene = plan.scene_json;
  options.frames = static_cast<std::uint64_t>(plan.scene.frames);
  options.coarse_vertices = simulation.coarse().vertex_count();
  options.fine_vertices = simulation.fine().vertex_count();
  options.topology_hash = topology_hash(simulation.fine());
  if (plan.own_meshes) options.meshes = std::make_shared<MeshPair>(meshes_of(plan));
  options.obstacles = simulation.obstacle_shapes();
  for (const simulation::Obstacle& obstacle : plan.scene.obstacles) {
    options.obstacle_vertices.push_back(obstacle.mesh.vertex_count());
  }
  options.deflate = deflate;
  return options;
}

void sync(const fs::path& path) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  const bool synced = file >= 0 && ::fsync(file) == 0;
  const int cause = errno;
  if (file >= 0) ::close(file);
  if (!synced)
    throw Error(ErrorCode::kResourceExhausted, path.string() + ": can't be written: " + std::strerror(cause));
}

/// Lets a recording that nobody writes end after its first `frames`.
void forget_frames_after(const fs::path& partial, std::uint64_t frames) {
  const auto lock = hdf5::lock();
  hdf5::File file = hdf5::File::open_own(partial, true);
  file.set_attribute("/", "frames_complete", frames);
  file.close();
}

void save_checkpoint(const fs::path& path, const simulation::Simulation& simulation) {
  const std::vector<std::byte> bytes = simulation.checkpoint();
  write_whole_file(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

/// Restores the check-point if there is one that helps: not beyond the recorded frames, and of this very scene. What is
/// no check-point, by its own checksum, may be somebody's: it is set aside.
void restore_checkpoint(const fs::path& path, std::uint64_t frames_complete, const SequencePlan& plan,
                        simulation::Simulation& simulation) {
  std::error_code ignored;
  if (!fs::is_regular_file(fs::symlink_status(path, ignored))) return set_aside(path);
  std::ifstream stream(path, std::ios::binary);
  const std::vector<char> text((std::istreambuf_iterator<char>(stream)), {});
  std::vector<std::byte> bytes(text.size());
  std::transform(text.begin(), text.end(), bytes.begin(), [](char c) { return static_cast<std::byte>(c); });
  try {
    simulation.restore(bytes);
    if (simulation.next_index() <= frames_complete) return;
  } catch (const Error& error) {
    // Of another scene, or damaged: the frames are simulated again, which gives the same bits.
    if (error.code() == ErrorCode::kDataLoss) set_aside(path);
  }
  simulation = simulation::Simulation(plan.scene, mode_of(plan));
}

/// With all that its obstacles need to move.
SequencePlan complete(SequencePlan plan) {
  if (plan.body) put_body(plan.scene, *plan.body);
  for (std::size_t o = 0; plan.samples && o < plan.samples->size(); ++o) {
    plan.scene.obstacles[o].animation.samples = (*plan.samples)[o];
  }
  return plan;
}

}  // namespace

MeshPair meshes_of(const SequencePlan& plan) {
  const simulation::Scene& scene = plan.scene;
  Subdivision subdivision = subdivide(scene.garment, scene.subdivision_rounds, scene.subdivision_rule);
  return {scene.garment, std::move(subdivision.fine), std::move(subdivision.feature_vertices)};
}

fs::path sequence_file(const fs::path& folder, const std::string& name) {
  return folder / "sequences" / (name + ".h5");
}

fs::path partial_file(const fs::path& folder, const std::string& name) {
  return sequence_file(folder, name) += ".partial";
}

fs::path checkpoint_file(const fs::path& folder, const std::string& name) {
  return folder / "sequences" / (name + ".checkpoint");
}

fs::path dropped_file(const fs::path& folder, const std::string& name) {
  return folder / "sequences" / (name + ".dropped");
}

bool is_finished(const fs::path& folder, const std::string& name) {
  std::error_code error;
  return fs::exists(sequence_file(folder, name), error);
}

std::optional<std::string> why_dropped(const fs::path& folder, const SequencePlan& plan) {
  const nlohmann::json note = read_dropped(dropped_file(folder, plan.name));
  if (note.is_null() || note["scene"] != plan.scene_json) return std::nullopt;
  return note["reason"].get<std::string>();
}

std::optional<std::string> dropped_scene(const fs::path& folder, const std::string& name) {
  const nlohmann::json note = read_dropped(dropped_file(folder, name));
  return note.is_null() ? std::nullopt : std::optional(note["scene"].get<std::string>());
}

std::vector<std::pair<std::string, std::string>> dropped_sequences(const fs::path& folder) {
  std::vector<std::pair<std::string, std::string>> dropped;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder / "sequences", error)) {
    if (entry.path().extension() != ".dropped") continue;
    const nlohmann::json note = read_dropped(entry.path());
    if (!note.is_null()) dropped.emplace_back(entry.path().stem().string(), note["reason"].get<std::string>());
  }
  std::sort(dropped.begin(), dropped.end());
  return dropped;
}

void drop_sequence(const fs::path& folder, const SequencePlan& plan, const std::string& reason) {
  write_whole_file(dropped_file(folder, plan.name),
                   nlohmann::ordered_json{{"reason", reason}, {"scene", plan.scene_json}}.dump());
  std::error_code error;
  fs::remove(partial_file(folder, plan.name), error);
  fs::remove(checkpoint_file(folder, plan.name), error);
}

double seconds_per_frame(const SequencePlan& planned, int frames, double seconds) {
  using Clock = std::chrono::steady_clock;
  SequencePlan plan = complete(planned);
  plan.scene.threads = 1;
  simulation::Simulation simulation(plan.scene, mode_of(plan));
  const auto start = Clock::now();
  const auto elapsed = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };
  int made = 0;
  // Frame 0 is the initial state and costs nothing.
  const int last = std::min(frames, plan.scene.frames - 1);
  for (simulation.next_frame(); made < last && (made == 0 || elapsed() < seconds); ++made) simulation.next_frame();
  return elapsed() / std::max(1, made);
}

SequenceReport make_sequence(const fs::path& folder, const SequencePlan& planned, bool deflate,
                             const std::function<void(std::uint64_t)>& on_frame, const SequenceControl& control) {
  const SequencePlan plan = complete(planned);
  simulation::Simulation simulation(plan.scene, mode_of(plan));
  const SequenceOptions options = options_of(plan, simulation, deflate);
  std::optional<SequenceWriter> writer(std::in_place, folder, options);
  const fs::path checkpoint = checkpoint_file(folder, plan.name);
  restore_checkpoint(checkpoint, writer->frames_complete(), plan, simulation);
  if (control.durable && simulation.next_index() < writer->frames_complete()) {
    writer.reset();
    forget_frames_after(partial_file(folder, plan.name), simulation.next_index());
    writer.emplace(folder, options);
  }
  const auto save = [&] {
    if (control.durable) sync(partial_file(folder, plan.name));
    save_checkpoint(checkpoint, simulation);
  };

  std::optional<WornJudge> judge;
  if (plan.body) judge.emplace(plan.scene.garment.rest_positions, plan.scene.obstacles.front().mesh.rest_positions);

  SequenceReport report;
  std::uint64_t simulated = 0;
  while (writer->frames_complete() < options.frames) {
    if (control.stopped && control.stopped()) {
      if (simulation.next_index() > 0) save();
      report.interrupted = true;
      return report;
    }
    simulation::SimulatedFrame frame = simulation.next_frame();
    report.coarse_ms += frame.times.coarse_ms;
    report.fine_ms += frame.times.fine_ms;
    report.cut_steps += frame.report.cut_steps;
    ++simulated;
    if (judge) {
      const std::string fault =
          judge->why_not(frame.coarse.positions, frame.obstacles.front().positions, frame.report.obstacle_lag_m,
                         frame.report.cut_steps, plan.scene.steps_per_frame);
      if (!fault.empty()) {
        report.dropped = "frame " + std::to_string(frame.coarse.index) + ": " + fault;
        drop_sequence(folder, plan, report.dropped);
        return report;
      }
    }
    if (frame.coarse.index < writer->frames_complete()) continue;
    SequenceFrame record;
    record.time_s = frame.coarse.time_s;
    record.coarse = std::move(frame.coarse.positions);
    record.fine = std::move(frame.fine->positions);
    record.obstacles = std::move(frame.obstacles);
    writer->append(record);
    on_frame(writer->frames_complete());
    if (writer->frames_complete() % kCheckpointInterval == 0) save();
  }
  if (simulated > 0) {
    report.coarse_ms /= static_cast<double>(simulated);
    report.fine_ms /= static_cast<double>(simulated);
  }
  writer->finish();
  std::error_code error;
  fs::remove(checkpoint, error);
  fs::remove(dropped_file(folder, plan.name), error);  // of another scene
  return report;
}

}  // namespace pleat::dataset
