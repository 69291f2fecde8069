#include "common/mesh/obj.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

using testing::HasSubstr;

namespace fs = std::filesystem;

const fs::path kCases = "tests/cases";

Topology read(const std::string& text, const ObjLimits& limits = {}, MeshUse use = MeshUse::kGarment) {
  std::istringstream stream(text);
  return read_obj(stream, "test.obj", use, limits);
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

TEST(Obj, CutsPolygonsAlongTheirInside) {
  const Topology t = read("v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\nf 1 2 3 4 5\n");
  ASSERT_EQ(t.face_count(), 3);
  EXPECT_EQ(t.faces.row(2), (Eigen::Matrix<std::uint32_t, 1, 3>(0, 3, 4)));
  expect_refused("v 0 0 0\nv 2 2 0\nv 2 0 0\nv 0 1 0\nv -3 0.5 0\nf 1 2 3 4 5\n",
                 "test.obj:6: the polygon of 5 corners crosses itself");
}

/// Area of the faces that look up, seen from above.
double area_from_above(const Topology& t) {
  double sum = 0;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const Eigen::Vector3d a = t.rest_positions.row(t.faces(f, 0)).cast<double>();
    const Eigen::Vector3d b = t.rest_positions.row(t.faces(f, 1)).cast<double>();
    const Eigen::Vector3d c = t.rest_positions.row(t.faces(f, 2)).cast<double>();
    sum += std::max(0.0, (b - a).cross(c - a).y()) / 2;
  }
  return sum;
}

TEST(Obj, AConcavePolygonCoversItsOwnArea) {
  const fs::path folder = kCases / "05-obj-concave-polygon";
  const Topology right = read_obj(folder / "table-triangles.obj", MeshUse::kObstacle);
  for (const char* file : {"table-polygon.obj", "table-closing-vertex.obj"}) {
    const Topology table = read_obj(folder / file, MeshUse::kObstacle);
    EXPECT_EQ(table.rest_positions, right.rest_positions) << file;
    EXPECT_EQ(table.face_count(), right.face_count()) << file;
    EXPECT_NEAR(area_from_above(table), area_from_above(right), 1e-6) << file;
  }
}

TEST(Obj, LinesGoOnAfterABackslash) {
  const fs::path folder = kCases / "01-obj-line-continuation";
  const Topology plain = read_obj(folder / "plain.obj"), wrapped = read_obj(folder / "wrapped.obj");
  EXPECT_EQ(plain.vertex_count(), 121);
  EXPECT_EQ(plain.face_count(), 200);
  EXPECT_EQ(topology_hash(wrapped), topology_hash(plain));
  const Topology quads = read_obj(folder / "wrapped-quads.obj");
  EXPECT_EQ(quads.rest_positions, plain.rest_positions);
  EXPECT_EQ(quads.face_count(), 200);
  EXPECT_NEAR(area_from_above(quads), area_from_above(plain), 1e-6);

  const Topology t = read("v 0 \\\n0 0\nv 1 0\\\r\n 0\nv 0 1 0 \\ \t\n\nf 1\\\n2 3\n");
  EXPECT_EQ(t.vertex_count(), 3);
  EXPECT_EQ(t.face_count(), 1);
  EXPECT_EQ(read(std::string("# C:\\objects\\\n") + kTriangle + "f 1 2 3").vertex_count(), 3);
  EXPECT_EQ(read(std::string(kTriangle) + "f 1 2 3\\").face_count(), 1);
  expect_refused("v 0 \\\n0 0\nv 1 \\\nx 0\n", "test.obj:3");
}

TEST(Obj, ReadsWhatEditorsSave) {
  const fs::path folder = kCases / "02-obj-bom-crlf";
  const Topology garment = read_obj(folder / "garment.obj");
  for (const char* file : {"bom-first-line-is-vertex.obj", "bom-first-line-is-comment.obj", "mac-cr-only.obj"}) {
    EXPECT_EQ(topology_hash(read_obj(folder / file)), topology_hash(garment)) << file;
  }
  EXPECT_EQ(topology_hash(read_obj(folder / "body-bom-stray-vertex.obj", MeshUse::kObstacle)),
            topology_hash(read_obj(folder / "body-stray-vertex.obj", MeshUse::kObstacle)));
  try {
    read_obj(folder / "utf16.obj");
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(e.what(), HasSubstr("utf16.obj: is text in UTF-16"));
  }
  // Files that were put one behind the other have marks inside.
  EXPECT_EQ(read("v 0 0 0\nv 1 0 0\n\xEF\xBB\xBFv 0 1 0\nf 1 2 3\n").vertex_count(), 3);
}

TEST(Obj, ObstaclesNeedNoMaterialCoordinates) {
  const fs::path body = kCases / "06-obj-some-objects-without-uv" / "body.obj";
  const Topology t = read_obj(body, MeshUse::kObstacle);
  EXPECT_EQ(t.vertex_count(), 16);
  EXPECT_EQ(t.face_count(), 24);
  EXPECT_EQ(t.uv.rows() + t.uv_faces.rows(), 0);
  EXPECT_THROW(read_obj(body), Error);
}

TEST(Obj, FramesAreTheVerticesOfTheRestMeshsPolygons) {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "frame.obj";
  const auto frame = [&](const std::string& text, const Topology& rest) {
    std::ofstream(path) << text;
    return read_obj_frame(path, rest);
  };
  const std::string vertices = "v 0 0 0\nv 2 0 0\nv 0.5 0.5 0\nv 0 2 0\n";
  const std::string uv = "vt 0 0\nvt 2 0\nvt 0.5 0.5\nvt 0 2\n";
  // A quad that is concave in one corner: moved, its other diagonal would be the right cut.
  const Topology rest = read(vertices + uv + "f 1/1 2/2 3/3 4/4\n");
  const std::string moved = "v 0 0 1\nv 2 0 1\nv 3 3 1\nv 0.2 0.1 1\n";
  EXPECT_EQ(frame(moved + "f 1 2 3 4\n", rest)(2, 0), 3.0f);
  EXPECT_EQ(frame(moved + "vt 0 0\nf 1/1 2/1 3/1 4\n", rest)(3, 2), 1.0f);
  for (const std::string& other : {moved, moved + "f 1 2 3\n", moved + "f 1 2 4\nf 2 3 4\nf 1 3 4\n",
                                   vertices + "v 1 1 1\nf 1 2 3 4\n", moved + "f 3 2 1\nf 3 1 4\n"}) {
    EXPECT_THROW(frame(other, rest), Error) << other;
  }
}

TEST(Obj, IgnoresWordsThatSayNothingAboutTheShape) {
  const Topology t = read(
      "# comment\r\nmtllib a.mtl\no thing\n\n   \nv 0 0 0 1.0\nv +1 0 0\nv 0 1e0 0 # a corner\ns off\r\nvp 0 1\nvt "
      "0.5\n"
      "f 1/1 2/1 3/1 # a face\r\nl 1 2\ncurv2 1 2\nv 1e-60 0 0\n");
  EXPECT_EQ(t.vertex_count(), 4);
  EXPECT_EQ(t.rest_positions(1, 0), 1.0f);
  EXPECT_EQ(t.rest_positions(3, 0), 0.0f);
  EXPECT_EQ(t.uv(0, 1), 0.0f);
}

TEST(Obj, ADamagedStatementIsNotSkipped) {
  const std::string t = std::string(kTriangle) + "f 1 2 3\n";
  for (const char* line :
       {"\xC2\xA0v 0 0 0", "v0 0 0", "V 0 0 0", "f1 2 3", ",v 0 0 0", "1 2 3", "\x01v 1 2 3", "<html>"}) {
    expect_refused(t + line + "\n", "test.obj:5: expected a statement");
  }
  expect_refused("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n", "is a placeholder of Git LFS");
}

TEST(Obj, NamesTheLineOfAnError) {
  expect_refused("v 0 0 0\nv 1 x 0\n", "test.obj:2");
  expect_refused("v 0 0\n", "expected a number");
  expect_refused("v nan 0 0\n", "not finite");
  expect_refused("v inf 0 0\n", "not finite");
  expect_refused("v 1e99 0 0\n", "expected a number");
  const std::string t = kTriangle;
  expect_refused(t + "f 1 2\n", "2 different corners");
  expect_refused(t + "f\n", "0 different corners");
  expect_refused(t + "f 1 2 0\n", "index 0");
  expect_refused(t + "f 1 2 -4\n", "out of range");
  expect_refused(t + "f 1 2 a\n", "expected an index");
  expect_refused(t + "f 1 2 3x\n", "expected an index");
  expect_refused(t + "f 1 2 99999999999999999999\n", "expected an index");
  expect_refused(t + "f 1 2 4\n", "names index 3");
  expect_refused(t + "vt 0 0\nf 1/1 2/1 3/2\n", "names index 1");
  expect_refused(t + "vt 0 0\no body\nf 1/1 2/1 3/1\no prop\nf 1 2 3\n", "the first at line 8, object 'prop'");
  expect_refused(t + "f 1 1 2\n", "2 different corners");
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

TEST(Obj, WritesFilesOnly) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP();
  try {
    write_obj("/dev/full", read_obj(std::filesystem::path("deploy/garments/tablecloth.obj")));
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(e.what(), HasSubstr("/dev/full"));
  }
}

}  // namespace
}  // namespace pleat
