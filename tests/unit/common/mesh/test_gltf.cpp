#include "common/mesh/gltf.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

using Json = nlohmann::json;

/// A square of two triangles whose diagonal is a seam: vertices 1 and 2 are there twice. Frames 0, 1, 2 of 0.1 s; in
/// frame 1 the far corner is 0.5 m higher, in frame 2 both points of vertex 1 are 0.25 m to the left.
class Square {
 public:
  Square() {
    add({0, 0, 0, 1, 0, 0, 0, 1, 0, /* the other side */ 1, 0, 0, 1, 1, 0, 0, 1, 0});  // 0: positions
    add({0, 1, 1, 1, 0, 0, /**/ 3, 1, 3, 0, 2, 0});                                    // 1: uv, v down
    add({0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.5F, 0, 0, 0, 0});                    // 2: target
    add({0, 0, 0, -0.25F, 0, 0, 0, 0, 0, -0.25F, 0, 0, 0, 0, 0, 0, 0, 0});             // 3: target
    add({0, 0.1F, 0.2F});                                                              // 4: times
    add({0, 0, 1, 0, 0, 1});                                                           // 5: weights
    const std::uint16_t indices[] = {0, 1, 2, 3, 4, 5};
    buffer_.append(reinterpret_cast<const char*>(indices), sizeof indices);
    json_ = {{"asset", {{"version", "2.0"}}},
             {"scenes", {{{"nodes", {0}}}}},
             {"nodes", {{{"mesh", 0}}}},
             {"buffers", {{{"byteLength", buffer_.size()}}}},
             {"bufferViews", {{{"buffer", 0}, {"byteLength", buffer_.size()}}}},
             {"animations",
              {{{"channels", {{{"sampler", 0}, {"target", {{"node", 0}, {"path", "weights"}}}}}},
                {"samplers", {{{"input", 4}, {"output", 5}}}}}}}};
    const auto accessor = [&](std::size_t begin, int component, std::size_t count, const char* type) {
      json_["accessors"].push_back(
          {{"bufferView", 0}, {"byteOffset", begin}, {"componentType", component}, {"count", count}, {"type", type}});
    };
    accessor(begins_[0], 5126, 6, "VEC3");
    accessor(begins_[1], 5126, 6, "VEC2");
    accessor(begins_[2], 5126, 6, "VEC3");
    accessor(begins_[3], 5126, 6, "VEC3");
    accessor(begins_[4], 5126, 3, "SCALAR");
    accessor(begins_[5], 5126, 6, "SCALAR");
    accessor(buffer_.size() - sizeof indices, 5123, 6, "SCALAR");
    json_["meshes"] = Json::array({{{"primitives", Json::array({primitive()})}}});
  }

  static Json primitive() {
    return {{"attributes", {{"POSITION", 0}, {"TEXCOORD_0", 1}}},
            {"indices", 6},
            {"targets", {{{"POSITION", 2}}, {{"POSITION", 3}}}}};
  }

  void write_glb(const std::filesystem::path& path) const {
    std::string text = json_.dump();
    text.resize((text.size() + 3) / 4 * 4, ' ');
    std::ofstream file(path, std::ios::binary);
    const auto word = [&](std::size_t value) {
      const auto bits = static_cast<std::uint32_t>(value);
      file.write(reinterpret_cast<const char*>(&bits), 4);
    };
    for (const std::size_t value : {std::size_t{0x46546C67}, std::size_t{2}, 28 + text.size() + buffer_.size(),
                                    text.size(), std::size_t{0x4E4F534A}}) {
      word(value);
    }
    file << text;
    word(buffer_.size());
    word(0x004E4942);
    file.write(buffer_.data(), static_cast<std::streamsize>(buffer_.size()));
  }
  /// With the buffer in a file of its own.
  void write_gltf(const std::filesystem::path& path, const std::string& uri = "square.bin") {
    json_["buffers"][0]["uri"] = uri;
    std::ofstream(path) << json_;
    std::ofstream(path.parent_path() / "square.bin", std::ios::binary) << buffer_;
  }

  Json json_;
  std::string buffer_;

 private:
  void add(const std::vector<float>& values) {
    begins_.push_back(buffer_.size());
    buffer_.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float));
  }
  std::vector<std::size_t> begins_;
};

Positions expected(int frame) {
  Positions positions(4, 3);
  positions << 0, 0, 0, (frame == 2 ? 0.75F : 1.0F), 0, 0, 0, 1, 0, 1, (frame == 1 ? 1.5F : 1.0F), 0;
  return positions;
}

class Gltf : public testing::Test {
 protected:
  std::unique_ptr<AnimatedMesh> open() const {
    square_.write_glb(folder_.path() / "square.glb");
    return open_gltf(folder_.path() / "square.glb");
  }
  void expect_refused(ErrorCode code, const std::string& text) const {
    const Error error = test::error_of([&] { open(); });
    EXPECT_EQ(error.code(), code) << error.what();
    EXPECT_NE(std::string(error.what()).find(text), std::string::npos) << error.what();
  }

  const test::TemporaryFolder folder_;
  Square square_;
};

TEST_F(Gltf, AMorphedMeshIsItsFramesAndASeamIsASeam) {
  const auto mesh = open();
  ASSERT_EQ(mesh->frame_count(), 3u);
  EXPECT_NEAR(mesh->frame_time_s(), 0.1, 1e-6);
  for (int frame = 0; frame < 3; ++frame) EXPECT_EQ(mesh->positions(static_cast<std::size_t>(frame)), expected(frame));
  const Topology topology = to_topology(mesh->mesh(), "square", MeshUse::kGarment);
  EXPECT_EQ(topology.vertex_count(), 4);
  Faces faces(2, 3);
  faces << 0, 1, 2, 1, 3, 2;
  EXPECT_EQ(topology.faces, faces);
  ASSERT_EQ(topology.uv.rows(), 6) << "both sides of the seam";
  EXPECT_EQ(topology.uv.row(topology.uv_faces(0, 0)), Eigen::RowVector2f(0, 0)) << "v goes up";
  EXPECT_EQ(topology.uv.row(topology.uv_faces(1, 0)), Eigen::RowVector2f(3, 0));
}

TEST_F(Gltf, BuffersBesideTheFileAndInItAreRead) {
  square_.write_gltf(folder_.path() / "square.gltf");
  EXPECT_EQ(open_gltf(folder_.path() / "square.gltf")->positions(1), expected(1));
  std::string base64;
  constexpr std::string_view kLetters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  ASSERT_EQ(square_.buffer_.size() % 3, 0u);
  for (std::size_t i = 0; i < square_.buffer_.size(); i += 3) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 3; ++k) bits = bits << 8 | static_cast<unsigned char>(square_.buffer_[i + k]);
    for (int shift = 18; shift >= 0; shift -= 6) base64 += kLetters[(bits >> shift) & 63u];
  }
  square_.write_gltf(folder_.path() / "inside.gltf", "data:application/octet-stream;base64," + base64);
  EXPECT_EQ(open_gltf(folder_.path() / "inside.gltf")->positions(2), expected(2));
}

TEST_F(Gltf, NodesPlaceTheMesh) {
  square_.json_["scenes"][0]["nodes"] = {1};
  square_.json_["nodes"].push_back({{"children", {0}}, {"translation", {0, 0, 2}}, {"scale", {2, 2, 2}}});
  square_.json_["nodes"][0]["rotation"] = {0, 0, std::sqrt(0.5), std::sqrt(0.5)};  // a quarter about z
  Positions turned = expected(1);
  for (auto row : turned.rowwise()) row = Eigen::RowVector3f(-2 * row(1), 2 * row(0), 2);
  EXPECT_LT((open()->positions(1) - turned).cwiseAbs().maxCoeff(), 1e-6F);
}

TEST_F(Gltf, AMirroredMeshKeepsItsOutside) {
  square_.json_["nodes"][0]["scale"] = {-1, 1, 1};
  const PolygonMesh mesh = open()->mesh();
  EXPECT_EQ(mesh.corners[1].vertex, 2u);
  EXPECT_EQ(mesh.corners[2].vertex, 1u);
}

TEST_F(Gltf, SparseTargetsAreRead) {
  // Frame 2's target, as exporters write it: only the points that move.
  Json& accessors = square_.json_["accessors"];
  const std::size_t begin = square_.buffer_.size();
  const std::uint8_t places[] = {1, 3, 0, 0};
  const float values[] = {-0.25F, 0, 0, -0.25F, 0, 0};
  square_.buffer_.append(reinterpret_cast<const char*>(places), sizeof places);
  square_.buffer_.append(reinterpret_cast<const char*>(values), sizeof values);
  square_.json_["buffers"][0]["byteLength"] = square_.buffer_.size();
  square_.json_["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", begin}, {"byteLength", 4}});
  square_.json_["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", begin + 4}, {"byteLength", sizeof values}});
  accessors[3] = {
      {"componentType", 5126},
      {"count", 6},
      {"type", "VEC3"},
      {"sparse",
       {{"count", 2}, {"indices", {{"bufferView", 1}, {"componentType", 5121}}}, {"values", {{"bufferView", 2}}}}}};
  EXPECT_EQ(open()->positions(2), expected(2));
  accessors[3]["sparse"]["count"] = 7;
  expect_refused(ErrorCode::kResourceExhausted, "7");
}

TEST_F(Gltf, WithoutAnAnimationThereIsOneFrame) {
  square_.json_.erase("animations");
  square_.json_["meshes"][0]["weights"] = {1, 0};
  EXPECT_EQ(open()->frame_count(), 1u);
  EXPECT_EQ(open()->positions(0), expected(1));
}

TEST_F(Gltf, WhatItDoesNotReadIsNamed) {
  const Json good = square_.json_;
  square_.json_["extensionsRequired"] = {"KHR_draco_mesh_compression"};
  expect_refused(ErrorCode::kInvalidArgument, "KHR_draco_mesh_compression");
  square_.json_ = good;
  square_.json_["nodes"][0]["skin"] = 0;
  expect_refused(ErrorCode::kInvalidArgument, "skeleton");
  square_.json_ = good;
  square_.json_["animations"][0]["channels"].push_back(
      {{"sampler", 0}, {"target", {{"node", 0}, {"path", "translation"}}}});
  expect_refused(ErrorCode::kInvalidArgument, "animated as a whole");
  square_.json_ = good;
  square_.json_["meshes"][0]["primitives"][0]["mode"] = 5;
  expect_refused(ErrorCode::kInvalidArgument, "strips");
  square_.json_ = good;
  square_.json_["asset"]["version"] = "1.0";
  expect_refused(ErrorCode::kInvalidArgument, "version '1.0'");
}

TEST_F(Gltf, LiesAboutSizesAreRefused) {
  const Json good = square_.json_;
  square_.json_["accessors"][0]["count"] = 600;
  expect_refused(ErrorCode::kDataLoss, "beyond");
  square_.json_ = good;
  square_.json_["bufferViews"][0]["byteLength"] = 1'000'000;
  expect_refused(ErrorCode::kDataLoss, "beyond its buffer");
  square_.json_ = good;
  square_.json_["bufferViews"][0]["byteOffset"] = 0xffffffffffffffffull;
  expect_refused(ErrorCode::kDataLoss, "beyond its buffer");
  square_.json_ = good;
  square_.json_["nodes"][0]["children"] = {0};
  expect_refused(ErrorCode::kInvalidArgument, "no tree");
  square_.json_ = good;
  square_.json_["buffers"][0]["uri"] = "../../etc/passwd";
  expect_refused(ErrorCode::kInvalidArgument, "beside");
  square_.json_ = good;
  square_.json_["accessors"][5]["count"] = 4;
  expect_refused(ErrorCode::kInvalidArgument, "number of weights");
  square_.json_ = good;
  square_.json_["accessors"][0] = "text";
  expect_refused(ErrorCode::kInvalidArgument, "square.glb");
}

TEST_F(Gltf, ATruncatedFileIsDataLoss) {
  square_.write_glb(folder_.path() / "square.glb");
  std::filesystem::resize_file(folder_.path() / "square.glb", 200);
  const Error error = test::error_of([&] { open_gltf(folder_.path() / "square.glb"); });
  EXPECT_EQ(error.code(), ErrorCode::kDataLoss) << error.what();
}

}  // namespace
}  // namespace pleat
