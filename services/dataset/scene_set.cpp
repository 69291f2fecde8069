#include "services/dataset/scene_set.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/frame/scene_json.hpp"
#include "common/mesh/mesh.hpp"
#include "services/dataset/placement.hpp"
#include "services/dataset/random.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"

namespace pleat::dataset {
namespace {

namespace fs = std::filesystem;
using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kMostSequences = 10'000;
constexpr std::size_t kTestEvery = 6;
constexpr double kFastest = 0.8, kSlowest = 1.25;  // of times
constexpr double kBreeze = 1.5;                    // m/s, in scenes without wind
constexpr double kHeading = 20, kTilt = 8;         // degrees
constexpr double kShift = 0.03;                    // m, of the start
constexpr double kObstacleShift = 0.04;            // m, across the ground, of an obstacle that moves
constexpr double kMostDamping = 0.005;             // s, beside the scene's own
constexpr int kFewestSteps = 2;
constexpr int kAttempts = 4;  // at a start that is clean, each varied half as much as the one before

/// What is drawn for a sequence. All of it always, so that a scene's numbers do not depend on what is in it.
struct Variation {
  double stretching, bending, density;    // factors of the material
  double wind_factor, wind_turn, breeze;  // factor, degrees; m/s, 0 in every second sequence
  double breeze_from;                     // degrees
  double heading, tilt, tilt_from;        // degrees
  Vector3d shift;                         // of the start, m
  double pace;                            // factor of all times
  double handle_reach, obstacle_reach;    // factors of how far they move
  double steps, damping, friction;        // factor, s, factor
  std::vector<Vector3d> obstacle_shifts;  // m
  std::uint64_t seed;                     // of the perturbation
};

// 1 / most to most, as likely below 1 as above.
double factor(Random& random, double most) { return std::exp(random.uniform(-1, 1) * std::log(most)); }

Variation draw(std::uint64_t seed, std::size_t obstacles) {
  Random random(seed);
  Variation v{};
  v.stretching = factor(random, 1.4), v.bending = factor(random, 1.6), v.density = factor(random, 1.2);
  v.wind_factor = random.uniform(0.5, 1.5), v.wind_turn = random.uniform(-40, 40);
  v.breeze = std::max(0.0, random.uniform(-kBreeze, kBreeze)), v.breeze_from = random.uniform(-180, 180);
  v.heading = random.uniform(-kHeading, kHeading), v.tilt = random.uniform(-kTilt, kTilt);
  v.tilt_from = random.uniform(-180, 180);
  for (Eigen::Index k = 0; k < 3; ++k) v.shift[k] = random.uniform(-kShift, kShift);
  v.pace = random.uniform(kFastest, kSlowest);
  v.handle_reach = random.uniform(0.7, 1.3), v.obstacle_reach = random.uniform(0.8, 1.2);
  constexpr double kSteps[] = {0.5, 1, 1.5};
  v.steps = kSteps[random.below(std::size(kSteps))];
  v.damping = std::max(0.0, random.uniform(-kMostDamping, kMostDamping)), v.friction = factor(random, 1.6);
  v.seed = random.below(std::size_t{1} << 31);
  for (std::size_t o = 0; o < obstacles; ++o) {
    const double x = random.uniform(-kObstacleShift, kObstacleShift);
    v.obstacle_shifts.emplace_back(x, 0, random.uniform(-kObstacleShift, kObstacleShift));
  }
  return v;
}

using Values = google::protobuf::RepeatedField<double>;

Vector3d vector_of(const Values& values) {
  return values.empty() ? Vector3d(Vector3d::Zero()) : Vector3d(values[0], values[1], values[2]);
}
void set(Values& values, const Vector3d& v) { values.Assign(v.data(), v.data() + 3); }

Matrix3d turn(double degrees, const Vector3d& axis) {
  return Eigen::AngleAxisd(degrees * kDegree, axis).toRotationMatrix();
}

template <typename Keys>
void vary_motion(Keys& keys, double pace, double reach) {
  for (v1::KeyFrame& key : keys) {
    key.set_time_s(pace * key.time_s());
    for (double& value : *key.mutable_translation()) value *= reach;
    key.set_angle_deg(reach * key.angle_deg());
  }
}

bool is_animated(const v1::Scene& scene) {
  return std::any_of(scene.obstacles().begin(), scene.obstacles().end(),
                     [](const v1::Obstacle& obstacle) { return obstacle.has_animation(); });
}

/// Whether handles would pull apart if all went further: where their motions differ.
bool handles_differ(const v1::Scene& scene) {
  const auto motion_text = [](const v1::Handle& handle) {
    v1::Handle motion;
    *motion.mutable_motion() = handle.motion();
    return motion.SerializeAsString();
  };
  return std::any_of(scene.handles().begin(), scene.handles().end(),
                     [&](const v1::Handle& h) { return motion_text(h) != motion_text(scene.handles(0)); });
}

void vary_material(const Variation& v, v1::Scene& scene) {
  v1::MaterialOptions& options = *scene.mutable_material_options();
  options.set_stretching_scale(v.stretching * (options.has_stretching_scale() ? options.stretching_scale() : 1));
  options.set_bending_scale(v.bending * (options.has_bending_scale() ? options.bending_scale() : 1));
  options.set_density_scale(v.density * (options.has_density_scale() ? options.density_scale() : 1));
  options.set_damping_s(v.damping + options.damping_s());
}

void vary_wind(const Variation& v, v1::Scene& scene) {
  if (scene.wind().has_density() && scene.wind().density() == 0) return;  // no air
  Vector3d wind = vector_of(scene.wind().velocity());
  if (wind.isZero()) {
    wind = v.breeze * Vector3d(std::cos(v.breeze_from * kDegree), 0, std::sin(v.breeze_from * kDegree));
  } else {
    wind = v.wind_factor * (turn(v.wind_turn, Vector3d::UnitY()) * wind);
  }
  set(*scene.mutable_wind()->mutable_velocity(), wind);
}

void vary_motions(const Variation& v, double amount, v1::Scene& scene) {
  // Handles that move apart are not to tear the cloth.
  const double reach = handles_differ(scene) ? std::min(v.handle_reach, 1 / v.handle_reach) : v.handle_reach;
  for (v1::Handle& handle : *scene.mutable_handles()) {
    vary_motion(*handle.mutable_motion(), v.pace, reach);
    handle.set_start_s(v.pace * handle.start_s());
    if (handle.has_end_s()) handle.set_end_s(v.pace * handle.end_s());
  }
  for (int o = 0; o < scene.obstacles_size(); ++o) {
    v1::Obstacle& obstacle = *scene.mutable_obstacles(o);
    vary_motion(*obstacle.mutable_motion(), v.pace, v.obstacle_reach);
    if (obstacle.has_animation()) {
      const double time = obstacle.animation().has_sample_time_s() ? obstacle.animation().sample_time_s()
                          : scene.frame_time_s() != 0              ? scene.frame_time_s()
                                                                   : kDefaultFrameTime;
      obstacle.mutable_animation()->set_sample_time_s(v.pace * time);
    }
    const Vector3d shift = amount * v.obstacle_shifts[static_cast<std::size_t>(o)];
    for (v1::KeyFrame& key : *obstacle.mutable_motion()) {
      set(*key.mutable_translation(), vector_of(key.translation()) + shift);
    }
  }
}

/// About the middle of the garment where it starts.
void vary_start(const Variation& v, double amount, const Vector3d& middle, v1::Scene& scene) {
  v1::Placement& placement = *scene.mutable_placement();
  Matrix3d rotation = Matrix3d::Identity();
  if (!placement.axis().empty()) rotation = turn(placement.angle_deg(), vector_of(placement.axis()).normalized());
  const Vector3d translation = vector_of(placement.translation()), centre = rotation * middle + translation;
  const Vector3d about(std::cos(v.tilt_from * kDegree), 0, std::sin(v.tilt_from * kDegree));
  const Matrix3d change = turn(amount * v.heading, Vector3d::UnitY()) * turn(amount * v.tilt, about);
  const Eigen::AngleAxisd whole(Matrix3d(change * rotation));
  set(*placement.mutable_axis(), whole.axis());
  placement.set_angle_deg(whole.angle() / kDegree);
  set(*placement.mutable_translation(), change * (translation - centre) + centre + amount * v.shift);
}

void vary_solver(const Variation& v, v1::Scene& scene) {
  const simulation::Scene defaults;
  const int steps = scene.steps_per_frame() != 0 ? static_cast<int>(scene.steps_per_frame()) : defaults.steps_per_frame;
  scene.set_steps_per_frame(
      static_cast<std::uint32_t>(std::max<long>(kFewestSteps, std::lround(v.steps * static_cast<double>(steps)))));
  scene.set_friction(v.friction * (scene.has_friction() ? scene.friction() : defaults.contact.friction));
  scene.set_obstacle_friction(
      v.friction * (scene.has_obstacle_friction() ? scene.obstacle_friction() : defaults.contact.obstacle_friction));
}

/// A scene that was read. Of its animations the message has the first samples alone.
struct Source {
  fs::path file;
  v1::Scene message;
  Vector3d middle = Vector3d::Zero();  // of the garment at rest
  std::shared_ptr<const SceneSamples> samples;
};

std::shared_ptr<const SceneSamples> take_samples(simulation::Scene& scene, v1::Scene& message) {
  auto samples = std::make_shared<SceneSamples>();
  for (int o = 0; o < message.obstacles_size(); ++o) {
    samples->push_back(std::move(scene.obstacles[static_cast<std::size_t>(o)].animation.samples));
    if (samples->back().empty()) continue;
    message.mutable_obstacles(o)->mutable_animation()->mutable_positions()->Truncate(
        static_cast<int>(samples->back().front().size()));
  }
  return samples;
}

Source read_source(const fs::path& file, int frames, std::vector<std::string>& notes) {
  Source source;
  source.file = file;
  source.message =
      presentation::read_scene_file(file, {.frames = static_cast<std::uint32_t>(std::max(frames, 0)), .notes = &notes});
  const auto wanted = source.message.frames();
  if (wanted < 2) throw_invalid_argument(file.string() + ": frames: a sequence has at least 2");
  if (is_animated(source.message)) {
    // A faster variation comes further.
    const double last = std::ceil(static_cast<double>(wanted) / kFastest);
    source.message = presentation::read_scene_file(file, {.frames = static_cast<std::uint32_t>(last)});
    source.message.set_frames(wanted);
  }
  simulation::Scene scene = simulation::scene_from_message(source.message);
  source.middle = scene.garment.rest_positions.cast<double>().colwise().mean();
  source.samples = take_samples(scene, source.message);
  return source;
}

void require_same_cloth(const simulation::Scene& scene, const simulation::Scene& first, const fs::path& file,
                        const fs::path& first_file) {
  const auto refuse = [&](const std::string& what) {
    throw_invalid_argument(file.string() + ": another " + what + " than " + first_file.string() +
                           "; the scenes of a data set have one");
  };
  if (topology_hash(scene.garment) != topology_hash(first.garment)) refuse("garment");
  if (scene.frame_time_s != first.frame_time_s) refuse("frame time");
  if (scene.subdivision_rounds != first.subdivision_rounds || scene.subdivision_rule != first.subdivision_rule) {
    refuse("subdivision");
  }
}

v1::Scene varied(const Source& source, const Variation& v, double amount) {
  v1::Scene scene = source.message;
  vary_material(v, scene);
  vary_wind(v, scene);
  // Worn garments, and those that are put in order first, have their place.
  if (!scene.untangle() && !is_animated(scene)) vary_start(v, amount, source.middle, scene);
  vary_motions(v, amount, scene);
  vary_solver(v, scene);
  scene.set_seed(v.seed);
  return scene;
}

v1::Tracking springs_message(const simulation::Tracking& tracking) {
  v1::Tracking message;
  message.set_spring(tracking.spring);
  message.set_two_level(tracking.two_level);
  return message;
}

SequencePlan plan_of(v1::Scene message, const Source& source, const SceneOptions& options) {
  if (options.rounds > 0) message.set_subdivision_rounds(static_cast<std::uint32_t>(options.rounds));
  SequencePlan plan;
  plan.name = message.name();
  plan.scene = simulation::scene_from_message(message);
  plan.material_json = source.message.material_json();
  plan.samples = source.samples;
  plan.tracked = options.tracked;
  set_tracking(options, plan);
  if (options.springs) *message.mutable_tracking() = springs_message(plan.scene.tracking);
  if (options.frequency > 0) message.mutable_tracking()->set_frequency(options.frequency);
  plan.scene_json = scene_json(std::move(message));
  return plan;
}

SequencePlan vary(const Source& source, std::size_t number, const SceneOptions& options) {
  const std::string name = numbered(source.message.name(), number);
  const std::uint64_t seed = Hash().add(name + " " + std::to_string(options.seed)).value();
  const Variation v = draw(seed, static_cast<std::size_t>(source.message.obstacles_size()));
  double amount = 1;
  for (int attempt = 0; attempt <= kAttempts; ++attempt, amount = attempt < kAttempts ? amount / 2 : 0) {
    v1::Scene message = varied(source, v, amount);
    message.set_name(name);
    SequencePlan plan = plan_of(std::move(message), source, options);
    if (fault_of_start(plan.scene).empty()) return plan;
  }
  throw_invalid_argument(source.file.string() + ": starts clean, but not with other material or friction");
}

}  // namespace

std::vector<SequencePlan> plan_own_scenes(const SceneOptions& options, std::vector<std::string>& notes) {
  if (options.sequences < 1 || options.sequences > kMostSequences) {
    throw_invalid_argument("data set: 1 to " + std::to_string(kMostSequences) + " variations of scenes");
  }
  if (options.frames == 1) throw_invalid_argument("data set: at least 2 frames per sequence are needed");
  std::vector<Source> sources;
  std::vector<SequencePlan> plans;
  for (const fs::path& file : options.own_scenes) {
    sources.push_back(read_source(file, options.frames, notes));
    SequencePlan plan = plan_of(sources.back().message, sources.back(), options);
    plan.split = "test";
    if (!plans.empty()) require_same_cloth(plan.scene, plans.front().scene, file, options.own_scenes.front());
    if (const std::string fault = fault_of_start(plan.scene); !fault.empty()) {
      throw_invalid_argument(file.string() + ": " + fault);
    }
    plans.push_back(std::move(plan));
  }
  if (plans.empty()) throw_invalid_argument("data set: no scenes");
  const auto count = static_cast<std::size_t>(options.sequences);
  for (std::size_t i = 0; i < count; ++i) {
    SequencePlan plan = vary(sources[i % sources.size()], i, options);
    const bool test = i % kTestEvery == kTestEvery - 1 || (count < kTestEvery && count > 1 && i + 1 == count);
    plan.split = test ? "test" : "train";
    plans.push_back(std::move(plan));
  }
  std::set<std::string> names;
  for (const SequencePlan& plan : plans) {
    if (!names.insert(plan.name).second) {
      throw_invalid_argument("data set: two scenes are named '" + plan.name + "'");
    }
  }
  return plans;
}

}  // namespace pleat::dataset
