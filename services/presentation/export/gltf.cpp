// glTF 2.0, binary: the first frame, and a morph target for each later one, which an animation of the weights shows in
// turn. Between frames it interpolates linearly.
#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "services/presentation/export/own_export.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {
namespace {

using Json = nlohmann::ordered_json;

static_assert(std::endian::native == std::endian::little, "glTF is little-endian, and so is what is written here");

constexpr std::uint32_t kMagic = 0x46546C67, kVersion = 2, kJsonChunk = 0x4E4F534A, kBinaryChunk = 0x004E4942;
constexpr std::size_t kHeaderBytes = 12, kChunkHeaderBytes = 8;
constexpr int kFloat = 5126, kUnsignedInt = 5125;  // componentType
constexpr int kArrayBuffer = 34962, kElementArrayBuffer = 34963;

/// Corners of glTF have one index: a vertex on a seam of the material coordinates is there once for each of its places.
struct Corners {
  std::vector<std::uint32_t> vertex, uv, triangles;
};

Corners corners_of(const Topology& topology) {
  const bool with_uv = topology.uv_faces.rows() > 0;
  Corners corners;
  std::map<std::array<std::uint32_t, 2>, std::uint32_t> number;
  for (Eigen::Index i = 0; i < topology.faces.size(); ++i) {
    const std::uint32_t vertex = topology.faces.data()[i], uv = with_uv ? topology.uv_faces.data()[i] : 0;
    const auto [found, is_new] = number.try_emplace({vertex, uv}, static_cast<std::uint32_t>(corners.vertex.size()));
    if (is_new) {
      corners.vertex.push_back(vertex);
      corners.uv.push_back(uv);
    }
    corners.triangles.push_back(found->second);
  }
  return corners;
}

/// The arrays of the binary chunk, in the order in which they are written, and the JSON that describes them.
class Layout {
 public:
  /// Returns the number of the accessor. target: of a buffer view; 0: none.
  std::size_t add(const char* type, int component, std::size_t count, std::size_t components, int target) {
    const std::size_t bytes = 4 * count * components;
    Json view = {{"buffer", 0}, {"byteOffset", bytes_}, {"byteLength", bytes}};
    if (target != 0) view["target"] = target;
    views_.push_back(std::move(view));
    accessors_.push_back(
        {{"bufferView", views_.size() - 1}, {"componentType", component}, {"count", count}, {"type", type}});
    bytes_ += bytes;
    return accessors_.size() - 1;
  }
  void set_range(std::size_t accessor, const std::vector<double>& least, const std::vector<double>& most) {
    accessors_[accessor]["min"] = least;
    accessors_[accessor]["max"] = most;
  }
  std::size_t bytes() const { return bytes_; }
  const Json& views() const { return views_; }
  const Json& accessors() const { return accessors_; }

 private:
  Json views_ = Json::array(), accessors_ = Json::array();
  std::size_t bytes_ = 0;
};

/// Accessors by what they hold.
struct Accessors {
  std::size_t indices = 0, positions = 0, normals = 0, uv = 0, times = 0, weights = 0;
  std::vector<std::array<std::size_t, 2>> targets;  ///< positions and normals of each later frame, less the first's
};

Accessors lay_out(const Corners& corners, bool with_uv, std::size_t frames, Layout& layout) {
  const std::size_t points = corners.vertex.size();
  Accessors accessors;
  accessors.indices = layout.add("SCALAR", kUnsignedInt, corners.triangles.size(), 1, kElementArrayBuffer);
  if (with_uv) accessors.uv = layout.add("VEC2", kFloat, points, 2, kArrayBuffer);
  if (frames > 1) {
    accessors.times = layout.add("SCALAR", kFloat, frames, 1, 0);
    accessors.weights = layout.add("SCALAR", kFloat, frames * (frames - 1), 1, 0);
  }
  accessors.positions = layout.add("VEC3", kFloat, points, 3, kArrayBuffer);
  accessors.normals = layout.add("VEC3", kFloat, points, 3, kArrayBuffer);
  for (std::size_t t = 1; t < frames; ++t) {
    const std::size_t positions = layout.add("VEC3", kFloat, points, 3, kArrayBuffer);
    accessors.targets.push_back({positions, layout.add("VEC3", kFloat, points, 3, kArrayBuffer)});
  }
  return accessors;
}

Json describe(const std::string& name, const Accessors& accessors, const Layout& layout, bool with_uv) {
  Json attributes = {{"POSITION", accessors.positions}, {"NORMAL", accessors.normals}};
  if (with_uv) attributes["TEXCOORD_0"] = accessors.uv;
  Json primitive = {{"attributes", attributes}, {"indices", accessors.indices}, {"material", 0}};
  Json mesh = {{"name", name}};
  for (const auto& [positions, normals] : accessors.targets) {
    primitive["targets"].push_back({{"POSITION", positions}, {"NORMAL", normals}});
  }
  mesh["primitives"] = Json::array({primitive});
  if (!accessors.targets.empty()) mesh["weights"] = std::vector<int>(accessors.targets.size(), 0);
  Json gltf = {
      {"asset", {{"generator", kGltfGenerator}, {"version", "2.0"}}},
      {"scene", 0},
      {"scenes", Json::array({{{"nodes", {0}}}})},
      {"nodes", Json::array({{{"name", name}, {"mesh", 0}}})},
      {"materials", Json::array({{{"name", "cloth"},
                                  {"doubleSided", true},
                                  {"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 0.8}}}}})},
      {"meshes", Json::array({mesh})}};
  if (!accessors.targets.empty()) {
    const Json sampler = {{"input", accessors.times}, {"output", accessors.weights}, {"interpolation", "LINEAR"}};
    const Json channel = {{"sampler", 0}, {"target", {{"node", 0}, {"path", "weights"}}}};
    gltf["animations"] =
        Json::array({{{"name", "frames"}, {"samplers", Json::array({sampler})}, {"channels", Json::array({channel})}}});
  }
  gltf["accessors"] = layout.accessors();
  gltf["bufferViews"] = layout.views();
  gltf["buffers"] = Json::array({{{"byteLength", layout.bytes()}}});
  return gltf;
}

template <class T>
void write_values(WholeFile& file, const T* values, std::size_t count) {
  file.write({reinterpret_cast<const char*>(values), count * sizeof(T)});
}

void write_word(WholeFile& file, std::size_t value) {
  const auto word = static_cast<std::uint32_t>(value);
  write_values(file, &word, 1);
}

Positions at_corners(const Positions& values, const Corners& corners) {
  Positions out(static_cast<Eigen::Index>(corners.vertex.size()), 3);
  for (std::size_t i = 0; i < corners.vertex.size(); ++i)
    out.row(static_cast<Eigen::Index>(i)) = values.row(corners.vertex[i]);
  return out;
}

void set_range(Layout& layout, std::size_t accessor, const Positions& values) {
  std::vector<double> least, most;
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    least.push_back(static_cast<double>(values.col(axis).minCoeff()));
    most.push_back(static_cast<double>(values.col(axis).maxCoeff()));
  }
  layout.set_range(accessor, least, most);
}

void write_uv(WholeFile& file, const Topology& topology, const Corners& corners) {
  for (const std::uint32_t uv : corners.uv) {
    const std::array<float, 2> place = {topology.uv(uv, 0), 1 - topology.uv(uv, 1)};  // glTF's v goes down
    write_values(file, place.data(), 2);
  }
}

/// Times, and for each the weights of the later frames.
void write_animation(WholeFile& file, std::size_t frames, double frame_time_s) {
  std::vector<float> values(frames);
  for (std::size_t t = 0; t < frames; ++t) values[t] = static_cast<float>(static_cast<double>(t) * frame_time_s);
  write_values(file, values.data(), frames);
  for (std::size_t t = 0; t < frames; ++t) {
    values.assign(frames - 1, 0);
    if (t > 0) values[t - 1] = 1;
    write_values(file, values.data(), frames - 1);
  }
}

}  // namespace

void write_glb(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame) {
  const Topology& topology = input.topology;
  const bool with_uv = topology.uv_faces.rows() > 0;
  const std::size_t frames = input.frame_count;
  const Corners corners = corners_of(topology);
  Layout layout;
  const Accessors accessors = lay_out(corners, with_uv, frames, layout);
  if (frames > 1) {
    layout.set_range(accessors.times, {0},
                     {static_cast<double>(static_cast<float>(static_cast<double>(frames - 1) * input.frame_time_s))});
  }

  // The JSON goes first and names the range of every array: room is left for the longest numbers.
  Layout widest = layout;
  const std::vector<double> wide(3, -std::numeric_limits<double>::min());
  widest.set_range(accessors.positions, wide, wide);
  for (const auto& target : accessors.targets) widest.set_range(target[0], wide, wide);
  const std::size_t room = (describe(input.name, accessors, widest, with_uv).dump().size() + 3) / 4 * 4;
  const std::size_t whole = kHeaderBytes + 2 * kChunkHeaderBytes + room + layout.bytes();
  if (whole > std::numeric_limits<std::uint32_t>::max()) {
    throw_invalid_argument(path.string() + ": " + std::to_string(frames) + " frames need " +
                           std::to_string(whole >> 20) + " MiB, the format holds 4096; export fewer, or a point cache");
  }

  WholeFile file(path);
  for (const std::size_t word : {std::size_t{kMagic}, std::size_t{kVersion}, whole, room, std::size_t{kJsonChunk}}) {
    write_word(file, word);
  }
  file.write(std::string(room, ' '));
  write_word(file, layout.bytes());
  write_word(file, kBinaryChunk);
  write_values(file, corners.triangles.data(), corners.triangles.size());
  if (with_uv) write_uv(file, topology, corners);
  if (frames > 1) write_animation(file, frames, input.frame_time_s);
  Positions first_positions, first_normals;
  for (std::size_t t = 0; t < frames; ++t) {
    const Positions now = frame(t);
    Positions positions = at_corners(now, corners);
    Positions normals = at_corners(vertex_normals(now, topology.faces), corners);
    if (t == 0) {
      first_positions = positions;
      first_normals = normals;
    } else {
      positions -= first_positions;
      normals -= first_normals;
    }
    set_range(layout, t == 0 ? accessors.positions : accessors.targets[t - 1][0], positions);
    write_values(file, positions.data(), static_cast<std::size_t>(positions.size()));
    write_values(file, normals.data(), static_cast<std::size_t>(normals.size()));
  }
  const std::string json = describe(input.name, accessors, layout, with_uv).dump();
  if (json.size() > room) throw_internal("glTF: the description is longer than its room");
  std::fseek(file.stream(), static_cast<long>(kHeaderBytes + kChunkHeaderBytes), SEEK_SET);
  file.write(json);
  file.commit();
}

}  // namespace pleat::presentation
