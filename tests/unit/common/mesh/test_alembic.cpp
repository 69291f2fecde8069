// Files are put together here from the format's description, with what exporters do and our own writer does not.
#include "common/mesh/alembic.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <fstream>

#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

template <class T>
std::string bytes_of(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}
template <class T>
std::string number(T value) {
  return bytes_of(std::vector<T>{value});
}

constexpr std::uint64_t kIsData = std::uint64_t{1} << 63;
constexpr double kOwnTimes = 5e306;  // "time per cycle" of samples that have their own times

/// Groups and blocks, one behind the other.
struct Container {
  std::string bytes = std::string("Ogawa\xff\0\1", 8) + std::string(8, '\0');
  std::uint64_t data(const std::string& content) {
    bytes += number(std::uint64_t{content.size()}) + content;
    return (bytes.size() - content.size() - 8) | kIsData;
  }
  std::uint64_t group(const std::vector<std::uint64_t>& children) {
    bytes += number(std::uint64_t{children.size()}) + bytes_of(children);
    return bytes.size() - 8 * children.size() - 8;
  }
  std::uint64_t sample(const std::string& values) { return data(std::string(16, 'k') + values); }
};

struct Property {
  std::string header;
  std::uint64_t group = 0;
};

class Alembic : public testing::Test {
 protected:
  enum { kUint8 = 1, kInt8 = 2, kInt32 = 6, kUint32 = 5, kFloat32 = 10, kFloat64 = 11 };

  static std::string named(const std::string& name, const std::string& metadata) {
    return number<std::uint8_t>(static_cast<std::uint8_t>(name.size())) + name +
           number<std::uint8_t>(static_cast<std::uint8_t>(metadata.size())) + metadata;
  }
  static constexpr std::uint32_t kOwnMetadata = 0xffu << 20;

  Property array(const std::string& name, std::uint32_t pod, std::uint32_t extent, const std::string& values,
                 const std::string& metadata = "") {
    const std::uint32_t info = 2 | pod << 4 | extent << 12 | 0x800 | kOwnMetadata;
    return {number(info) + '\1' + named(name, metadata), file_.group({file_.sample(values), file_.data("")})};
  }
  Property scalar(const std::string& name, std::uint32_t pod, std::uint32_t extent,
                  const std::vector<std::string>& samples) {
    std::vector<std::uint64_t> children;
    for (const std::string& values : samples) children.push_back(file_.sample(values));
    const std::uint32_t info = 1 | pod << 4 | extent << 12 | kOwnMetadata | (samples.size() > 1 ? 0x100 : 0x800);
    return {number(info) + static_cast<char>(samples.size()) + (samples.size() > 1 ? "\1" : "") + named(name, ""),
            file_.group(children)};
  }
  std::uint64_t group_of(const std::vector<Property>& properties) {
    std::vector<std::uint64_t> children;
    std::string headers;
    for (const Property& property : properties) {
      children.push_back(property.group);
      headers += property.header;
    }
    children.push_back(file_.data(headers));
    return file_.group(children);
  }
  Property compound(const std::string& name, const std::vector<Property>& properties,
                    const std::string& metadata = "") {
    return {number(kOwnMetadata) + named(name, metadata), group_of(properties)};
  }

  struct Object {
    std::string name, schema;
    std::uint64_t group = 0;
  };
  std::uint64_t object(const std::vector<Property>& properties, const std::vector<Object>& children) {
    std::vector<std::uint64_t> places{group_of(properties)};
    std::string headers;
    for (const Object& child : children) {
      const std::string metadata = "schema=" + child.schema + ";other=1";
      headers += number(static_cast<std::uint32_t>(child.name.size())) + child.name + '\xff' +
                 number(static_cast<std::uint32_t>(metadata.size())) + metadata;
      places.push_back(child.group);
    }
    places.push_back(file_.data(headers + std::string(32, 'h')));
    return file_.group(places);
  }

  /// A square and a triangle on top of it, clockwise, in frames at `times_`; frames 2 and 3 are equal and stored once.
  Object mesh(const std::string& uv_kind = "indexed", std::uint32_t bad_corner = 4) {
    std::vector<std::uint64_t> samples;
    for (int t = 0; t < 3; ++t) {
      samples.push_back(
          file_.sample(bytes_of(std::vector<double>{0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0.5, 2, -1.0 * t})));
      samples.push_back(file_.data(""));
    }
    const std::uint32_t info = 2 | kFloat64 << 4 | 3 << 12 | 0x100 | 0x200 | kOwnMetadata;
    const Property points{number(info) + "\4\1\2\1" + named("P", "geoScope=vtx"), file_.group(samples)};
    std::vector<Property> geometry{
        points, array(".faceCounts", kInt32, 1, bytes_of(std::vector<std::int32_t>{4, 3})),
        array(".faceIndices", kInt32, 1, bytes_of(std::vector<std::uint32_t>{3, 2, 1, 0, 3, bad_corner, 2}))};
    const std::vector<float> square = {0, 1, 1, 1, 1, 0, 0, 0}, all = {0, 1, 1, 1, 1, 0, 0, 0, 0, 1, 0.5F, 2, 1, 1};
    if (uv_kind == "indexed") {
      std::vector<float> values = square;
      values.insert(values.end(), {7, 7});
      geometry.push_back(
          compound("uv",
                   {array(".vals", kFloat32, 2, bytes_of(values)),
                    array(".indices", kUint32, 1, bytes_of(std::vector<std::uint32_t>{0, 1, 2, 3, 0, 4, 1}))},
                   "geoScope=fvr;isGeomParam=true"));
    } else if (uv_kind == "corners") {
      geometry.push_back(array("uv", kFloat32, 2, bytes_of(all), "geoScope=fvr"));
    } else if (uv_kind == "vertices") {
      geometry.push_back(
          array("uv", kFloat32, 2, bytes_of(std::vector<float>{0, 0, 1, 0, 1, 1, 0, 1, 7, 7}), "geoScope=vtx"));
    }
    return {"cloth", "AbcGeom_PolyMesh_v1", object({compound(".geom", geometry)}, {})};
  }

  Object xform(const std::string& name, const std::vector<std::uint8_t>& operations,
               const std::vector<std::vector<double>>& values, const std::vector<Object>& children,
               bool inherits = true) {
    std::vector<std::string> samples;
    for (const auto& row : values) samples.push_back(bytes_of(row));
    const auto count = static_cast<std::uint32_t>(operations.size());
    const Property properties =
        compound(".xform", {scalar(".inherits", 0, 1, {std::string(1, inherits ? '\1' : '\0')}),
                            scalar(".ops", kUint8, count, {bytes_of(operations)}),
                            scalar(".vals", kFloat64, static_cast<std::uint32_t>(values[0].size()), samples)});
    return {name, "AbcGeom_Xform_v3", object({properties}, children)};
  }

  std::string finish(const std::vector<Object>& objects) {
    const std::uint64_t top = object({}, objects);
    const std::string times = number(std::uint32_t{1}) + number(1.0) + number(std::uint32_t{1}) + number(0.0) +
                              number(std::uint32_t{4}) + number(kOwnTimes) +
                              number(static_cast<std::uint32_t>(times_.size())) + bytes_of(times_);
    const std::uint64_t parts[] = {file_.data(number(0)),  file_.data(number(10800)), top,
                                   file_.data("about=us"), file_.data(times),         file_.data("")};
    const std::uint64_t root = file_.group({std::begin(parts), std::end(parts)});
    std::memcpy(file_.bytes.data() + 8, &root, 8);
    return file_.bytes;
  }
  std::unique_ptr<AnimatedMesh> open(const std::string& bytes) const {
    std::ofstream(folder_.path() / "cloth.abc", std::ios::binary) << bytes;
    return open_alembic(folder_.path() / "cloth.abc");
  }
  void expect_refused(const std::string& bytes, ErrorCode code, const std::string& cause) const {
    const Error error = test::error_of([&] {
      const auto mesh = open(bytes);
      for (std::size_t k = 0; k < mesh->frame_count(); ++k) mesh->positions(k);
    });
    EXPECT_EQ(error.code(), code) << error.what();
    EXPECT_NE(std::string(error.what()).find(cause), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("cloth.abc: "), std::string::npos) << error.what();
  }

  const test::TemporaryFolder folder_;
  Container file_;
  std::vector<double> times_{1.0, 1.5, 2.0, 2.5};
};

TEST_F(Alembic, AMeshWithSamplesIsItsFrames) {
  const auto read = open(finish({mesh()}));
  ASSERT_EQ(read->frame_count(), 4u);
  EXPECT_DOUBLE_EQ(read->frame_time_s(), 0.5);
  for (int t = 0; t < 4; ++t)
    EXPECT_EQ(read->positions(static_cast<std::size_t>(t)).row(4), Eigen::RowVector3f(0.5F, 2, -std::min(t, 2) + 0.0F));
  const Topology topology = to_topology(read->mesh(), "cloth", MeshUse::kGarment);
  Faces faces(3, 3);
  faces << 0, 1, 2, 0, 2, 3, 2, 4, 3;
  EXPECT_EQ(topology.faces, faces) << "counter-clockwise";
  EXPECT_EQ(topology.uv.row(topology.uv_faces(0, 0)), Eigen::RowVector2f(0, 0));
  EXPECT_EQ(topology.uv.row(topology.uv_faces(2, 1)), Eigen::RowVector2f(7, 7));
  EXPECT_EQ(topology.uv.rows(), 5);
}

TEST_F(Alembic, MaterialCoordinatesOfEachCornerAreOneWhereTheyAreEqual) {
  const Topology corners = to_topology(open(finish({mesh("corners")}))->mesh(), "cloth", MeshUse::kGarment);
  EXPECT_EQ(corners.uv.rows(), 5);
  EXPECT_EQ(corners.uv_faces(1, 2), corners.uv_faces(2, 2)) << "the square and the triangle are one island";
}

TEST_F(Alembic, MaterialCoordinatesByVertexAreRead) {
  const Topology vertices = to_topology(open(finish({mesh("vertices")}))->mesh(), "cloth", MeshUse::kGarment);
  EXPECT_EQ(vertices.uv_faces, vertices.faces);
  EXPECT_EQ(to_topology(open(finish({mesh("none")}))->mesh(), "cloth", MeshUse::kGarment).uv.rows(), 0);
}

TEST_F(Alembic, WhatIsAboveAMeshPlacesAndMovesIt) {
  // A translation that moves, then a quarter about y, then a matrix that doubles.
  std::vector<double> twice = {2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1};
  std::vector<std::vector<double>> values;
  for (int t = 0; t < 4; ++t) {
    values.push_back({0, 0, 10.0 * t, 90});
    values.back().insert(values.back().end(), twice.begin(), twice.end());
  }
  const Object inner = xform("inner", {0x10, 0x50, 0x30}, values, {mesh()});
  const auto read = open(finish({xform("outer", {0x10}, {{100, 0, 0}}, {inner})}));
  // (0.5, 2, -2) doubled is (1, 4, -4), about y (-4, 4, -1).
  EXPECT_LT((read->positions(2).row(4) - Eigen::RowVector3f(96, 4, 19)).norm(), 1e-5F);
  EXPECT_LT((read->positions(3).row(4) - Eigen::RowVector3f(96, 4, 29)).norm(), 1e-5F);
}

TEST_F(Alembic, AnObjectMayStandForItself) {
  const Object own = xform("own", {0x00}, {{1, 1, -1}}, {mesh()}, false);
  const auto read = open(finish({xform("outer", {0x10}, {{100, 0, 0}}, {own})}));
  EXPECT_EQ(read->positions(2).row(4), Eigen::RowVector3f(0.5F, 2, 2));
  EXPECT_EQ(to_topology(read->mesh(), "cloth", MeshUse::kObstacle).faces.row(0),
            (Eigen::RowVector3<std::uint32_t>(3, 2, 1)))
      << "mirrored: turned over";
}

TEST_F(Alembic, HiddenObjectsAreLeftOut) {
  Object hidden = mesh();
  hidden.group = object({scalar("visible", kInt8, 1, {std::string(1, '\0')}), compound(".geom", {})}, {});
  EXPECT_EQ(open(finish({hidden, mesh()}))->positions(0).rows(), 5);
  EXPECT_EQ(open(finish({mesh(), mesh()}))->positions(0).rows(), 10);
}

TEST_F(Alembic, WhatItDoesNotReadIsNamed) {
  expect_refused("\x89HDF\r\n\x1a\n and more", ErrorCode::kInvalidArgument, "HDF5");
  expect_refused("v 0 0 0\n", ErrorCode::kInvalidArgument, "not an Alembic file");
  expect_refused("", ErrorCode::kInvalidArgument, "not an Alembic file");
  const std::string good = finish({mesh()});
  std::string open_ended = good;
  open_ended[5] = '\0';
  expect_refused(open_ended, ErrorCode::kDataLoss, "never finished");
  EXPECT_EQ(test::error_of([&] { open_alembic(folder_.path() / "none.abc"); }).code(), ErrorCode::kNotFound);
}

TEST_F(Alembic, AFaceThatNamesNoPointIsRefused) {
  expect_refused(finish({mesh("indexed", 5)}), ErrorCode::kInvalidArgument, "point 5 of 5");
}

TEST_F(Alembic, AnArchiveWithoutAMeshIsRefused) {
  expect_refused(finish({xform("empty", {0x10}, {{1, 2, 3}}, {})}), ErrorCode::kInvalidArgument, "no PolyMesh");
}

TEST_F(Alembic, UnevenTimesAreRefused) {
  times_ = {0, 1, 1.7, 3};
  expect_refused(finish({mesh()}), ErrorCode::kInvalidArgument, "evenly");
}

TEST_F(Alembic, TimesThatDoNotAscendAreRefused) {
  times_ = {0, 1, 1, 3};
  expect_refused(finish({mesh()}), ErrorCode::kInvalidArgument, "ascend");
}

TEST_F(Alembic, ObjectsInACircleAreRefused) {
  const Object inner = xform("inner", {0x10}, {{1, 2, 3}}, {mesh()});
  const Object outer = xform("outer", {0x10}, {{1, 2, 3}}, {inner});
  std::string bytes = finish({outer});
  // What is in the outer one becomes the outer one itself; its second child is behind the group's size and properties.
  std::memcpy(bytes.data() + outer.group + 16, &outer.group, 8);
  expect_refused(bytes, ErrorCode::kInvalidArgument, "no tree");
}

TEST_F(Alembic, NoDamageDoesMoreThanAnError) {
  const std::string good = finish({xform("outer", {0x10}, {{1, 2, 3}}, {mesh()})});
  const auto use = [&](const std::string& bytes) {
    try {
      const auto read = open(bytes);
      to_topology(read->mesh(), "cloth", MeshUse::kGarment);
      for (std::size_t k = 0; k < std::min<std::size_t>(read->frame_count(), 3); ++k) {
        const Positions positions = read->positions(k);
        EXPECT_TRUE(positions.allFinite());
        EXPECT_EQ(static_cast<std::size_t>(positions.rows()), read->mesh().positions.size() / 3);
      }
    } catch (const Error& error) {
      EXPECT_NE(error.code(), ErrorCode::kInternal) << error.what();
    }
  };
  for (std::size_t length = 0; length < good.size(); length += 3) use(good.substr(0, length));
  for (std::size_t i = 0; i < good.size(); ++i) {
    for (const char value : {'\xff', '\0', '\x7f'}) {
      std::string bytes = good;
      bytes[i] = value;
      use(bytes);
    }
  }
}

}  // namespace
}  // namespace pleat
