#include "services/simulation/simulation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <numbers>
#include <random>
#include <type_traits>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/base/parallel.hpp"
#include "common/base/random.hpp"
#include "common/features/frame_features.hpp"
#include "services/simulation/cloth.hpp"
#include "services/simulation/handle_watch.hpp"
#include "services/simulation/obstacles.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

// Check-points: a header, then the raw values in the order of Cloth::archive, little-endian as the machine has them.
constexpr char kMagic[8] = {'p', 'l', 'e', 'a', 't', 's', 'i', 'm'};
constexpr std::uint32_t kVersion = 1;
// Metres. An obstacle that is nearer to its script than this is where it should be.
constexpr double kLag = 1e-6;

class Writer {
 public:
  explicit Writer(std::vector<std::byte>& bytes) : bytes_(bytes) {}
  void raw(const void* data, std::size_t size) {
    const std::size_t before = bytes_.size();
    bytes_.resize(before + size);
    if (size > 0) std::memcpy(bytes_.data() + before, data, size);
  }
  template <typename T>
  void value(const T& v) {
    raw(&v, sizeof(v));
  }
  template <typename T>
  void array(const std::vector<T>& v) {
    value(static_cast<std::uint64_t>(v.size()));
    raw(v.data(), v.size() * sizeof(T));
  }
  void vectors(const Points& v) { array(v); }
  void floats(const std::vector<float>& v) { array(v); }
  void registers(const std::vector<Float4>& v) { array(v); }
  void vector(const Vector3d& v) { raw(v.data(), 3 * sizeof(double)); }
  void flag(bool f) { value(static_cast<std::uint8_t>(f)); }

 private:
  std::vector<std::byte>& bytes_;
};

class Reader {
 public:
  explicit Reader(std::span<const std::byte> bytes) : bytes_(bytes) {}
  void raw(void* data, std::size_t size) {
    if (size > bytes_.size()) throw_data_loss("simulation check-point: truncated");
    if (size > 0) std::memcpy(data, bytes_.data(), size);
    bytes_ = bytes_.subspan(size);
  }
  template <typename T>
  void value(T& v) {
    raw(&v, sizeof(v));
  }
  // The arrays of a state have fixed sizes: another one means that the bytes are not of this simulation.
  template <typename T>
  void array(std::vector<T>& v) {
    std::uint64_t size = 0;
    value(size);
    if (size != v.size()) throw_data_loss("simulation check-point: an array of another size");
    raw(v.data(), v.size() * sizeof(T));
    const auto* bytes = reinterpret_cast<const unsigned char*>(v.data());
    check_finite(bytes, v.size() * sizeof(T), std::is_same_v<T, Vector3d>);
  }
  void vectors(Points& v) { array(v); }
  void floats(std::vector<float>& v) { array(v); }
  void registers(std::vector<Float4>& v) { array(v); }
  void vector(Vector3d& v) { raw(v.data(), 3 * sizeof(double)); }
  void flag(bool& f) {
    std::uint8_t byte = 0;
    value(byte);
    f = byte != 0;
  }
  bool at_end() const { return bytes_.empty(); }

 private:
  template <typename T>
  static void check_finite_as(const unsigned char* bytes, std::size_t size) {
    for (std::size_t at = 0; at + sizeof(T) <= size; at += sizeof(T)) {
      T number;
      std::memcpy(&number, bytes + at, sizeof(T));
      if (!std::isfinite(number)) throw_data_loss("simulation check-point: a value is not finite");
    }
  }
  static void check_finite(const unsigned char* bytes, std::size_t size, bool doubles) {
    doubles ? check_finite_as<double>(bytes, size) : check_finite_as<float>(bytes, size);
  }

  std::span<const std::byte> bytes_;
};

// What a check-point must agree on: everything that decides the motion.
std::uint64_t scene_fingerprint(const Scene& s, Mode mode) {
  std::vector<std::byte> bytes;
  Writer w(bytes);
  const auto mesh = [&](const Topology& t) {
    const std::string hash = topology_hash(t);
    w.raw(hash.data(), hash.size());
  };
  const auto motion = [&](const Motion& m) {
    for (const KeyFrame& k : m.keys) {
      w.value(k.time_s);
      w.vector(k.translation);
      w.vector(k.rotation);
    }
  };
  mesh(s.garment);
  w.vector(s.transform.translation);
  w.vector(s.transform.rotation);
  w.vector(s.velocity);
  w.vector(s.gravity);
  w.vector(s.wind.velocity);
  for (const double v :
       {s.transform.scale, s.perturbation_m, s.material.density, s.density_multiplier, s.stretching_multiplier,
        s.bending_multiplier, s.damping_s, s.frame_time_s, s.wind.density, s.wind.drag, s.contact.thickness,
        s.contact.stiffness, s.contact.friction, s.contact.obstacle_friction, s.tracking.spring}) {
    w.value(v);
  }
  w.value(s.material.stretching);
  w.value(s.material.bending);
  for (const int v :
       {s.steps_per_frame, s.subdivision_rounds, static_cast<int>(mode), static_cast<int>(s.tracking.two_level),
        s.tracking.coarse_steps, static_cast<int>(s.contact.self_collision)}) {
    w.value(v);
  }
  w.value(s.seed);
  for (const Handle& h : s.handles) {
    w.array(h.vertices);
    w.value(h.start_s);
    w.value(h.end_s);
    w.flag(h.hard);
    w.value(h.stiffness);
    motion(h.motion);
  }
  for (const Obstacle& o : s.obstacles) {
    w.raw(o.name.data(), o.name.size());
    w.vector(o.center);
    w.value(o.radius);
    if (o.mesh.face_count() > 0) mesh(o.mesh);
    for (const Capsule& c : o.capsules) {
      w.vector(c.a);
      w.vector(c.b);
      w.value(c.radius);
    }
    motion(o.motion);
    if (!o.animation.samples.empty()) w.value(o.animation.sample_time_s);
    for (const Positions& sample : o.animation.samples) {
      w.raw(sample.data(), static_cast<std::size_t>(sample.size()) * sizeof(float));
    }
  }
  // What came later counts where it is used: check-points of scenes without it stay good.
  if (s.untangle) {
    for (const GarmentLayer& layer : s.layers) w.value(static_cast<std::uint64_t>(layer.faces));
  }
  if (s.strain_limits.limits()) {
    w.value(s.strain_limits.minimum);
    w.value(s.strain_limits.maximum);
  }
  if (s.untangle) w.flag(true);
  if (s.tracking.frequency > 0) w.value(s.tracking.frequency);
  if (s.subdivision_rule != SubdivisionRule::kMidpoint) w.value(static_cast<int>(s.subdivision_rule));
  return Hash().add(bytes).value();
}

// A smooth random field: a few waves over the rest shape, the same for every mesh of the garment.
class SmoothNoise {
 public:
  SmoothNoise(std::uint64_t seed, double extent) {
    std::mt19937_64 random(seed ^ 0x9e3779b97f4a7c15ull);
    const auto uniform = [&random] { return unit_interval(random()); };
    for (int i = 0; i < 12; ++i) {
      Vector3d direction(2 * uniform() - 1, 2 * uniform() - 1, 2 * uniform() - 1);
      const double waves = 1 + 5 * uniform();
      waves_.push_back(
          {direction.normalized() * (2 * std::numbers::pi * waves / extent), 2 * std::numbers::pi * uniform()});
    }
  }
  double at(const Vector3d& p) const {
    double sum = 0;
    for (const auto& [k, phase] : waves_) sum += std::sin(k.dot(p) + phase);
    return sum / std::sqrt(0.5 * static_cast<double>(waves_.size()));
  }

 private:
  std::vector<std::pair<Vector3d, double>> waves_;
};

Topology scaled(Topology garment, double scale) {
  garment.rest_positions *= static_cast<float>(scale);
  garment.uv *= static_cast<float>(scale);
  return garment;
}

Points initial_positions(const Scene& scene, const Topology& garment) {
  const Eigen::Matrix3d rotation = rotation_matrix(scene.transform.rotation);
  const Positions normals = vertex_normals(garment.rest_positions, garment.faces);
  const Eigen::RowVector3f size =
      garment.rest_positions.colwise().maxCoeff() - garment.rest_positions.colwise().minCoeff();
  const SmoothNoise noise(scene.seed, std::max(1e-9, static_cast<double>(size.norm())));
  Points points;
  for (Eigen::Index v = 0; v < garment.vertex_count(); ++v) {
    Vector3d p = garment.rest_positions.row(v).cast<double>().transpose();
    if (scene.perturbation_m > 0) p += scene.perturbation_m * noise.at(p) * normals.row(v).cast<double>().transpose();
    points.push_back(rotation * p + scene.transform.translation);
  }
  return points;
}

Points to_points(const Positions& positions) {
  Points points(static_cast<std::size_t>(positions.rows()));
  for (std::size_t v = 0; v < points.size(); ++v)
    points[v] = positions.row(static_cast<Eigen::Index>(v)).cast<double>().transpose();
  return points;
}

Positions to_positions(std::span<const Vector3d> points) {
  Positions positions(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t v = 0; v < points.size(); ++v)
    positions.row(static_cast<Eigen::Index>(v)) = points[v].cast<float>().transpose();
  return positions;
}

// The fine vertices that lie on what the handled coarse vertices span.
std::vector<std::uint32_t> fine_handle_vertices(const Handle& handle, const Subdivision& subdivision,
                                                const Faces& coarse_faces) {
  std::vector<char> handled(subdivision.feature_vertices.size(), 0);
  std::vector<std::uint32_t> vertices;
  for (const std::uint32_t v : handle.vertices) {
    if (!std::exchange(handled[v], 1)) vertices.push_back(subdivision.feature_vertices[v]);
  }
  for (Eigen::Index v = static_cast<Eigen::Index>(handled.size()); v < subdivision.fine.vertex_count(); ++v) {
    bool inside = true;
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t corner = coarse_faces(subdivision.parent_face[static_cast<std::size_t>(v)], k);
      inside = inside && (subdivision.barycentric(v, k) == 0 || handled[corner]);
    }
    if (inside) vertices.push_back(static_cast<std::uint32_t>(v));
  }
  return vertices;
}

}  // namespace

struct Simulation::State {
  Scene scene;
  Mode mode;
  ThreadPool pool;
  Topology garment;
  Subdivision subdivision;
  std::optional<Cloth> coarse, fine;
  std::optional<HandleWatch> handle_watch;
  std::uint64_t next = 0;
  bool cut_told = false;
  bool pinched = true;  ///< an obstacle may be behind its script: looked at until none is
  std::vector<Pin> springs;
  Points targets;  // the upsampled coarse surface, where averages follow it
  Positions last_coarse, last_fine;
  std::optional<std::uint64_t> fingerprint_;

  State(Scene s, Mode m)
      : scene((validate_scene(s), std::move(s))), mode(m), pool(static_cast<std::size_t>(scene.threads)) {
    const bool smooth = scene.subdivision_rule == SubdivisionRule::kSmooth;
    if (smooth && mode == Mode::kTrackedFine) {
      throw_invalid_argument("scene '" + scene.name +
                             "': Loop's subdivision is for a free fine simulation, a tracked " +
                             "one starts from the coarse shape");
    }
    garment = scaled(scene.garment, scene.transform.scale);
    subdivision = subdivide(garment, scene.subdivision_rounds, scene.subdivision_rule);
    const Points initial = initial_positions(scene, garment);
    std::vector<std::vector<std::uint32_t>> coarse_handles, fine_handles;
    for (const Handle& handle : scene.handles) {
      std::vector<std::uint32_t> unique = handle.vertices;
      std::sort(unique.begin(), unique.end());
      unique.erase(std::unique(unique.begin(), unique.end()), unique.end());
      coarse_handles.push_back(std::move(unique));
      fine_handles.push_back(fine_handle_vertices(handle, subdivision, garment.faces));
    }
    handle_watch.emplace(garment, scene);
    coarse.emplace(garment, initial, std::move(coarse_handles), scene);
    make_clean(*coarse);
    last_coarse = Positions::Zero(garment.vertex_count(), 3);
    if (mode == Mode::kCoarse) return;
    last_fine = Positions::Zero(subdivision.fine.vertex_count(), 3);
    const Points fine_initial =
        smooth ? initial_positions(scene, subdivision.fine)
               : to_points(upsample(subdivision, garment.faces, to_positions(coarse->positions())));
    if (mode == Mode::kTrackedFine && scene.tracking.two_level) {
      fine.emplace(subdivision.fine, fine_initial, std::move(fine_handles), scene, &garment,
                   subdivision.feature_vertices);
    } else {
      fine.emplace(subdivision.fine, fine_initial, std::move(fine_handles), scene);
    }
    fine->use_levels(subdivision);
    if (mode == Mode::kTrackedFine && scene.tracking.frequency > 0) {
      fine->track_averages(subdivision, garment.faces);
      targets.resize(fine->vertex_count());
    }
    make_clean(*fine);
  }

  void make_clean(Cloth& cloth) {
    if (scene.untangle) cloth.untangle(pool);
    cloth.check_start(pool);
  }

  /// Computed once: a long animation is a hundred megabytes.
  std::uint64_t fingerprint() {
    if (!fingerprint_) fingerprint_ = scene_fingerprint(scene, mode);
    return *fingerprint_;
  }

  double frame_time(std::uint64_t index) const { return static_cast<double>(index) * scene.frame_time_s; }

  Frame make_frame(const Cloth& cloth, Positions& last) const {
    Frame frame;
    frame.index = next;
    frame.time_s = frame_time(next);
    frame.positions = to_positions(cloth.positions());
    frame.velocities = backward_velocities(frame.positions, next == 0 ? Positions() : last, scene.frame_time_s);
    last = frame.positions;
    return frame;
  }

  std::vector<ObstacleFrame> obstacles() const {
    // In place of the script: where a step had to be cut, the obstacles lag behind it.
    std::vector<ObstacleFrame> frames;
    std::size_t first = coarse->vertex_count();
    for (const Obstacle& o : scene.obstacles) {
      frames.push_back(frame_of(o, std::span(coarse->particles()).subspan(first, point_count(o))));
      first += point_count(o);
    }
    return frames;
  }

  // What ties the fine cloth to where the coarse one is now.
  Following following() {
    if (mode != Mode::kTrackedFine) return {};
    springs.clear();
    const std::span<const Vector3d> x = coarse->positions();
    if (scene.tracking.spring > 0) {
      for (std::size_t v = 0; v < subdivision.feature_vertices.size(); ++v) {
        springs.push_back({subdivision.feature_vertices[v], x[v], scene.tracking.spring, false});
      }
    }
    for (std::size_t i = 0; i < targets.size(); ++i) {
      targets[i].setZero();
      for (int k = 0; k < 3; ++k) {
        targets[i] += static_cast<double>(subdivision.barycentric(static_cast<Eigen::Index>(i), k)) *
                      x[garment.faces(subdivision.parent_face[i], k)];
      }
    }
    return {springs, tracking_frequency(scene), targets};
  }

  void simulate_steps() {
    const double step_s = scene.frame_time_s / scene.steps_per_frame;
    // Tracked, the fine cloth may take longer steps: where it is going is known.
    const int stride = mode == Mode::kTrackedFine ? scene.tracking.coarse_steps : 1;
    int pending = 0;  // coarse steps that the fine cloth has yet to make
    for (int s = 0; s < scene.steps_per_frame; ++s) {
      const double time_s = frame_time(next - 1) + s * step_s;
      coarse->step(time_s, step_s, {}, pool);
      ++pending;
      if (!fine || (pending < stride && s + 1 < scene.steps_per_frame)) continue;
      fine->step(time_s - (pending - 1) * step_s, pending * step_s, following(), pool);
      pending = 0;
    }
  }

  std::string cut_warning(const SimulatedFrame& frame) const {
    char frequency[80] = "";
    if (!targets.empty()) {
      std::snprintf(frequency, sizeof frequency, ", or the tracking frequency of %.3g rad/s is too high",
                    tracking_frequency(scene));
    }
    char text[300];
    std::snprintf(text, sizeof text,
                  "%llu of the steps up to %.3g s had to be cut: they are too long, or something pinches the cloth%s; "
                  "obstacles and handles may stay behind their script",
                  static_cast<unsigned long long>(frame.report.cut_steps), frame.coarse.time_s, frequency);
    return text;
  }

  template <typename Archive>
  void archive(Archive& archive) {
    archive.value(next);
    const auto positions = [&](Positions& p) {
      std::vector<float> values(p.data(), p.data() + p.size());
      archive.floats(values);
      p = Eigen::Map<const Positions>(values.data(), static_cast<Eigen::Index>(values.size() / 3), 3);
    };
    positions(last_coarse);
    positions(last_fine);
    coarse->archive(archive);
    if (fine) fine->archive(archive);
  }
};

Simulation::Simulation(Scene scene, Mode mode) : state_(std::make_unique<State>(std::move(scene), mode)) {}
Simulation::~Simulation() = default;
Simulation::Simulation(Simulation&&) noexcept = default;
Simulation& Simulation::operator=(Simulation&&) noexcept = default;

const Scene& Simulation::scene() const { return state_->scene; }
Mode Simulation::mode() const { return state_->mode; }
const Topology& Simulation::coarse() const { return state_->garment; }
const Topology& Simulation::fine() const { return state_->subdivision.fine; }
const Subdivision& Simulation::subdivision() const { return state_->subdivision; }
const std::vector<std::uint32_t>& Simulation::feature_vertices() const { return state_->subdivision.feature_vertices; }
std::uint64_t Simulation::next_index() const { return state_->next; }

std::vector<ObstacleShape> Simulation::obstacle_shapes() const {
  std::vector<ObstacleShape> shapes;
  for (const Obstacle& o : state_->scene.obstacles) shapes.push_back(shape_of(o));
  return shapes;
}

void Simulation::stop_when(const std::function<bool()>& stopped) {
  state_->coarse->stop_when(stopped);
  if (state_->fine) state_->fine->stop_when(stopped);
}

SimulatedFrame Simulation::next_frame() {
  State& s = *state_;
  if (s.next >= static_cast<std::uint64_t>(s.scene.frames)) {
    throw Error(ErrorCode::kFailedPrecondition,
                "scene '" + s.scene.name + "' has ended: it has " + std::to_string(s.scene.frames) + " frames");
  }
  if (s.next > 0) s.simulate_steps();
  SimulatedFrame frame;
  frame.coarse = s.make_frame(*s.coarse, s.last_coarse);
  if (s.fine) frame.fine = s.make_frame(*s.fine, s.last_fine);
  frame.obstacles = s.obstacles();
  if (auto warning = s.handle_watch->check(s.coarse->positions(), frame.coarse.time_s)) {
    frame.warnings.push_back(std::move(*warning));
  }
  for (std::size_t h = 0; h < s.scene.handles.size(); ++h) {
    const double lag = s.coarse->handle_lag(h, frame.coarse.time_s);
    if (auto warning = s.handle_watch->check_lag(h, lag, frame.coarse.time_s)) {
      frame.warnings.push_back(std::move(*warning));
    }
  }
  const ClothReport coarse = s.coarse->take_report();
  const ClothReport fine = s.fine ? s.fine->take_report() : ClothReport{};
  const ClothReport& finest = s.fine ? fine : coarse;
  frame.times = {coarse.total_ms, fine.total_ms, finest.assembly_ms, finest.solve_ms, finest.contact_ms};
  frame.report = {coarse.contacts + fine.contacts,           coarse.impacts + fine.impacts,
                  coarse.rigid_zones + fine.rigid_zones,     coarse.cut_steps + fine.cut_steps,
                  coarse.yielded_steps + fine.yielded_steps, coarse.solver_iterations + fine.solver_iterations};
  // What lags catches up at some speed: also in frames after the one that was cut.
  s.pinched = s.pinched || coarse.stopped_vertices > 0;
  if (s.pinched) {
    frame.report.pinched_vertices = coarse.stopped_vertices;
    frame.report.obstacle_lag_m = s.coarse->obstacle_lag(frame.coarse.time_s);
    s.pinched = frame.report.obstacle_lag_m > kLag;
  }
  if (frame.report.cut_steps > 0 && !std::exchange(s.cut_told, true)) {
    frame.warnings.push_back(s.cut_warning(frame));
  }
  ++s.next;
  return frame;
}

std::vector<std::byte> Simulation::checkpoint() const {
  std::vector<std::byte> bytes;
  Writer writer(bytes);
  writer.raw(kMagic, sizeof(kMagic));
  writer.value(kVersion);
  writer.value(state_->fingerprint());
  state_->archive(writer);
  writer.value(Hash().add(bytes).value());
  return bytes;
}

void Simulation::restore(std::span<const std::byte> bytes) {
  std::uint64_t hash = 0, fingerprint = 0;
  char magic[sizeof(kMagic)];
  std::uint32_t version = 0;
  if (bytes.size() < sizeof(hash)) throw_data_loss("simulation check-point: truncated");
  Reader(bytes.last(sizeof(hash))).value(hash);
  const auto content = bytes.first(bytes.size() - sizeof(hash));
  Reader reader(content);
  reader.raw(magic, sizeof(magic));
  if (std::memcmp(magic, kMagic, sizeof(magic)) != 0) throw_data_loss("simulation check-point: not a check-point");
  reader.value(version);
  if (version != kVersion) {
    throw_invalid_argument("simulation check-point: version " + std::to_string(version) + ", expected " +
                           std::to_string(kVersion));
  }
  if (Hash().add(content).value() != hash) throw_data_loss("simulation check-point: truncated or corrupt");
  reader.value(fingerprint);
  if (fingerprint != state_->fingerprint()) {
    throw_invalid_argument("simulation check-point: belongs to another scene");
  }
  // A check-point that turns out wrong half-way must leave the simulation as it was.
  const std::vector<std::byte> backup = checkpoint();
  try {
    state_->archive(reader);
    state_->pinched = true;
    if (!reader.at_end()) throw_data_loss("simulation check-point: too long");
  } catch (const Error&) {
    Reader undo(backup);
    char header[sizeof(kMagic) + sizeof(kVersion) + sizeof(fingerprint)];
    undo.raw(header, sizeof(header));
    state_->archive(undo);
    throw;
  }
}

std::vector<ObstacleFrame> obstacle_frames(const Scene& scene, double time_s) {
  std::vector<ObstacleFrame> frames;
  for (const Obstacle& o : scene.obstacles) frames.push_back(frame_of(o, points_at(o, time_s)));
  return frames;
}

}  // namespace pleat::simulation
