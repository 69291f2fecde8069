#include "services/presentation/input/scene_file.hpp"

#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/json.hpp"
#include "common/base/text_file.hpp"
#include "common/frame/frame.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/animated_mesh.hpp"
#include "common/mesh/holes.hpp"
#include "common/mesh/mesh_file.hpp"
#include "common/scene/animation_parts.hpp"
#include "services/presentation/input/animation_input.hpp"
#include "services/presentation/input/body_input.hpp"
#include "services/presentation/input/garment_input.hpp"
#include "services/simulation/material.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxWord = 64;  // names become parts of file names

std::string read_text(const fs::path& path, const std::string& wanted_by) {
  try {
    return read_text_file(path);
  } catch (const Error& error) {
    throw Error(error.code(), wanted_by + error.what());
  }
}

/// One line, without protobuf's status prefix: "INVALID_ARGUMENT:(handles[0]) bogus: Cannot find field."
std::string json_error(const std::string& text) {
  // std::regex takes stack for each character, and protobuf quotes what the file has.
  constexpr std::size_t kMaxCharacters = 1000;
  std::string line = std::regex_replace(text.substr(0, kMaxCharacters), std::regex("\\s+"), " ");
  if (line.starts_with("INVALID_ARGUMENT:")) line = line.substr(17);
  std::smatch match;
  if (std::regex_search(line, match,
                        std::regex(R"(^\(?([^()]*)\)?:? ?(?:invalid name )?([^ ]*): Cannot find field\.?)"))) {
    const std::string where = match[1].str(), key = match[2].str();
    const std::string joint = where.empty() || key.empty() ? "" : ".";
    return std::string("unknown key '").append(where).append(joint).append(key).append("'");
  }
  return line;
}

class Checker {
 public:
  explicit Checker(std::string name) : name_(std::move(name)) {}

  [[noreturn]] void fail(const std::string& message) const { throw_invalid_argument(name_ + ": " + message); }

  void positive(double value, const std::string& key) const {
    if (!(value > 0) || !std::isfinite(value)) fail(key + " must be positive");
  }
  void finite(double value, const std::string& key) const {
    if (!std::isfinite(value)) fail(key + " is not finite");
  }
  template <typename Values>
  void vector(const Values& values, const std::string& key, bool required = false) const {
    if (values.size() == 0 && !required) return;
    if (values.size() != 3) fail(key + " needs 3 values, has " + std::to_string(values.size()));
    for (const auto value : values) finite(static_cast<double>(value), key);
  }
  void word(const std::string& text, const std::string& key) const {
    const bool allowed = std::all_of(text.begin(), text.end(), [](char c) {
      return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
    });
    if (text.empty() || !allowed) fail(key + " '" + text.substr(0, 100) + "' must be letters, digits, '-' or '_'");
    if (text.size() > kMaxWord) fail(key + " has " + std::to_string(text.size()) + " characters, at most 64");
  }
  template <typename KeyFrames>
  void motion(const KeyFrames& keys, const std::string& where) const {
    for (int k = 0; k < keys.size(); ++k) {
      const std::string key = where + ".motion[" + std::to_string(k) + "]";
      finite(keys[k].time_s(), key + ".time_s");
      finite(keys[k].angle_deg(), key + ".angle_deg");
      vector(keys[k].translation(), key + ".translation");
      vector(keys[k].axis(), key + ".axis");
      if (k > 0 && keys[k].time_s() <= keys[k - 1].time_s()) fail(key + ".time_s is not after the key before it");
    }
  }

 private:
  std::string name_;
};

/// Proto3 can't tell an explicit 0 from an absent value; the file can.
void check_explicit_zeros(const nlohmann::json& json, const Checker& check) {
  const std::pair<const char*, const char*> keys[] = {
      {"frames", "frames"}, {"steps_per_frame", "stepsPerFrame"}, {"frame_time_s", "frameTimeS"}};
  for (const auto& [snake, camel] : keys) {
    for (const char* key : {snake, camel}) {
      const auto found = json.find(key);
      if (found != json.end() && found->is_number()) check.positive(found->get<double>(), snake);
    }
  }
}

void check_scene(const v1::Scene& scene, Eigen::Index vertices, const Checker& check) {
  check.word(scene.name(), "name");
  check.vector(scene.gravity(), "gravity");
  check.vector(scene.placement().translation(), "placement.translation");
  check.vector(scene.placement().axis(), "placement.axis");
  check.finite(scene.placement().angle_deg(), "placement.angle_deg");
  check.vector(scene.wind().velocity(), "wind.velocity");
  if (scene.subdivision_rounds() > 5) check.fail("subdivision_rounds is above 5");
  for (int h = 0; h < scene.handles_size(); ++h) {
    const v1::Handle& handle = scene.handles(h);
    const std::string where = "handles[" + std::to_string(h) + "]";
    if (handle.vertices_size() == 0) check.fail(where + ".vertices is empty");
    for (int k = 0; k < handle.vertices_size(); ++k) {
      if (handle.vertices(k) >= static_cast<std::uint64_t>(vertices))
        check.fail(where + ".vertices[" + std::to_string(k) + "]: vertex " + std::to_string(handle.vertices(k)) +
                   " does not exist, the garment has " + std::to_string(vertices));
    }
    if (handle.has_stiffness()) check.positive(handle.stiffness(), where + ".stiffness");
    if (handle.has_end_s() && handle.end_s() <= handle.start_s()) check.fail(where + ".end_s is not after start_s");
    check.motion(handle.motion(), where);
  }
  std::set<std::string> names;
  for (int o = 0; o < scene.obstacles_size(); ++o) {
    const v1::Obstacle& obstacle = scene.obstacles(o);
    const std::string where = "obstacles[" + std::to_string(o) + "]";
    check.word(obstacle.name(), where + ".name");
    if (!names.insert(obstacle.name()).second) check.fail(where + ".name '" + obstacle.name() + "' is taken");
    if (obstacle.shape_case() == v1::Obstacle::SHAPE_NOT_SET)
      check.fail(where + " has neither sphere nor capsules nor mesh_file nor body");
    for (int c = 0; c < obstacle.capsules().capsules_size(); ++c) {
      const v1::Capsule& capsule = obstacle.capsules().capsules(c);
      const std::string key = where + ".capsules.capsules[" + std::to_string(c) + "]";
      check.vector(capsule.a(), key + ".a", true);
      check.vector(capsule.b(), key + ".b", true);
      check.positive(capsule.radius(), key + ".radius");
    }
    if (obstacle.has_animation()) {
      if (obstacle.motion_size() > 0) check.fail(where + " has motion and animation");
      if (obstacle.animation().has_sample_time_s())
        check.positive(obstacle.animation().sample_time_s(), where + ".animation.sample_time_s");
    }
    if (obstacle.has_sphere()) {
      check.vector(obstacle.sphere().center(), where + ".sphere.center");
      check.positive(obstacle.sphere().radius(), where + ".sphere.radius");
    }
    check.motion(obstacle.motion(), where);
  }
}

double frame_time_of(const v1::Scene& scene) {
  return scene.frame_time_s() > 0 ? scene.frame_time_s() : kDefaultFrameTime;
}

/// How many samples of an animation the scene's frames see; one more, for the way to it.
std::size_t samples_needed(double sample_time, const v1::Scene& scene) {
  const double frame_time = frame_time_of(scene);
  if (!(sample_time > 0)) return 1;
  const double last = static_cast<double>(scene.frames()) * frame_time / sample_time;
  return static_cast<std::size_t>(std::min(std::ceil(last), 1e9)) + 2;
}

/// Puts what the obstacle's files hold in their places.
void inline_obstacle(v1::Obstacle& obstacle, const v1::Scene& scene, const fs::path& folder, const std::string& where,
                     const SceneReading& reading, std::vector<std::string>& notes) {
  const double frame_time = frame_time_of(scene);
  if (obstacle.has_body()) {
    const double sample_time = obstacle.body().has_frame_time_s() ? obstacle.body().frame_time_s() : frame_time;
    const bool linear = obstacle.body().skinning() != v1::Body::SKINNING_DUAL_QUATERNION;
    body::AnimatedBody body =
        inline_body(obstacle, frame_time, samples_needed(sample_time, scene), folder, where, notes);
    if (reading.bodies != nullptr && linear && sample_time == frame_time) {
      reading.bodies->push_back({obstacle.name(), std::make_shared<const body::AnimatedBody>(std::move(body))});
    }
    return;
  }
  if (obstacle.shape_case() == v1::Obstacle::kMeshFile) {
    const fs::path file = folder / obstacle.mesh_file();
    std::error_code ignored;
    if (!fs::is_regular_file(file, ignored)) throw_not_found(where + ".mesh_file " + file.string() + ": no such file");
    if (is_animated_mesh_file(file) && !obstacle.has_animation() && obstacle.motion_size() == 0) {
      // A file with frames moves.
      const auto animated = open_animated_mesh(file);
      if (animated->frame_count() > 1) {
        obstacle.mutable_animation()->set_file(obstacle.mesh_file());
        obstacle.mutable_animation()->set_sample_time_s(animated->frame_time_s());
      }
    }
    *obstacle.mutable_mesh() = to_message(
        close_holes(read_mesh(file, MeshUse::kObstacle), !obstacle.animation().file().empty(), file.string(), notes));
  }
  if (obstacle.animation().file().empty()) return;
  const std::string name = std::exchange(*obstacle.mutable_animation()->mutable_file(), "");
  const double sample_time =
      obstacle.animation().has_sample_time_s() ? obstacle.animation().sample_time_s() : frame_time;
  try {
    for (const Positions& sample : read_animation(folder / name, static_cast<Eigen::Index>(animated_points(obstacle)),
                                                  samples_needed(sample_time, scene)))
      obstacle.mutable_animation()->mutable_positions()->Add(sample.data(), sample.data() + sample.size());
  } catch (const Error& error) {
    throw Error(error.code(), where + ".animation.file: " + error.what());
  }
}

}  // namespace

v1::Scene parse_scene(const std::string& text, const std::string& name, const fs::path& folder,
                      const SceneReading& reading) {
  const Checker check(name);
  const nlohmann::json json = parse_json(text, name);
  if (!json.is_object()) check.fail("a scene is a JSON object");
  v1::Scene scene;
  const auto status = google::protobuf::util::JsonStringToMessage(plain_json(text, name), &scene);
  if (!status.ok()) check.fail(json_error(status.ToString()));
  check_explicit_zeros(json, check);
  if (reading.frames > 0) scene.set_frames(reading.frames);
  std::vector<std::string> unheard;
  std::vector<std::string>& notes = reading.notes != nullptr ? *reading.notes : unheard;
  if (scene.frames() == 0) check.fail("frames is missing");

  switch (scene.garment_case()) {
    case v1::Scene::kGarmentFile:
      inline_garments(scene, folder, name, reading.scale, notes);
      break;
    case v1::Scene::kGarmentMesh:
      if (!scene.further_garment_files().empty()) check.fail("further_garment_files go with a garment_file");
      break;
    case v1::Scene::GARMENT_NOT_SET:
      check.fail("garment_file is missing");
  }
  if (scene.has_material_file()) {
    const fs::path file = folder / scene.material_file();
    const std::string material = plain_json(read_text(file, name + ": material_file "), file.string());
    simulation::parse_material(material, file.string());  // here the file still has its name
    scene.set_material_json(material);
  } else if (scene.has_isotropic()) {
    check.positive(scene.isotropic().density(), "isotropic.density");
    check.positive(scene.isotropic().youngs_modulus(), "isotropic.youngs_modulus");
    check.positive(scene.isotropic().thickness(), "isotropic.thickness");
    if (!(scene.isotropic().poissons_ratio() >= 0 && scene.isotropic().poissons_ratio() <= 0.5))
      check.fail("isotropic.poissons_ratio must be 0 to 0.5");
  } else if (!scene.has_material_json()) {
    check.fail("material_file is missing");
  }
  for (int o = 0; o < scene.obstacles_size(); ++o) {
    inline_obstacle(*scene.mutable_obstacles(o), scene, folder, name + ": obstacles[" + std::to_string(o) + "]",
                    reading, notes);
  }
  check_scene(scene, scene.garment_mesh().rest_positions_size() / 3, check);
  return scene;
}

v1::Scene read_scene_file(const fs::path& path, const SceneReading& reading) {
  return parse_scene(read_text(path, ""), path.string(), path.parent_path(), reading);
}

}  // namespace pleat::presentation
