#include <nlohmann/json.hpp>

#include "services/dataset/placement.hpp"
#include "services/dataset/scenes.hpp"

namespace pleat::dataset {
namespace {

nlohmann::json to_array(const Eigen::Vector3d& vector) { return {vector.x(), vector.y(), vector.z()}; }

nlohmann::ordered_json to_json(const Topology& mesh) {
  nlohmann::ordered_json json;
  json["faces"] = std::vector<std::uint32_t>(mesh.faces.data(), mesh.faces.data() + mesh.faces.size());
  json["restPositions"] =
      std::vector<float>(mesh.rest_positions.data(), mesh.rest_positions.data() + mesh.rest_positions.size());
  return json;
}

nlohmann::ordered_json to_json(const simulation::Motion& motion) {
  nlohmann::ordered_json json = nlohmann::ordered_json::array();
  for (const simulation::KeyFrame& key : motion.keys) {
    nlohmann::ordered_json entry{{"timeS", key.time_s}, {"translation", to_array(key.translation)}};
    if (const double angle = key.rotation.norm(); angle > 0) {
      entry["axis"] = to_array(key.rotation / angle);
      entry["angleDeg"] = angle / kDegree;
    }
    json.push_back(entry);
  }
  return json;
}

nlohmann::ordered_json to_json(const BodyMotion& motion) {
  nlohmann::ordered_json json;
  json["file"] = "../bodies/" + motion.body.filename().string();
  json["motionFile"] = "../bodies/" + motion.motion.filename().string();
  json["startS"] = motion.start_s;
  json["endS"] = motion.end_s;
  json["easeFrames"] = motion.ease_frames;
  if (motion.mirrored) json["mirrored"] = true;
  return json;
}

}  // namespace

std::string scene_to_json(const SequencePlan& plan, const std::filesystem::path& garment,
                          const std::filesystem::path& material) {
  const simulation::Scene& scene = plan.scene;
  nlohmann::ordered_json json;
  json["name"] = scene.name;
  if (!plan.own_meshes) json["garmentFile"] = "../garments/" + garment.filename().string();
  nlohmann::ordered_json placement;
  placement["translation"] = to_array(scene.transform.translation);
  const double angle = scene.transform.rotation.norm();
  if (angle > 0) {
    placement["axis"] = to_array(scene.transform.rotation / angle);
    placement["angleDeg"] = angle / kDegree;
  }
  json["placement"] = placement;
  if (plan.material_json.empty()) {
    json["materialFile"] = "../materials/" + material.filename().string();
  } else {
    json["materialJson"] = plan.material_json;
  }
  if (scene.damping_s > 0) json["materialOptions"]["dampingS"] = scene.damping_s;
  json["frameTimeS"] = scene.frame_time_s;
  json["stepsPerFrame"] = scene.steps_per_frame;
  json["frames"] = scene.frames;
  if (scene.perturbation_m > 0) json["perturbationM"] = scene.perturbation_m;
  json["seed"] = std::to_string(scene.seed);  // 64-bit integers are strings in protobuf's JSON form
  if (scene.subdivision_rounds != simulation::Scene().subdivision_rounds) {
    json["subdivisionRounds"] = scene.subdivision_rounds;
  }
  if (scene.tracking.frequency > 0) json["tracking"]["frequency"] = scene.tracking.frequency;
  if (scene.tracking.spring > 0) json["tracking"]["spring"] = scene.tracking.spring;
  if (scene.tracking.two_level) json["tracking"]["twoLevel"] = true;
  if (scene.contact.friction != simulation::Contact().friction) json["friction"] = scene.contact.friction;
  if (scene.contact.obstacle_friction != simulation::Contact().obstacle_friction) {
    json["obstacleFriction"] = scene.contact.obstacle_friction;
  }
  if (!scene.wind.velocity.isZero()) json["wind"]["velocity"] = to_array(scene.wind.velocity);
  for (const simulation::Handle& handle : scene.handles) {
    nlohmann::ordered_json entry{{"vertices", handle.vertices}, {"hard", handle.hard}};
    if (!handle.motion.keys.empty()) entry["motion"] = to_json(handle.motion);
    json["handles"].push_back(entry);
  }
  for (const simulation::Obstacle& obstacle : scene.obstacles) {
    nlohmann::ordered_json entry;
    entry["name"] = obstacle.name;
    if (plan.body) entry["body"] = to_json(*plan.body);
    if (obstacle.radius > 0) {
      entry["sphere"] = {{"center", to_array(obstacle.center)}, {"radius", obstacle.radius}};
    }
    for (const simulation::Capsule& capsule : obstacle.capsules) {
      entry["capsules"]["capsules"].push_back(
          {{"a", to_array(capsule.a)}, {"b", to_array(capsule.b)}, {"radius", capsule.radius}});
    }
    if (obstacle.mesh.face_count() > 0) entry["mesh"] = to_json(obstacle.mesh);
    if (!obstacle.motion.keys.empty()) entry["motion"] = to_json(obstacle.motion);
    json["obstacles"].push_back(entry);
  }
  return json.dump();
}

}  // namespace pleat::dataset
