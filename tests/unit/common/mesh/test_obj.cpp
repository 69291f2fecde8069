#include "common/mesh/obj.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <random>
#include <sstream>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

using testing::HasSubstr;

Topology read(const std::string& text, const ObjLimits& limits = {}) {
  std::istringstream stream(text);
  return read_obj(stream, "test.obj", limits);
}

void expect_refused(const std::string& text, const std::string& culprit, ErrorCode code = ErrorCode::kInvalidArgument,
                    const ObjLimits& limits = {}) {
  try {
    read(text, limits);
    FAIL() << "accepted: " << text;
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), code) << e.what();
    EXPECT_THAT(e.what(), HasSubstr("test.obj"));
    EXPECT_THAT(e.what(), HasSubstr(culprit));
  }
}

constexpr const char* kTriangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";

TEST(Obj, ReadsEveryFormOfCorner) {
  for (const char* face : {"f 1 2 3", "f 1/1 2/2 3/3", "f 1/1/1 2/2/1 3/3/1", "f 1//1 2//1 3//1", "f -3 -2 -1"}) {
    const Topology t = read(std::string(kTriangle) + "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n" + face + "\n");
    ASSERT_EQ(t.face_count(), 1) << face;
    EXPECT_EQ(t.faces.row(0), (Eigen::Matrix<std::uint32_t, 1, 3>(0, 1, 2))) << face;
    const bool with_uv =
        std::string(face).find("/1") != std::string::npos && std::string(face).find("//") == std::string::npos;
    EXPECT_EQ(t.uv_faces.rows(), with_uv ? 1 : 0) << face;
  }
}

TEST(Obj, KeepsSeamsApart) {
  const Topology t = read(
      "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 5 5\nvt 6 6\nvt 5 6\n"
      "f 1/1 2/2 3/3\nf 1/4 3/5 4/6\n");
  EXPECT_EQ(t.vertex_count(), 4);
  EXPECT_EQ(t.uv.rows(), 6);
  EXPECT_EQ(t.uv_faces.row(1), (Eigen::Matrix<std::uint32_t, 1, 3>(3, 4, 5)));
}

TEST(Obj, TriangulatesPolygonsAsFans) {
  const Topology t = read("v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\nf 1 2 3 4 5\n");
  ASSERT_EQ(t.face_count(), 3);
  EXPECT_EQ(t.faces.row(2), (Eigen::Matrix<std::uint32_t, 1, 3>(0, 3, 4)));
}

TEST(Obj, IgnoresWhatItDoesNotKnow) {
  const Topology t =
      read("# comment\r\nmtllib a.mtl\no thing\n\n   \nv 0 0 0 1.0\nv +1 0 0\nv 0 1e0 0\ns off\r\nf 1 2 3\r\n");
  EXPECT_EQ(t.vertex_count(), 3);
  EXPECT_EQ(t.rest_positions(1, 0), 1.0f);
}

TEST(Obj, NamesTheLineOfAnError) {
  expect_refused("v 0 0 0\nv 1 x 0\n", "test.obj:2");
  expect_refused("v 0 0\n", "expected a number");
  expect_refused("v nan 0 0\n", "not finite");
  expect_refused("v inf 0 0\n", "not finite");
  expect_refused("v 1e99 0 0\n", "expected a number");
  const std::string t = kTriangle;
  expect_refused(t + "f 1 2\n", "2 corners");
  expect_refused(t + "f\n", "0 corners");
  expect_refused(t + "f 1 2 0\n", "index 0");
  expect_refused(t + "f 1 2 -4\n", "out of range");
  expect_refused(t + "f 1 2 a\n", "expected an index");
  expect_refused(t + "f 1 2 3x\n", "expected an index");
  expect_refused(t + "f 1 2 99999999999999999999\n", "expected an index");
  expect_refused(t + "f 1 2 4\n", "names index 3");
  expect_refused(t + "vt 0 0\nf 1/1 2/1 3/2\n", "names index 1");
  expect_refused(t + "vt 0 0\nf 1/1 2/1 3\n", "some do not");
  expect_refused(t + "f 1 1 2\n", "repeats vertex");
}

TEST(Obj, RefusesEmptyFiles) {
  expect_refused("", "no vertices or no faces");
  expect_refused(kTriangle, "no vertices or no faces");
  expect_refused("f 1 2 3\n", "no vertices or no faces");
}

TEST(Obj, KeepsItsLimits) {
  expect_refused(kTriangle, "more than 2 vertices", ErrorCode::kResourceExhausted, {.max_vertices = 2});
  std::string faces = kTriangle;
  for (int i = 0; i < 5; ++i) faces += "f 1 2 3\n";
  expect_refused(faces, "more than 4 faces", ErrorCode::kResourceExhausted, {.max_faces = 4});
}

TEST(Obj, MissingFileIsNotFound) {
  for (const char* path : {"/nonexistent/cloth.obj", "/tmp"}) {
    try {
      read_obj(std::filesystem::path(path));
      FAIL();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kNotFound);
      EXPECT_THAT(e.what(), HasSubstr(path));
    }
  }
}

TEST(Obj, RandomBytesNeverCrash) {
  std::mt19937 engine(5);
  const std::string alphabet = "vtf /-+.0123456789e\n\r\t#nai";
  int refused = 0;
  for (int i = 0; i < 3000; ++i) {
    std::string text = i % 2 ? kTriangle : "";
    for (int k = 0; k < 60; ++k) text += alphabet[engine() % alphabet.size()];
    try {
      validate_topology(read(text), "random");
    } catch (const Error&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 1000);
}

TEST(Obj, WritingAndReadingGivesTheSameBits) {
  const Topology t = read_obj(std::filesystem::path("deploy/garments/skirt.obj"));
  const test::TemporaryFolder folder;
  const auto path = folder.path() / "skirt.obj";
  write_obj(path, t);
  const Topology again = read_obj(path);
  EXPECT_EQ(topology_hash(again), topology_hash(t));
  EXPECT_THROW(write_obj("/nonexistent/x.obj", t), Error);
  EXPECT_THROW(write_obj(path, t, t.rest_positions.topRows(3)), Error);
}

TEST(Obj, SaysWhichDiskIsFull) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP();
  try {
    write_obj("/dev/full", read_obj(std::filesystem::path("deploy/garments/tablecloth.obj")));
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kResourceExhausted);
    EXPECT_THAT(e.what(), HasSubstr("/dev/full"));
  }
}

}  // namespace
}  // namespace pleat
