// PLY in all its forms gives the same mesh.
#include "common/mesh/ply.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>

#include "common/base/error.hpp"
#include "common/mesh/mesh_file.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

class Ply : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& text) const {
    std::ofstream(path_, std::ios::binary) << text;
    return path_;
  }
  void expect_refused(const std::string& text, const std::string& cause,
                      ErrorCode code = ErrorCode::kInvalidArgument) const {
    try {
      read_mesh(write(text), MeshUse::kGarment);
      ADD_FAILURE() << "accepted: " << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), code) << error.what();
      EXPECT_THAT(error.what(), testing::StartsWith(path_.string() + ": "));
      EXPECT_THAT(error.what(), testing::HasSubstr(cause));
    }
  }
  const test::TemporaryFolder temporary_;
  const std::filesystem::path path_ = temporary_.path() / "mesh.ply";
};

std::string header(const std::string& format) {
  return "ply\nformat " + format +
         " 1.0\ncomment by hand\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\n"
         "property uchar red\nproperty float s\nproperty float t\nelement face 1\n"
         "property list uchar int vertex_indices\nproperty list uchar float weights\nend_header\n";
}

constexpr float kVertices[4][3] = {{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}};

TEST_F(Ply, TextAndBothByteOrders) {
  std::string text = header("ascii");
  for (const auto& v : kVertices)
    text += std::to_string(v[0]) + " " + std::to_string(v[1]) + " " + std::to_string(v[2]) + " 255 " +
            std::to_string(v[0]) + " " + std::to_string(v[1]) + "\n";
  text += "4 0 1 2 3 2 0.5 0.5\n";
  const Topology expected = read_mesh(write(text), MeshUse::kGarment);
  ASSERT_EQ(expected.vertex_count(), 4);
  ASSERT_EQ(expected.face_count(), 2);
  EXPECT_EQ(expected.uv(2, 1), 2.0f);
  EXPECT_EQ(expected.uv_faces, expected.faces);
  EXPECT_EQ(read_mesh(path_, MeshUse::kObstacle).uv.rows(), 0);
  EXPECT_EQ(read_mesh_frame(path_, expected), expected.rest_positions);

  for (const bool big : {false, true}) {
    std::string bytes = header(big ? "binary_big_endian" : "binary_little_endian");
    const auto add = [&](auto value) {
      std::string raw(reinterpret_cast<const char*>(&value), sizeof value);
      if (big) std::reverse(raw.begin(), raw.end());
      bytes += raw;
    };
    for (const auto& v : kVertices) {
      add(static_cast<double>(v[0]));
      add(v[1]);
      add(v[2]);
      add(std::uint8_t{255});
      add(v[0]);
      add(v[1]);
    }
    add(std::uint8_t{4});
    for (const std::int32_t i : {0, 1, 2, 3}) add(i);
    add(std::uint8_t{1});
    add(0.5f);
    EXPECT_EQ(topology_hash(read_mesh(write(bytes), MeshUse::kGarment)), topology_hash(expected)) << big;
    expect_refused(bytes.substr(0, bytes.size() - 10), "truncated", ErrorCode::kDataLoss);
  }
}

TEST_F(Ply, FaultsAreNamed) {
  expect_refused("obj\n", "not a PLY file");
  expect_refused("ply\nformat ascii 1.0\n", "truncated", ErrorCode::kDataLoss);
  expect_refused("ply\nend_header\n", "no format");
  expect_refused("ply\nformat xml 1.0\nend_header\n", "unknown format");
  expect_refused("ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n", "more than",
                 ErrorCode::kResourceExhausted);
  expect_refused("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n", "no x, y and z");
  const std::string begin =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
      "property list uchar int vertex_index\nend_header\n";
  expect_refused(begin + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "names index 3");
  expect_refused(begin + "0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "does not exist");
  expect_refused(begin + "0 0 0\n1 0 0\n0 1 0\n3 0 1 1\n", "fewer than 3");
  expect_refused(begin + "0 0 0\n1 0 x\n", "no number", ErrorCode::kDataLoss);
  EXPECT_EQ(read_mesh(write(begin + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), MeshUse::kGarment).face_count(), 1);
}

TEST_F(Ply, OtherEndingsAreRefused) {
  EXPECT_THROW(read_mesh("mesh.stl", MeshUse::kObstacle), Error);
  EXPECT_TRUE(is_mesh_file("A.OBJ"));
  EXPECT_FALSE(is_mesh_file("a.pc2"));
}

}  // namespace
}  // namespace pleat
