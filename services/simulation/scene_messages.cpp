#include "services/simulation/scene_messages.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "services/simulation/material_messages.hpp"
#include "services/simulation/obstacles.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using Values = google::protobuf::RepeatedField<double>;

Vector3d vector_from(const Values& values, const std::string& field, const Vector3d& otherwise = Vector3d::Zero()) {
  if (values.empty()) return otherwise;
  if (values.size() != 3) throw_invalid_argument(field + ": " + std::to_string(values.size()) + " values instead of 3");
  return {values[0], values[1], values[2]};
}

// Axis times angle.
Vector3d rotation_from(const Values& axis, double angle_deg, const std::string& field) {
  const Vector3d direction = vector_from(axis, field + ".axis");
  const double length = direction.norm();
  if (axis.empty() && angle_deg != 0) throw_invalid_argument(field + ": an angle without an axis");
  if (axis.empty()) return Vector3d::Zero();
  if (!(length > 0)) throw_invalid_argument(field + ".axis: has no direction");
  return direction / length * (angle_deg * std::numbers::pi / 180);
}

Motion motion_from(const google::protobuf::RepeatedPtrField<v1::KeyFrame>& keys, const std::string& field) {
  Motion motion;
  for (int i = 0; i < keys.size(); ++i) {
    const std::string name = field + ".motion[" + std::to_string(i) + "]";
    motion.keys.push_back({keys[i].time_s(), vector_from(keys[i].translation(), name + ".translation"),
                           rotation_from(keys[i].axis(), keys[i].angle_deg(), name)});
  }
  return motion;
}

// (T x points x 3) -> T samples. Whether the values are finite is the scene's check, which names the sample.
std::vector<Positions> samples_from(const google::protobuf::RepeatedField<float>& values, std::size_t points,
                                    const std::string& field) {
  const std::size_t row = 3 * points, count = static_cast<std::size_t>(values.size());
  if (count == 0) throw_invalid_argument(field + ".positions is empty");
  if (count % row != 0) {
    throw_invalid_argument(field + ".positions: " + std::to_string(count) + " values, not a multiple of 3 x " +
                           std::to_string(points) + " points");
  }
  std::vector<Positions> samples;
  for (std::size_t first = 0; first < count; first += row) {
    samples.emplace_back(Eigen::Map<const Positions>(values.data() + first, static_cast<Eigen::Index>(points), 3));
  }
  return samples;
}

Obstacle obstacle_from(const v1::Obstacle& message, double frame_time_s, const std::string& field) {
  Obstacle obstacle;
  obstacle.name = message.name();
  switch (message.shape_case()) {
    case v1::Obstacle::kSphere:
      obstacle.center = vector_from(message.sphere().center(), field + ".sphere.center");
      obstacle.radius = message.sphere().radius();
      if (!(obstacle.radius > 0)) throw_invalid_argument(field + ".sphere.radius must be positive");
      break;
    case v1::Obstacle::kMesh:
      obstacle.mesh = from_message(message.mesh(), field + ".mesh");
      break;
    case v1::Obstacle::kCapsules: {
      for (int c = 0; c < message.capsules().capsules_size(); ++c) {
        const v1::Capsule& from = message.capsules().capsules(c);
        const std::string name = field + ".capsules.capsules[" + std::to_string(c) + "]";
        if (from.a().empty() || from.b().empty()) throw_invalid_argument(name + ": both ends, a and b, are needed");
        obstacle.capsules.push_back(
            {vector_from(from.a(), name + ".a"), vector_from(from.b(), name + ".b"), from.radius()});
      }
      if (obstacle.capsules.empty()) throw_invalid_argument(field + ".capsules: there are none");
      break;
    }
    case v1::Obstacle::kMeshFile:
      throw_invalid_argument(field + ".mesh_file: on the wire the mesh itself is needed, not its file");
    case v1::Obstacle::kBody:
      throw_invalid_argument(field + ".body: on the wire its mesh and animation are needed, not their files");
    case v1::Obstacle::SHAPE_NOT_SET:
      throw_invalid_argument(field + ": has no shape");
  }
  obstacle.motion = motion_from(message.motion(), field);
  if (message.has_animation()) {
    const v1::Animation& animation = message.animation();
    if (!animation.file().empty()) {
      throw_invalid_argument(field + ".animation.file: on the wire the positions are needed, not their file");
    }
    obstacle.animation.sample_time_s = animation.has_sample_time_s() ? animation.sample_time_s() : frame_time_s;
    obstacle.animation.samples = samples_from(animation.positions(), point_count(obstacle), field + ".animation");
  }
  return obstacle;
}

Material material_from(const v1::Scene& scene) {
  switch (scene.material_case()) {
    case v1::Scene::kMaterialJson:
      return parse_material(scene.material_json(), "scene.material_json");
    case v1::Scene::kIsotropic:
      return material_from_message(scene.isotropic(), "scene.isotropic");
    case v1::Scene::kMaterialFile:
      throw_invalid_argument("scene.material_file: on the wire the material's JSON is needed, not its file");
    case v1::Scene::MATERIAL_NOT_SET:
      break;
  }
  throw_invalid_argument("scene.material_json is missing");
}

SubdivisionRule rule_from(v1::SubdivisionRule rule) {
  switch (rule) {
    case v1::SUBDIVISION_RULE_MIDPOINT:
      return SubdivisionRule::kMidpoint;
    case v1::SUBDIVISION_RULE_LOOP:
      return SubdivisionRule::kSmooth;
    default:
      throw_invalid_argument("scene.subdivision_rule: unknown value " + std::to_string(static_cast<int>(rule)));
  }
}

// Before there was a frequency, a scene with either of the others meant the published way.
Tracking tracking_from(const v1::Tracking& m) {
  const bool published = m.has_spring() || m.has_two_level();
  Tracking tracking = published ? published_tracking() : Tracking();
  if (published && m.has_frequency()) tracking = {.frequency = 0};
  if (m.has_frequency()) tracking.frequency = m.frequency();
  if (m.has_spring()) tracking.spring = m.spring();
  if (m.has_two_level()) tracking.two_level = m.two_level();
  return tracking;
}

// Message fields are unsigned; beyond every limit they must not become negative.
int bounded(std::uint64_t value) { return static_cast<int>(std::min<std::uint64_t>(value, 1u << 30)); }

}  // namespace

Scene scene_from_message(const v1::Scene& m) {
  Scene scene;
  scene.name = m.name();
  if (m.has_garment_file()) {
    throw_invalid_argument("scene.garment_file: on the wire the mesh itself is needed, not its file");
  }
  if (!m.further_garment_files().empty()) {
    throw_invalid_argument("scene.further_garment_files: on the wire all garments are one mesh");
  }
  if (!m.has_garment_mesh()) throw_invalid_argument("scene.garment_mesh is missing");
  scene.garment = from_message(m.garment_mesh(), "scene.garment_mesh");
  for (const v1::GarmentLayer& layer : m.garment_layers()) {
    scene.layers.push_back({layer.name(), static_cast<Eigen::Index>(layer.faces())});
  }
  scene.transform.translation = vector_from(m.placement().translation(), "scene.placement.translation");
  scene.transform.rotation = rotation_from(m.placement().axis(), m.placement().angle_deg(), "scene.placement");
  scene.perturbation_m = m.perturbation_m();
  scene.untangle = m.untangle();

  scene.material = material_from(m);
  const v1::MaterialOptions& options = m.material_options();
  if (options.has_density_scale()) scene.density_multiplier = options.density_scale();
  if (options.has_stretching_scale()) scene.stretching_multiplier = options.stretching_scale();
  if (options.has_bending_scale()) scene.bending_multiplier = options.bending_scale();
  if (options.has_damping_s()) scene.damping_s = options.damping_s();
  if (options.has_minimum_stretch()) scene.strain_limits.minimum = options.minimum_stretch();
  if (options.has_maximum_stretch()) scene.strain_limits.maximum = options.maximum_stretch();

  if (m.frame_time_s() != 0) scene.frame_time_s = m.frame_time_s();
  if (m.steps_per_frame() != 0) scene.steps_per_frame = bounded(m.steps_per_frame());
  scene.frames = bounded(m.frames());
  scene.gravity = vector_from(m.gravity(), "scene.gravity", scene.gravity);
  if (m.wind().has_density()) scene.wind.density = m.wind().density();
  scene.wind.velocity = vector_from(m.wind().velocity(), "scene.wind.velocity");
  scene.wind.drag = m.wind().drag();

  for (int h = 0; h < m.handles_size(); ++h) {
    const v1::Handle& from = m.handles(h);
    Handle handle;
    handle.vertices.assign(from.vertices().begin(), from.vertices().end());
    handle.start_s = from.start_s();
    if (from.has_end_s()) handle.end_s = from.end_s();
    if (from.has_stiffness()) handle.stiffness = from.stiffness();
    handle.hard = from.hard();
    handle.motion = motion_from(from.motion(), "scene.handles[" + std::to_string(h) + "]");
    scene.handles.push_back(std::move(handle));
  }
  for (int o = 0; o < m.obstacles_size(); ++o) {
    scene.obstacles.push_back(
        obstacle_from(m.obstacles(o), scene.frame_time_s, "scene.obstacles[" + std::to_string(o) + "]"));
  }
  if (m.contact().has_thickness()) scene.contact.thickness = m.contact().thickness();
  if (m.contact().has_stiffness()) scene.contact.stiffness = m.contact().stiffness();
  if (m.contact().has_self_collision()) scene.contact.self_collision = m.contact().self_collision();
  if (m.has_friction()) scene.contact.friction = m.friction();
  if (m.has_obstacle_friction()) scene.contact.obstacle_friction = m.obstacle_friction();
  if (m.has_subdivision_rounds()) scene.subdivision_rounds = bounded(m.subdivision_rounds());
  scene.subdivision_rule = rule_from(m.subdivision_rule());
  if (m.has_handle_stretch_warning()) scene.handle_stretch_warning = m.handle_stretch_warning();
  scene.tracking = tracking_from(m.tracking());
  scene.seed = m.seed();
  validate_scene(scene);
  return scene;
}

}  // namespace pleat::simulation
