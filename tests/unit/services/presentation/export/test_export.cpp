// Exports are read back with readers written here from the formats' descriptions.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <algorithm>
#include <cstring>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common/base/error.hpp"
#include "common/mesh/animated_mesh.hpp"
#include "common/mesh/mesh_file.hpp"
#include "common/mesh/obj.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/result.hpp"
#include "services/presentation/export/export.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

std::string read_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  EXPECT_TRUE(file) << path;
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

/// Reads numbers at a moving place.
class Bytes {
 public:
  Bytes(std::string bytes, bool big_endian) : bytes_(std::move(bytes)), big_endian_(big_endian) {}

  template <class T>
  T next() {
    EXPECT_LE(place_ + sizeof(T), bytes_.size());
    char raw[sizeof(T)];
    std::memcpy(raw, bytes_.data() + place_, sizeof(T));
    if (big_endian_) std::reverse(raw, raw + sizeof(T));
    place_ += sizeof(T);
    T value;
    std::memcpy(&value, raw, sizeof(T));
    return value;
  }
  std::string take(std::size_t count) {
    place_ += count;
    return bytes_.substr(place_ - count, count);
  }
  Positions positions(Eigen::Index vertices) {
    Positions out(vertices, 3);
    for (Eigen::Index i = 0; i < out.size(); ++i) out.data()[i] = next<float>();
    return out;
  }
  bool at_end() const { return place_ == bytes_.size(); }

 private:
  std::string bytes_;
  bool big_endian_;
  std::size_t place_ = 0;
};

/// A quadrilateral of two triangles with material coordinates, moving; coordinates without short decimal form.
Topology quad() {
  Topology topology;
  topology.rest_positions.resize(4, 3);
  topology.rest_positions << 0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1;
  topology.faces.resize(2, 3);
  topology.faces << 0, 1, 2, 0, 2, 3;
  topology.uv.resize(4, 2);
  topology.uv << 0, 0, 1, 0, 1, 1, 0, 1;
  topology.uv_faces = topology.faces;
  return topology;
}

Positions moved(const Topology& topology, std::size_t frame) {
  Positions positions = topology.rest_positions / 3.0f;
  positions.col(1).array() += 0.1f * static_cast<float>(frame);
  positions(2, 0) += 1e-7f;
  return positions;
}

class Export : public testing::Test {
 protected:
  void SetUp() override {
    input_.name = "sheet";
    input_.topology = quad();
    input_.frame_count = 3;
    input_.frame_time_s = 0.04;
    input_.frame = [this](std::size_t t) { return moved(input_.topology, t); };
    auto coarse = std::make_shared<ExportInput>(input_);
    coarse->name = "coarse";
    coarse->frame = [](std::size_t t) { return moved(quad(), t); };
    input_.coarse = std::move(coarse);
  }

  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path() / "out";
  ExportInput input_;
};

TEST_F(Export, ObjSequenceGivesTheSameFloats) {
  const auto files = export_frames(input_, ExportFormat::kObj, folder_);
  ASSERT_EQ(files.size(), 3u);
  EXPECT_EQ(files[1].filename(), "sheet.0001.obj");
  for (std::size_t t = 0; t < 3; ++t) {
    const Topology read = read_obj(files[t]);
    EXPECT_EQ(read.rest_positions, moved(input_.topology, t));
    EXPECT_EQ(read.faces, input_.topology.faces);
    EXPECT_EQ(read.uv, input_.topology.uv);
    EXPECT_EQ(read.uv_faces, input_.topology.uv_faces);
  }
}

TEST_F(Export, PlyHasTheHeaderAndEveryByte) {
  const auto files = export_frames(input_, ExportFormat::kPly, folder_);
  ASSERT_EQ(files.size(), 3u);
  const std::string content = read_file(files[2]);
  const std::string end = "end_header\n";
  const std::size_t body = content.find(end) + end.size();
  const std::string header = content.substr(0, body);
  EXPECT_THAT(header, testing::StartsWith("ply\nformat binary_little_endian 1.0\n"));
  EXPECT_THAT(header, testing::HasSubstr("element vertex 4\n"));
  EXPECT_THAT(header, testing::HasSubstr("element face 2\n"));
  EXPECT_EQ(content.size() - body, 4u * 6 * 4 + 2u * (1 + 3 * 4));
  Bytes bytes(content.substr(body), false);
  const Positions expected = moved(input_.topology, 2);
  const Positions normals = vertex_normals(expected, input_.topology.faces);
  for (Eigen::Index v = 0; v < 4; ++v) {
    const Positions row = bytes.positions(2);
    EXPECT_EQ(row.row(0), expected.row(v));
    EXPECT_EQ(row.row(1), normals.row(v));
  }
  for (Eigen::Index f = 0; f < 2; ++f) {
    EXPECT_EQ(bytes.next<std::uint8_t>(), 3);
    for (Eigen::Index k = 0; k < 3; ++k) EXPECT_EQ(bytes.next<std::uint32_t>(), input_.topology.faces(f, k));
  }
  EXPECT_TRUE(bytes.at_end());
}

TEST_F(Export, Pc2HoldsEveryFrame) {
  const auto files = export_frames(input_, ExportFormat::kPc2, folder_);
  ASSERT_EQ(files.size(), 2u);
  EXPECT_EQ(read_obj(files[0]).rest_positions, input_.topology.rest_positions);
  Bytes bytes(read_file(files[1]), false);
  EXPECT_EQ(bytes.take(12), std::string("POINTCACHE2\0", 12));
  EXPECT_EQ(bytes.next<std::int32_t>(), 1);
  EXPECT_EQ(bytes.next<std::int32_t>(), 4);
  EXPECT_EQ(bytes.next<float>(), 0);
  EXPECT_EQ(bytes.next<float>(), 1);
  EXPECT_EQ(bytes.next<std::int32_t>(), 3);
  for (std::size_t t = 0; t < 3; ++t) EXPECT_EQ(bytes.positions(4), moved(input_.topology, t));
  EXPECT_TRUE(bytes.at_end());
}

TEST_F(Export, MddIsBigEndianWithTimes) {
  const auto files = export_frames(input_, ExportFormat::kMdd, folder_);
  ASSERT_EQ(files.size(), 2u);
  Bytes bytes(read_file(files[1]), true);
  EXPECT_EQ(bytes.next<std::int32_t>(), 3);
  EXPECT_EQ(bytes.next<std::int32_t>(), 4);
  for (int t = 0; t < 3; ++t) EXPECT_FLOAT_EQ(bytes.next<float>(), 0.04f * static_cast<float>(t));
  for (std::size_t t = 0; t < 3; ++t) EXPECT_EQ(bytes.positions(4), moved(input_.topology, t));
  EXPECT_TRUE(bytes.at_end());
}

/// The numbers between `start` and the end of its line.
std::vector<float> numbers_after(const std::string& text, const std::string& start) {
  const std::size_t place = text.find(start);
  EXPECT_NE(place, std::string::npos) << start;
  std::string line = text.substr(place + start.size(), text.find('\n', place) - place - start.size());
  for (char& c : line) {
    if (std::strchr("[](),", c) != nullptr) c = ' ';
  }
  std::istringstream stream(line);
  std::vector<float> out;
  for (float value = 0; stream >> value;) out.push_back(value);
  return out;
}

TEST_F(Export, UsdaHasASamplePerFrame) {
  const auto files = export_frames(input_, ExportFormat::kUsda, folder_);
  ASSERT_EQ(files.size(), 1u);
  const std::string text = read_file(files[0]);
  EXPECT_THAT(text, testing::StartsWith("#usda 1.0\n"));
  for (const char* part : {"upAxis = \"Y\"", "metersPerUnit = 1\n", "timeCodesPerSecond = 25\n", "endTimeCode = 2\n",
                           "def Mesh \"sheet\"", "faceVertexCounts = [3, 3]", "faceVertexIndices = [0, 1, 2, 0, 2, 3]",
                           "primvars:st:indices = [0, 1, 2, 0, 2, 3]", "subdivisionScheme = \"none\""}) {
    EXPECT_THAT(text, testing::HasSubstr(part));
  }
  EXPECT_EQ(std::count(text.begin(), text.end(), '{'), std::count(text.begin(), text.end(), '}'));
  EXPECT_EQ(std::count(text.begin(), text.end(), '['), std::count(text.begin(), text.end(), ']'));
  const std::string points = text.substr(text.find("points.timeSamples"));
  for (std::size_t t = 0; t < 3; ++t) {
    const Positions expected = moved(input_.topology, t);
    EXPECT_THAT(numbers_after(points, std::to_string(t) + ": "),
                testing::ElementsAreArray(expected.data(), static_cast<std::size_t>(expected.size())));
  }
  const std::string extents = text.substr(text.find("extent.timeSamples"));
  const std::vector<float> extent = numbers_after(extents, "1: ");
  ASSERT_EQ(extent.size(), 6u);
  EXPECT_EQ(extent[1], moved(input_.topology, 1).col(1).minCoeff());
  EXPECT_EQ(extent[3], moved(input_.topology, 1).col(0).maxCoeff());
}

/// A GLB taken apart.
struct Glb {
  explicit Glb(const fs::path& path) {
    Bytes file(read_file(path), false);
    EXPECT_EQ(file.take(4), "glTF");
    EXPECT_EQ(file.next<std::uint32_t>(), 2u);
    EXPECT_EQ(file.next<std::uint32_t>(), fs::file_size(path));
    const auto length = file.next<std::uint32_t>();
    EXPECT_EQ(length % 4, 0u);
    EXPECT_EQ(file.take(4), "JSON");
    json = nlohmann::json::parse(file.take(length));
    const auto bytes = file.next<std::uint32_t>();
    EXPECT_EQ(bytes % 4, 0u);
    EXPECT_EQ(file.take(4), std::string("BIN\0", 4));
    binary = file.take(bytes);
    EXPECT_TRUE(file.at_end());
  }
  template <class T>
  std::vector<T> values(const nlohmann::json& accessor) const {
    const nlohmann::json& a = json.at("accessors").at(accessor.get<std::size_t>());
    const nlohmann::json& view = json.at("bufferViews").at(a.at("bufferView").get<std::size_t>());
    const std::size_t components = a.at("type") == "SCALAR" ? 1 : a.at("type") == "VEC2" ? 2 : 3;
    std::vector<T> out(components * a.at("count").get<std::size_t>());
    EXPECT_EQ(view.at("byteLength"), out.size() * sizeof(T));
    EXPECT_LE(view.at("byteOffset").get<std::size_t>() + out.size() * sizeof(T), binary.size());
    std::memcpy(out.data(), binary.data() + view.at("byteOffset").get<std::size_t>(), out.size() * sizeof(T));
    if constexpr (std::is_same_v<T, float>) {
      for (std::size_t c = 0; a.contains("min") && c < components; ++c) {
        float least = out[c], most = out[c];
        for (std::size_t i = c; i < out.size(); i += components) {
          least = std::min(least, out[i]);
          most = std::max(most, out[i]);
        }
        EXPECT_EQ(a.at("min").at(c).get<float>(), least);
        EXPECT_EQ(a.at("max").at(c).get<float>(), most);
      }
    }
    return out;
  }
  nlohmann::json json;
  std::string binary;
};

TEST_F(Export, GltfShowsEveryFrameAndSplitsSeams) {
  // The second triangle's corner at vertex 2 lies elsewhere in material coordinates: a seam in one vertex.
  input_.topology.uv.conservativeResize(5, 2);
  input_.topology.uv.row(4) << 3, 0.25f;
  input_.topology.uv_faces(1, 1) = 4;
  const auto files = export_frames(input_, ExportFormat::kGlb, folder_);
  ASSERT_THAT(files, testing::ElementsAre(folder_ / "sheet.glb"));
  const Glb glb(files[0]);
  const nlohmann::json& primitive = glb.json.at("meshes").at(0).at("primitives").at(0);
  const auto indices = glb.values<std::uint32_t>(primitive.at("indices"));
  const auto first = glb.values<float>(primitive.at("attributes").at("POSITION"));
  const auto uv = glb.values<float>(primitive.at("attributes").at("TEXCOORD_0"));
  const auto& animation = glb.json.at("animations").at(0);
  EXPECT_EQ(animation.at("channels").at(0).at("target").at("path"), "weights");
  const auto times = glb.values<float>(animation.at("samplers").at(0).at("input"));
  const auto weights = glb.values<float>(animation.at("samplers").at(0).at("output"));
  ASSERT_EQ(indices.size(), 6u);
  ASSERT_EQ(first.size(), 15u);
  ASSERT_EQ(times.size(), input_.frame_count);
  ASSERT_EQ(primitive.at("targets").size(), input_.frame_count - 1);
  for (std::size_t t = 0; t < input_.frame_count; ++t) {
    EXPECT_NEAR(times[t], static_cast<double>(t) * input_.frame_time_s, 1e-6);
    std::vector<float> shown = first;
    for (std::size_t target = 0; target + 1 < input_.frame_count; ++target) {
      const auto moved = glb.values<float>(primitive.at("targets").at(target).at("POSITION"));
      const float weight = weights[t * (input_.frame_count - 1) + target];
      for (std::size_t i = 0; i < shown.size(); ++i) shown[i] += weight * moved[i];
    }
    const Positions expected = input_.frame(t);
    for (std::size_t corner = 0; corner < 6; ++corner) {
      const auto vertex = input_.topology.faces.data()[corner];
      for (std::size_t axis = 0; axis < 3; ++axis) {
        EXPECT_NEAR(shown[3 * indices[corner] + axis], expected(vertex, static_cast<Eigen::Index>(axis)), 1e-6);
      }
    }
  }
  for (std::size_t corner = 0; corner < 6; ++corner) {
    const auto place = input_.topology.uv_faces.data()[corner];
    EXPECT_EQ(uv[2 * indices[corner]], input_.topology.uv(place, 0));
    EXPECT_EQ(uv[2 * indices[corner] + 1], 1 - input_.topology.uv(place, 1));
  }
}

TEST_F(Export, GltfOfOneFrameStandsStill) {
  input_.frame_count = 1;
  input_.topology.uv.resize(0, 2);
  input_.topology.uv_faces.resize(0, 3);
  const Glb glb(export_frames(input_, ExportFormat::kGlb, folder_).at(0));
  EXPECT_FALSE(glb.json.contains("animations"));
  EXPECT_FALSE(glb.json.at("meshes").at(0).at("primitives").at(0).at("attributes").contains("TEXCOORD_0"));
}

TEST_F(Export, UsdzIsAStoredZipWithItsContentAtAMultipleOf64) {
  const std::string stage = read_file(export_frames(input_, ExportFormat::kUsda, folder_).at(0));
  const auto files = export_frames(input_, ExportFormat::kUsdz, folder_);
  ASSERT_THAT(files, testing::ElementsAre(folder_ / "sheet.usdz"));
  Bytes zip(read_file(files[0]), false);
  EXPECT_EQ(zip.take(4), "PK\3\4");
  zip.take(4);
  EXPECT_EQ(zip.next<std::uint16_t>(), 0) << "stored";
  zip.take(4);
  const auto sum = zip.next<std::uint32_t>();
  EXPECT_EQ(sum, crc32_z(0, reinterpret_cast<const Bytef*>(stage.data()), stage.size()));
  EXPECT_EQ(zip.next<std::uint32_t>(), stage.size());
  EXPECT_EQ(zip.next<std::uint32_t>(), stage.size());
  const auto name = zip.next<std::uint16_t>(), extra = zip.next<std::uint16_t>();
  EXPECT_EQ(zip.take(name), "cloth.usda");
  zip.take(extra);
  EXPECT_EQ((30u + name + extra) % 64, 0u);
  EXPECT_EQ(zip.take(stage.size()), stage);
  EXPECT_EQ(zip.take(4), "PK\1\2");
  zip.take(6);
  zip.take(6);
  EXPECT_EQ(zip.next<std::uint32_t>(), sum);
  zip.take(26);
  EXPECT_EQ(zip.take(name), "cloth.usda");
  EXPECT_EQ(zip.take(4), "PK\5\6");
  zip.take(12);
  EXPECT_EQ(zip.next<std::uint32_t>(), 30u + name + extra + stage.size()) << "where the directory begins";
  EXPECT_EQ(zip.next<std::uint16_t>(), 0);
  EXPECT_TRUE(zip.at_end());
}

TEST_F(Export, AnotherUnitAxisRangeAndRateAreThoseOfTheFiles) {
  const ExportInput cm = changed(input_, {.metres_per_unit = 0.01, .z_up = true, .start = 1, .end = 3, .fps = 50});
  ASSERT_EQ(cm.frame_count, 3u) << "0.04 s at 50 a second";
  EXPECT_DOUBLE_EQ(cm.frame_time_s, 0.02);
  const Positions first = moved(quad(), 1), last = moved(quad(), 2), middle = cm.frame(1);
  for (Eigen::Index v = 0; v < 4; ++v) {
    const Eigen::RowVector3f between = 50 * (first.row(v) + last.row(v));
    EXPECT_LT((middle.row(v) - Eigen::RowVector3f(between.x(), -between.z(), between.y())).norm(), 1e-4F);
    EXPECT_EQ(cm.frame(2).row(v), 100.0F * Eigen::RowVector3f(last(v, 0), -last(v, 2), last(v, 1)));
    EXPECT_EQ(cm.topology.rest_positions(v, 2), 100 * quad().rest_positions(v, 1));
  }
  EXPECT_EQ(cm.coarse->frame_count, 3u);
  const std::string text = read_file(export_frames(cm, ExportFormat::kUsda, folder_).at(0));
  EXPECT_THAT(text, testing::HasSubstr("metersPerUnit = 0.01\n"));
  EXPECT_THAT(text, testing::HasSubstr("upAxis = \"Z\"\n"));
  EXPECT_THAT(text, testing::HasSubstr("timeCodesPerSecond = 50\n"));
  EXPECT_THAT(read_file(export_frames(cm, ExportFormat::kObj, folder_).at(0)),
              testing::HasSubstr("0.01 m, and Z is up"));
  EXPECT_THROW(export_frames(cm, ExportFormat::kGlb, folder_), Error);
  EXPECT_THROW(changed(input_, {.start = 3}), Error);
  EXPECT_THROW(changed(input_, {.start = 2, .end = 2}), Error);
  EXPECT_EQ(changed(input_, {.fps = 24}).frame_count, 2u) << "0.08 s hold 1.92 frames";
}

TEST_F(Export, OurGltfUsdAndAlembicAreReadAsTheFramesThatTheyAre) {
  // A seam, and vertices in another order than the corners' first appearance.
  input_.topology.uv.conservativeResize(5, 2);
  input_.topology.uv.row(4) << 3, 0.25f;
  input_.topology.uv_faces(1, 1) = 4;
  input_.topology.faces << 1, 2, 0, 0, 2, 3;
  for (const auto format : {ExportFormat::kGlb, ExportFormat::kUsda, ExportFormat::kAbc}) {
    const fs::path file = export_frames(input_, format, folder_).at(0);
    const MatchedFrames frames(file, input_.topology);
    ASSERT_EQ(frames.frame_count(), 3u);
    EXPECT_NEAR(frames.frame_time_s(), 0.04, 1e-6);
    for (std::size_t t = 0; t < 3; ++t) EXPECT_LT((frames.positions(t) - input_.frame(t)).cwiseAbs().maxCoeff(), 1e-6F);
    const Topology read = read_mesh(file, MeshUse::kGarment);
    EXPECT_EQ(read.uv.row(read.uv_faces(1, 1)), input_.topology.uv.row(4));
  }
}

TEST_F(Export, BadInputIsNamedAndLeavesNoFile) {
  EXPECT_THROW(
      {
        try {
          parse_export_format("fbx");
        } catch (const Error& error) {
          EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
          EXPECT_THAT(error.what(), testing::AllOf(testing::HasSubstr("fbx"), testing::HasSubstr("usda")));
          throw;
        }
      },
      Error);
  input_.frame = [this](std::size_t t) {
    Positions positions = moved(input_.topology, t);
    if (t == 1) positions(0, 0) = std::numeric_limits<float>::quiet_NaN();
    return positions;
  };
  EXPECT_THROW(export_frames(input_, ExportFormat::kPc2, folder_), Error);
  EXPECT_FALSE(fs::exists(folder_ / "sheet.pc2"));
  EXPECT_TRUE(fs::is_empty(folder_));
  input_.frame_count = 0;
  EXPECT_THROW(export_frames(input_, ExportFormat::kUsda, folder_), Error);
}

TEST_F(Export, ReplacesEarlierExportsAndNothingElse) {
  for (const auto format :
       {ExportFormat::kObj, ExportFormat::kPly, ExportFormat::kPc2, ExportFormat::kMdd, ExportFormat::kUsda,
        ExportFormat::kUsdz, ExportFormat::kGlb, ExportFormat::kAbc, ExportFormat::kMaps}) {
    const auto files = export_frames(input_, format, folder_);
    EXPECT_NO_THROW(export_frames(input_, format, folder_)) << static_cast<int>(format);
    for (const fs::path& file : files) {
      const std::string ours = read_file(file);
      fs::remove(file);
      std::ofstream(file) << "mine";
      try {
        export_frames(input_, format, folder_);
        ADD_FAILURE() << file;
      } catch (const Error& error) {
        EXPECT_EQ(error.code(), ErrorCode::kAlreadyExists);
        EXPECT_THAT(error.what(), testing::StartsWith(file.string() + ": "));
      }
      EXPECT_EQ(read_file(file), "mine");
      fs::remove(file);
      std::ofstream(file, std::ios::binary) << ours;
    }
    // A cache that was changed since is somebody's work.
    if (files.back().extension() == ".pc2") {
      std::ofstream(files.back(), std::ios::app | std::ios::binary) << "x";
      EXPECT_THROW(export_frames(input_, format, folder_), Error);
      EXPECT_NO_THROW(export_frames(input_, format, folder_, {}, {.overwrite = true}));
    }
  }
  // Both caches' OBJ is one file.
  EXPECT_NO_THROW(export_frames(input_, ExportFormat::kPc2, folder_));
}

TEST_F(Export, ReadsAResultFile) {
  const Subdivision subdivision = subdivide(quad());
  ResultOptions options;
  options.topology = {quad(), subdivision.fine, subdivision.feature_vertices};
  options.frames = 2;
  options.frame_time_s = 0.04;
  fs::create_directories(folder_);
  ResultWriter writer(folder_ / "result.h5", options);
  for (std::size_t t = 0; t < 2; ++t) {
    ResultFrame frame;
    frame.coarse = moved(quad(), t);
    frame.enhanced = moved(subdivision.fine, t);
    writer.append(frame);
  }
  writer.finish();
  const ExportInput enhanced = read_export_input(folder_ / "result.h5");
  EXPECT_EQ(enhanced.frame_count, 2u);
  EXPECT_EQ(enhanced.frame(1), moved(subdivision.fine, 1));
  EXPECT_EQ(read_export_input(folder_ / "result.h5", "coarse").frame(1), moved(quad(), 1));
  EXPECT_THROW(read_export_input(folder_ / "result.h5", "fine"), Error);
  EXPECT_THROW(read_export_input(folder_ / "result.h5", "shoes"), Error);
  std::size_t done = 0;
  const auto files = export_frames(enhanced, ExportFormat::kPc2, folder_, [&](std::size_t frames) { done = frames; });
  EXPECT_EQ(done, 2u);
  EXPECT_EQ(fs::file_size(files[1]), 32u + 2u * static_cast<std::size_t>(subdivision.fine.vertex_count()) * 12u);
}

}  // namespace
}  // namespace pleat::presentation
