// Skinned meshes as glTF files with the data inside, written without the reader's libraries.
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "services/simulation/body/motion.hpp"
#include "services/simulation/body/skinned_mesh.hpp"

namespace pleat::body {

struct GltfOptions {
  double unit = 1;      ///< of the file, metres
  bool weights = true;  ///< false: a mesh without a skin
  bool mesh = true;     ///< false: joints and animation only
  bool split = false;   ///< every face has vertices of its own, as exporters with normals write
  std::string parent;   ///< a node above the joints, turned and scaled by 0.01
};

class GltfWriter {
 public:
  GltfWriter(const SkinnedMesh& body, const Motion* motion, const GltfOptions& options)
      : body_(body), options_(options) {
    add_nodes();
    if (options.mesh) add_mesh();
    if (motion != nullptr) add_animation(*motion);
  }

  void write(const std::filesystem::path& path) const {
    nlohmann::json json = json_;
    json["asset"] = {{"version", "2.0"}};
    json["buffers"] = {{{"byteLength", bytes_.size()}, {"uri", path.stem().string() + ".bin"}}};
    std::ofstream(path) << json.dump();
    std::filesystem::path bin = path;
    std::ofstream(bin.replace_extension(".bin"), std::ios::binary)
        .write(bytes_.data(), static_cast<std::streamsize>(bytes_.size()));
  }

 private:
  template <typename T>
  std::size_t add(const std::vector<T>& values, int component, const char* kind, std::size_t width) {
    const std::size_t offset = bytes_.size();
    bytes_.resize(offset + values.size() * sizeof(T));
    std::memcpy(bytes_.data() + offset, values.data(), values.size() * sizeof(T));
    bytes_.resize((bytes_.size() + 3) / 4 * 4);
    json_["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", offset}, {"byteLength", values.size() * sizeof(T)}});
    json_["accessors"].push_back({{"bufferView", json_["bufferViews"].size() - 1},
                                  {"componentType", component},
                                  {"count", values.size() / width},
                                  {"type", kind}});
    if (std::string(kind) == "SCALAR" && component == 5126) {
      json_["accessors"].back()["min"] = {values.front()};
      json_["accessors"].back()["max"] = {values.back()};
    }
    return json_["accessors"].size() - 1;
  }

  void add_nodes() {
    const auto& joints = body_.skeleton.joints;
    const double inside = options_.parent.empty() ? 1 : 100;  // the parent's scale undone
    for (const Joint& joint : joints) {
      const Eigen::Vector3d t = joint.translation * inside / options_.unit;
      json_["nodes"].push_back(
          {{"name", joint.name},
           {"translation", {t.x(), t.y(), t.z()}},
           {"rotation", {joint.rotation.x(), joint.rotation.y(), joint.rotation.z(), joint.rotation.w()}}});
    }
    std::vector<std::size_t> roots;
    for (std::size_t j = 0; j < joints.size(); ++j) {
      if (joints[j].parent < 0) roots.push_back(j);
      if (joints[j].parent >= 0) json_["nodes"][static_cast<std::size_t>(joints[j].parent)]["children"].push_back(j);
    }
    if (!options_.parent.empty()) {
      json_["nodes"].push_back({{"name", options_.parent}, {"scale", {0.01, 0.01, 0.01}}, {"children", roots}});
      roots = {json_["nodes"].size() - 1};
    }
    json_["scene"] = 0;
    json_["scenes"] = {{{"nodes", roots}}};
  }

  void add_mesh() {
    std::vector<std::uint32_t> corners(body_.mesh.faces.data(), body_.mesh.faces.data() + body_.mesh.faces.size());
    std::vector<std::uint32_t> source(static_cast<std::size_t>(body_.mesh.vertex_count()));
    for (std::size_t v = 0; v < source.size(); ++v) source[v] = static_cast<std::uint32_t>(v);
    if (options_.split) {
      source = corners;
      for (std::size_t c = 0; c < corners.size(); ++c) corners[c] = static_cast<std::uint32_t>(c);
    }
    std::vector<float> places, weights;
    std::vector<std::uint16_t> joints;
    for (const std::uint32_t v : source) {
      for (int k = 0; k < 3; ++k) places.push_back(body_.mesh.rest_positions(v, k) / static_cast<float>(options_.unit));
      for (int k = 0; k < kInfluences; ++k) weights.push_back(body_.weights(v, k));
      for (int k = 0; k < kInfluences; ++k) joints.push_back(body_.joints(v, k));
    }
    nlohmann::json primitive = {{"attributes", {{"POSITION", add(places, 5126, "VEC3", 3)}}}};
    primitive["indices"] = add(corners, 5125, "SCALAR", 1);
    if (options_.weights) {
      primitive["attributes"]["JOINTS_0"] = add(joints, 5123, "VEC4", 4);
      primitive["attributes"]["WEIGHTS_0"] = add(weights, 5126, "VEC4", 4);
      std::vector<float> bind;
      std::vector<std::size_t> list;
      for (const RigidTransform& joint : world_transforms(body_.skeleton, rest_pose(body_.skeleton))) {
        Eigen::Matrix4d inverse = Eigen::Matrix4d::Identity();
        inverse.topLeftCorner<3, 3>() = joint.inverse().rotation.toRotationMatrix();
        inverse.topRightCorner<3, 1>() = joint.inverse().translation / options_.unit;
        // The joint's axes are a hundredth of the mesh's units long under a parent of that scale.
        if (!options_.parent.empty()) inverse.topRows<3>() *= 100;
        for (int i = 0; i < 16; ++i) bind.push_back(static_cast<float>(inverse.data()[i]));
        list.push_back(list.size());
      }
      json_["skins"] = {{{"joints", list}, {"inverseBindMatrices", add(bind, 5126, "MAT4", 16)}}};
    }
    json_["meshes"] = {{{"name", "skin"}, {"primitives", {primitive}}}};
    nlohmann::json node = {{"name", "skin"}, {"mesh", 0}};
    if (options_.weights) node["skin"] = 0;
    json_["nodes"].push_back(node);
    json_["scenes"][0]["nodes"].push_back(json_["nodes"].size() - 1);
  }

  void add_animation(const Motion& motion) {
    std::vector<float> times;
    for (std::size_t k = 0; k < motion.frames.size(); ++k)
      times.push_back(static_cast<float>(static_cast<double>(k) * motion.frame_time_s));
    const std::size_t input = add(times, 5126, "SCALAR", 1);
    const double inside = options_.parent.empty() ? 1 : 100;
    nlohmann::json animation;
    const auto channel = [&](std::size_t joint, const char* path, const std::vector<float>& values, const char* kind,
                             std::size_t width) {
      animation["samplers"].push_back({{"input", input}, {"output", add(values, 5126, kind, width)}});
      animation["channels"].push_back(
          {{"sampler", animation["samplers"].size() - 1}, {"target", {{"node", joint}, {"path", path}}}});
    };
    for (std::size_t j = 0; j < motion.skeleton.size(); ++j) {
      std::vector<float> turns, places;
      for (const Pose& pose : motion.frames) {
        const Eigen::Quaterniond& q = pose.rotations[j];
        for (const double value : {q.x(), q.y(), q.z(), q.w()}) turns.push_back(static_cast<float>(value));
        for (int k = 0; k < 3; ++k)
          places.push_back(static_cast<float>(pose.translations[j][k] * inside / options_.unit));
      }
      channel(j, "rotation", turns, "VEC4", 4);
      channel(j, "translation", places, "VEC3", 3);
    }
    json_["animations"] = {animation};
  }

  const SkinnedMesh& body_;
  GltfOptions options_;
  nlohmann::json json_;
  std::vector<char> bytes_;
};

}  // namespace pleat::body
