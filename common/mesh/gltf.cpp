#include "common/mesh/gltf.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/base/json.hpp"
#include "common/base/limits.hpp"
#include "common/base/text_file.hpp"
#include "common/mesh/mesh_file.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

static_assert(std::endian::native == std::endian::little, "glTF is little-endian, and is read as it is");

constexpr std::size_t kMaxCorners = 3 * kMaxFaces, kMaxTargets = 1'000'000;
constexpr std::uintmax_t kMaxBytes = std::uintmax_t{4} << 30;
constexpr std::uint32_t kMagic = 0x46546C67, kJsonChunk = 0x4E4F534A, kBinaryChunk = 0x004E4942;
constexpr int kMaxDepth = 64;

std::string read_bytes(const fs::path& path) {
  std::error_code failed;
  const auto size = fs::file_size(path, failed);
  if (failed || fs::is_directory(path)) throw_not_found(path.string() + ": can't be read");
  if (size > kMaxBytes) throw Error(ErrorCode::kResourceExhausted, path.string() + ": larger than 4 GiB");
  std::string bytes(size, '\0');
  std::ifstream stream(path, std::ios::binary);
  if (!stream.read(bytes.data(), static_cast<std::streamsize>(size)))
    throw_not_found(path.string() + ": can't be read");
  return bytes;
}

std::optional<std::string> from_base64(std::string_view text) {
  std::array<int, 256> value{};
  value.fill(-1);
  constexpr std::string_view kLetters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  for (std::size_t i = 0; i < kLetters.size(); ++i)
    value[static_cast<unsigned char>(kLetters[i])] = static_cast<int>(i);
  std::string bytes;
  bytes.reserve(text.size() / 4 * 3);
  std::uint32_t bits = 0;
  int count = 0;
  for (const char c : text) {
    if (c == '=') break;
    const int v = value[static_cast<unsigned char>(c)];
    if (v < 0) return std::nullopt;
    bits = (bits << 6) | static_cast<std::uint32_t>(v);
    count += 6;
    if (count < 8) continue;
    count -= 8;
    bytes += static_cast<char>((bits >> count) & 0xffu);
  }
  return bytes;
}

/// The document with its buffers.
class Document {
 public:
  explicit Document(const fs::path& path) : name_(path.string()) {
    refuse_placeholder(path);
    std::string bytes = read_bytes(path);
    if (lower_extension(path) == ".glb") {
      read_chunks(bytes);
    } else {
      check_text(std::string_view(bytes).substr(0, 64), name_);
      json_ = parse_json(bytes, name_);
    }
    if (!json_.is_object() || !json_.contains("asset")) fail("not a glTF document");
    if (const std::string version = text(json_["asset"], "version"); !version.starts_with("2"))
      fail("glTF version '" + version + "', not 2");
    for (const Json& extension : array(json_, "extensionsRequired")) {
      const std::string wanted = extension.is_string() ? extension.get<std::string>() : "?";
      if (wanted != "KHR_mesh_quantization" && wanted != "KHR_texture_transform" &&
          !wanted.starts_with("KHR_materials")) {
        fail("needs the extension " + wanted + ", which is not read; export without compression");
      }
    }
    read_buffers(path.parent_path());
  }

  [[noreturn]] void fail(const std::string& message) const { throw_invalid_argument(name_ + ": " + message); }
  const std::string& name() const { return name_; }
  const Json& json() const { return json_; }

  /// The array of that key; an empty one if there is none.
  const Json& array(const Json& object, const char* key) const {
    static const Json kEmpty = Json::array();
    const auto found = object.is_object() ? object.find(key) : object.end();
    if (!object.is_object() || found == object.end()) return kEmpty;
    if (!found->is_array()) fail(std::string(key) + " is no array");
    return *found;
  }
  std::string text(const Json& object, const char* key) const {
    const auto found = object.is_object() ? object.find(key) : object.end();
    if (!object.is_object() || found == object.end() || !found->is_string()) return {};
    return found->get<std::string>();
  }
  std::optional<std::size_t> index(const Json& object, const char* key) const {
    const auto found = object.is_object() ? object.find(key) : object.end();
    if (!object.is_object() || found == object.end()) return std::nullopt;
    if (!found->is_number_unsigned()) fail(std::string(key) + " is no number of 0 or more");
    return found->get<std::size_t>();
  }
  std::size_t required(const Json& object, const char* key) const {
    const auto value = index(object, key);
    if (!value) fail(std::string(key) + " is missing");
    return *value;
  }
  const Json& element(const char* key, std::size_t i) const {
    const Json& all = array(json_, key);
    if (i >= all.size()) fail(std::string(key) + " has no " + std::to_string(i));
    return all[i];
  }

  std::size_t accessor_count(std::size_t accessor) const { return required(element("accessors", accessor), "count"); }

  /// (count x columns) values of an accessor, row by row; normalized integers as their fractions.
  std::vector<float> floats(std::size_t accessor, std::size_t columns, std::size_t most) const {
    const Json& a = element("accessors", accessor);
    const std::size_t count = checked_count(a, columns, most);
    std::vector<float> values(count * columns, 0);
    const int type = static_cast<int>(required(a, "componentType"));
    const bool normalized = a.value("normalized", false);
    if (const auto view = index(a, "bufferView")) {
      read(*view, offset(a), count, columns, type, [&](std::size_t i, double value) {
        values[i] = static_cast<float>(normalized ? fraction(value, type) : value);
      });
    }
    if (const auto sparse = a.find("sparse"); sparse != a.end()) {
      const std::size_t changed = checked_count(*sparse, 0, count);
      const std::vector<std::uint32_t> places = sparse_places(*sparse, changed, count);
      const Json& stored = sparse->at("values");
      read(required(stored, "bufferView"), offset(stored), changed, columns, type, [&](std::size_t i, double value) {
        values[places[i / columns] * columns + i % columns] =
            static_cast<float>(normalized ? fraction(value, type) : value);
      });
    }
    for (const float value : values) {
      if (!std::isfinite(value)) fail("accessor " + std::to_string(accessor) + " has a value that is not finite");
    }
    return values;
  }

  std::vector<std::uint32_t> indices(std::size_t accessor, std::size_t most) const {
    const Json& a = element("accessors", accessor);
    const std::size_t count = checked_count(a, 1, most);
    std::vector<std::uint32_t> values(count, 0);
    if (a.contains("sparse")) fail("sparse indices are not read");
    read(required(a, "bufferView"), offset(a), count, 1, static_cast<int>(required(a, "componentType")),
         [&](std::size_t i, double value) { values[i] = static_cast<std::uint32_t>(value); });
    return values;
  }

 private:
  void read_chunks(const std::string& bytes) {
    const auto word = [&](std::size_t at) {
      std::uint32_t value = 0;
      if (at + 4 > bytes.size()) throw_data_loss(name_ + ": truncated");
      std::memcpy(&value, bytes.data() + at, 4);
      return value;
    };
    if (bytes.size() < 12 || word(0) != kMagic) fail("not a binary glTF file");
    if (word(4) != 2) fail("binary glTF version " + std::to_string(word(4)) + ", not 2");
    if (word(8) > bytes.size())
      throw_data_loss(name_ + ": truncated, " + std::to_string(bytes.size()) + " bytes instead of " +
                      std::to_string(word(8)));
    for (std::size_t at = 12; at + 8 <= word(8);) {
      const std::size_t length = word(at);
      const std::uint32_t kind = word(at + 4);
      if (length > bytes.size() - at - 8) throw_data_loss(name_ + ": truncated in a chunk");
      const std::string_view content = std::string_view(bytes).substr(at + 8, length);
      if (kind == kJsonChunk && json_.is_null()) json_ = parse_json(content, name_);
      if (kind == kBinaryChunk && !binary_) binary_ = std::string(content);
      at += 8 + length;
    }
  }

  void read_buffers(const fs::path& folder) {
    std::uintmax_t all = 0;
    for (const Json& buffer : array(json_, "buffers")) {
      const std::size_t bytes = required(buffer, "byteLength");
      const std::string uri = text(buffer, "uri");
      if (uri.empty()) {
        if (buffers_.empty() && binary_) {
          buffers_.push_back(std::move(*binary_));
        } else {
          fail("a buffer without content");
        }
      } else if (uri.starts_with("data:")) {
        const auto comma = uri.find(',');
        const auto content =
            comma == std::string::npos ? std::nullopt : from_base64(std::string_view(uri).substr(comma + 1));
        if (!content) fail("a buffer whose data are not in base64");
        buffers_.push_back(*content);
      } else {
        const fs::path file = uri;
        if (file.is_absolute() || std::find(file.begin(), file.end(), "..") != file.end() ||
            uri.find(':') != std::string::npos) {
          fail("the buffer '" + uri.substr(0, 80) + "' is not beside the file");
        }
        buffers_.push_back(read_bytes(folder / file));
      }
      all += buffers_.back().size();
      if (all > kMaxBytes) throw Error(ErrorCode::kResourceExhausted, name_ + ": buffers of more than 4 GiB");
      if (buffers_.back().size() < bytes)
        throw_data_loss(name_ + ": a buffer has " + std::to_string(buffers_.back().size()) + " bytes instead of " +
                        std::to_string(bytes));
    }
  }

  std::size_t offset(const Json& object) const { return index(object, "byteOffset").value_or(0); }

  /// columns 0: of any shape.
  std::size_t checked_count(const Json& object, std::size_t columns, std::size_t most) const {
    const std::size_t count = required(object, "count");
    if (count > most)
      throw Error(ErrorCode::kResourceExhausted, name_ + ": an array of " + std::to_string(count) + " values");
    if (columns == 0) return count;
    static const std::map<std::string, std::size_t> kColumns = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}};
    const auto known = kColumns.find(text(object, "type"));
    if (known == kColumns.end() || known->second != columns)
      fail("an array of type '" + text(object, "type") + "' where " + std::to_string(columns) + " columns are due");
    return count;
  }

  static double fraction(double value, int type) {
    switch (type) {
      case 5120:
        return std::max(value / 127, -1.0);
      case 5121:
        return value / 255;
      case 5122:
        return std::max(value / 32767, -1.0);
      case 5123:
        return value / 65535;
      default:
        return value;
    }
  }

  std::vector<std::uint32_t> sparse_places(const Json& sparse, std::size_t changed, std::size_t count) const {
    std::vector<std::uint32_t> places(changed, 0);
    if (!sparse.contains("indices") || !sparse.contains("values")) fail("a sparse accessor without indices or values");
    const Json& stored = sparse["indices"];
    read(required(stored, "bufferView"), offset(stored), changed, 1,
         static_cast<int>(required(stored, "componentType")),
         [&](std::size_t i, double value) { places[i] = static_cast<std::uint32_t>(value); });
    for (const std::uint32_t place : places) {
      if (place >= count)
        fail("a sparse accessor names element " + std::to_string(place) + " of " + std::to_string(count));
    }
    return places;
  }

  /// Hands (i, value) of every component on.
  template <class Take>
  void read(std::size_t view_index, std::size_t begin, std::size_t rows, std::size_t columns, int type,
            const Take& take) const {
    const Json& view = element("bufferViews", view_index);
    const std::size_t buffer = required(view, "buffer");
    if (buffer >= buffers_.size()) fail("buffers has no " + std::to_string(buffer));
    const std::string& bytes = buffers_[buffer];
    static const std::map<int, std::size_t> kWidths = {{5120, 1}, {5121, 1}, {5122, 2},
                                                       {5123, 2}, {5125, 4}, {5126, 4}};
    const auto width = kWidths.find(type);
    if (width == kWidths.end()) fail("componentType " + std::to_string(type));
    const std::size_t row_bytes = columns * width->second;
    const std::size_t stride = index(view, "byteStride").value_or(row_bytes);
    const std::size_t view_begin = offset(view), view_bytes = required(view, "byteLength");
    if (view_begin > bytes.size() || view_bytes > bytes.size() - view_begin)
      throw_data_loss(name_ + ": bufferViews[" + std::to_string(view_index) + "] reaches beyond its buffer");
    if (stride < row_bytes || stride > 4096) fail("byteStride " + std::to_string(stride));
    if (rows == 0) return;
    if (begin > view_bytes || (rows - 1) * stride + row_bytes > view_bytes - begin)
      throw_data_loss(name_ + ": an array reaches beyond bufferViews[" + std::to_string(view_index) + "]");
    const char* data = bytes.data() + view_begin + begin;
    const auto as = [](const char* from, auto value) {
      std::memcpy(&value, from, sizeof value);
      return static_cast<double>(value);
    };
    for (std::size_t r = 0; r < rows; ++r) {
      for (std::size_t c = 0; c < columns; ++c) {
        const char* from = data + r * stride + c * width->second;
        double value = 0;
        switch (type) {
          case 5120:
            value = as(from, std::int8_t{});
            break;
          case 5121:
            value = as(from, std::uint8_t{});
            break;
          case 5122:
            value = as(from, std::int16_t{});
            break;
          case 5123:
            value = as(from, std::uint16_t{});
            break;
          case 5125:
            value = as(from, std::uint32_t{});
            break;
          default:
            value = as(from, float{});
        }
        take(r * columns + c, value);
      }
    }
  }

  std::string name_;
  Json json_;
  std::optional<std::string> binary_;
  std::vector<std::string> buffers_;
};

/// A node's place in its parent.
Eigen::Affine3d local_transform(const Document& document, const Json& node) {
  const auto numbers = [&](const char* key, std::vector<double> values) {
    const Json& given = document.array(node, key);
    if (given.empty()) return values;
    if (given.size() != values.size())
      document.fail(std::string(key) + " of a node has " + std::to_string(given.size()) + " values");
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (!given[i].is_number()) document.fail(std::string(key) + " of a node is not of numbers");
      values[i] = given[i].get<double>();
      if (!std::isfinite(values[i])) document.fail(std::string(key) + " of a node is not finite");
    }
    return values;
  };
  if (node.contains("matrix")) {
    const std::vector<double> matrix = numbers("matrix", std::vector<double>(16, 0));
    Eigen::Affine3d transform;
    transform.matrix() = Eigen::Map<const Eigen::Matrix4d>(matrix.data());  // column by column, as Eigen has it
    return transform;
  }
  const auto t = numbers("translation", {0, 0, 0}), r = numbers("rotation", {0, 0, 0, 1}),
             s = numbers("scale", {1, 1, 1});
  Eigen::Quaterniond rotation(r[3], r[0], r[1], r[2]);
  if (!(rotation.norm() > 0)) document.fail("rotation of a node has no length");
  return Eigen::Translation3d(t[0], t[1], t[2]) * rotation.normalized() * Eigen::Scaling(s[0], s[1], s[2]);
}

/// Weights of one node's targets over time.
struct Weights {
  std::vector<float> times, values;  ///< (times x targets)
  bool steps = false;
};

struct Primitive {
  std::size_t node = 0;
  std::vector<float> base;           ///< (points x 3)
  std::vector<std::size_t> targets;  ///< accessors; kNone where a target leaves the positions
  std::vector<double> weights;       ///< without an animation
  Eigen::Affine3d place;             ///< to the scene
};

constexpr std::size_t kNoAccessor = std::numeric_limits<std::size_t>::max();

class GltfMesh final : public AnimatedMesh {
 public:
  explicit GltfMesh(const fs::path& path) : document_(path) {
    read_animations();
    const Json& scenes = document_.array(document_.json(), "scenes");
    std::vector<std::size_t> roots;
    if (!scenes.empty()) {
      const Json& scene = document_.element("scenes", document_.index(document_.json(), "scene").value_or(0));
      for (const Json& root : document_.array(scene, "nodes")) {
        if (!root.is_number_unsigned()) document_.fail("a scene's nodes are not numbers");
        roots.push_back(root.get<std::size_t>());
      }
    }
    visited_.assign(document_.array(document_.json(), "nodes").size(), 0);
    if (roots.empty()) document_.fail("a scene without nodes");
    for (const std::size_t root : roots) visit(root, Eigen::Affine3d::Identity(), 0);
    if (primitives_.empty()) document_.fail("no mesh of triangles in its scene");
    std::vector<double> keys;
    for (const auto& [node, weights] : weights_) {
      if (used_[node]) keys.insert(keys.end(), weights.times.begin(), weights.times.end());
    }
    times_ = detail::even_times(std::move(keys), document_.name());
    weld();
    const Positions first = positions(0);
    mesh_.positions.assign(first.data(), first.data() + first.size());
  }

  const PolygonMesh& mesh() const override { return mesh_; }
  std::size_t frame_count() const override { return times_.count; }
  double frame_time_s() const override { return times_.step; }

  Positions positions(std::size_t frame) const override {
    if (frame >= times_.count) {
      throw_invalid_argument(document_.name() + ": no frame " + std::to_string(frame) + " of " +
                             std::to_string(times_.count));
    }
    const double time = times_.first + static_cast<double>(frame) * times_.step;
    Positions out(static_cast<Eigen::Index>(first_point_.size()), 3);
    std::vector<float> points;
    for (const Primitive& primitive : primitives_) {
      const std::size_t begin = points.size() / 3, values = primitive.base.size();
      points.insert(points.end(), primitive.base.begin(), primitive.base.end());
      const std::vector<double> weights = weights_at(primitive, time);
      for (std::size_t k = 0; k < primitive.targets.size(); ++k) {
        if (weights[k] == 0 || primitive.targets[k] == kNoAccessor) continue;
        const std::vector<float> target = target_of(primitive, k);
        for (std::size_t i = 0; i < values; ++i) points[3 * begin + i] += static_cast<float>(weights[k]) * target[i];
      }
      Eigen::Map<Positions> rows(points.data() + 3 * begin, static_cast<Eigen::Index>(values / 3), 3);
      if (!primitive.place.matrix().isIdentity(0)) {
        rows = ((rows.cast<double>() * primitive.place.linear().transpose()).rowwise() +
                primitive.place.translation().transpose())
                   .cast<float>();
      }
    }
    for (std::size_t v = 0; v < first_point_.size(); ++v) {
      const float* point = points.data() + 3 * first_point_[v];
      out.row(static_cast<Eigen::Index>(v)) << point[0], point[1], point[2];
    }
    if (!all_finite(out))
      throw_invalid_argument(document_.name() + ": frame " + std::to_string(frame) + " is not finite");
    return out;
  }

 private:
  void read_animations() {
    for (const Json& animation : document_.array(document_.json(), "animations")) {
      for (const Json& channel : document_.array(animation, "channels")) {
        if (!channel.contains("target")) document_.fail("an animation's channel without a target");
        const auto node = document_.index(channel["target"], "node");
        if (!node) continue;
        if (document_.text(channel["target"], "path") != "weights") {
          moved_[*node] = true;
          continue;
        }
        const std::size_t sampler_index = document_.required(channel, "sampler");
        const Json& samplers = document_.array(animation, "samplers");
        if (sampler_index >= samplers.size())
          document_.fail("an animation has no sampler " + std::to_string(sampler_index));
        const Json& sampler = samplers[sampler_index];
        Weights weights;
        weights.times = document_.floats(document_.required(sampler, "input"), 1, kMaxTargets);
        weights.values = document_.floats(document_.required(sampler, "output"), 1, std::size_t{1} << 30);
        const std::string interpolation = document_.text(sampler, "interpolation");
        weights.steps = interpolation == "STEP";
        if (weights.times.empty() || !std::is_sorted(weights.times.begin(), weights.times.end()))
          document_.fail("an animation's times do not ascend");
        if (interpolation == "CUBICSPLINE") {
          // Every key has its incoming tangents, values and outgoing tangents; frames are at the keys.
          const std::size_t row = weights.values.size() / weights.times.size() / 3;
          std::vector<float> values;
          for (std::size_t k = 0; k < weights.times.size(); ++k) {
            const auto begin = weights.values.begin() + static_cast<std::ptrdiff_t>((3 * k + 1) * row);
            values.insert(values.end(), begin, begin + static_cast<std::ptrdiff_t>(row));
          }
          weights.values = std::move(values);
        }
        weights_.try_emplace(*node, std::move(weights));
      }
    }
  }

  void visit(std::size_t index, const Eigen::Affine3d& above, int depth) {
    const Json& node = document_.element("nodes", index);
    if (depth > kMaxDepth || visited_[index] != 0) document_.fail("its nodes are no tree");
    visited_[index] = 1;
    const Eigen::Affine3d place = above * local_transform(document_, node);
    const bool was_moving = moving_;
    moving_ = moving_ || moved_.count(index) > 0;
    if (const auto mesh = document_.index(node, "mesh")) add_mesh(index, node, *mesh, place);
    for (const Json& child : document_.array(node, "children")) {
      if (!child.is_number_unsigned()) document_.fail("a node's children are not numbers");
      visit(child.get<std::size_t>(), place, depth + 1);
    }
    moving_ = was_moving;
  }

  void add_mesh(std::size_t node_index, const Json& node, std::size_t mesh_index, const Eigen::Affine3d& place) {
    const Json& mesh = document_.element("meshes", mesh_index);
    const std::string name = "mesh '" + document_.text(mesh, "name") + "'";
    if (node.contains("skin"))
      document_.fail(name + " is moved by a skeleton; name the file as a `body`, or bake its frames");
    if (moving_) document_.fail("the node of " + name + " is animated as a whole; bake its frames into the vertices");
    for (const Json& primitive : document_.array(mesh, "primitives")) {
      const std::size_t mode = document_.index(primitive, "mode").value_or(4);
      if (mode < 4) continue;  // points and lines
      if (mode != 4) document_.fail(name + " has strips or fans of triangles");
      if (!primitive.contains("attributes")) document_.fail(name + " without attributes");
      add_primitive(node_index, node, mesh, primitive, place, name);
    }
  }

  void add_primitive(std::size_t node_index, const Json& node, const Json& mesh, const Json& json,
                     const Eigen::Affine3d& place, const std::string& name) {
    const Json& attributes = json["attributes"];
    Primitive primitive;
    primitive.node = node_index;
    primitive.place = place;
    primitive.base = document_.floats(document_.required(attributes, "POSITION"), 3, kMaxVertices);
    const std::size_t points = primitive.base.size() / 3;
    if (points_ + points > kMaxVertices)
      throw Error(ErrorCode::kResourceExhausted,
                  document_.name() + ": more than " + std::to_string(kMaxVertices) + " vertices");
    for (const Json& target : document_.array(json, "targets")) {
      primitive.targets.push_back(document_.index(target, "POSITION").value_or(kNoAccessor));
      if (primitive.targets.size() > kMaxTargets) document_.fail(name + " has too many targets");
      if (primitive.targets.back() != kNoAccessor && document_.accessor_count(primitive.targets.back()) != points)
        document_.fail(name + ": a target has another number of vertices");
    }
    primitive.weights.assign(primitive.targets.size(), 0);
    const Json& given = node.contains("weights") ? document_.array(node, "weights") : document_.array(mesh, "weights");
    for (std::size_t k = 0; k < std::min(given.size(), primitive.weights.size()); ++k) {
      if (!given[k].is_number()) document_.fail(name + ": weights are no numbers");
      primitive.weights[k] = given[k].get<double>();
    }
    if (const auto weights = weights_.find(node_index); weights != weights_.end()) {
      if (weights->second.values.size() != weights->second.times.size() * primitive.targets.size())
        document_.fail(name + ": its animation has another number of weights than it has targets");
      used_[node_index] = true;
    }

    std::vector<std::uint32_t> indices;
    if (const auto accessor = document_.index(json, "indices")) {
      indices = document_.indices(*accessor, kMaxCorners);
    } else {
      for (std::size_t i = 0; i < points; ++i) indices.push_back(static_cast<std::uint32_t>(i));
    }
    if (indices.size() % 3 != 0) document_.fail(name + ": its indices make no triangles");
    if (corners_.size() + indices.size() > kMaxCorners)
      throw Error(ErrorCode::kResourceExhausted,
                  document_.name() + ": more than " + std::to_string(kMaxCorners / 3) + " faces");
    if (place.linear().determinant() < 0) {
      for (std::size_t i = 0; i < indices.size(); i += 3) std::swap(indices[i + 1], indices[i + 2]);
    }
    for (const std::uint32_t i : indices) {
      if (i >= points)
        document_.fail(name + ": a face names vertex " + std::to_string(i) + " of " + std::to_string(points));
      corners_.push_back(static_cast<std::uint32_t>(points_ + i));
    }
    if (const auto accessor = document_.index(attributes, "TEXCOORD_0")) {
      const std::vector<float> uv = document_.floats(*accessor, 2, kMaxVertices);
      if (uv.size() != 2 * points) document_.fail(name + ": TEXCOORD_0 has another number of vertices");
      uv_.insert(uv_.end(), uv.begin(), uv.end());
    } else {
      uv_.insert(uv_.end(), 2 * points, std::numeric_limits<float>::quiet_NaN());
      if (mesh_.without_uv.empty()) mesh_.without_uv = name;
    }
    points_ += points;
    primitives_.push_back(std::move(primitive));
  }

  std::vector<float> target_of(const Primitive& primitive, std::size_t k) const {
    return document_.floats(primitive.targets[k], 3, kMaxVertices);
  }

  std::vector<double> weights_at(const Primitive& primitive, double time) const {
    const auto found = weights_.find(primitive.node);
    if (found == weights_.end()) return primitive.weights;
    const Weights& weights = found->second;
    const std::size_t targets = primitive.targets.size();
    // The key at or before the time; keys are rounded to floats.
    const auto after =
        std::upper_bound(weights.times.begin(), weights.times.end(), static_cast<float>(time + 1e-3 * times_.step));
    const std::size_t next = static_cast<std::size_t>(after - weights.times.begin());
    const std::size_t from = next == 0 ? 0 : next - 1, to = std::min(next, weights.times.size() - 1);
    const double gap = static_cast<double>(weights.times[to]) - static_cast<double>(weights.times[from]);
    double part = gap > 0 && !weights.steps ? (time - static_cast<double>(weights.times[from])) / gap : 0;
    part = part < 1e-3 ? 0 : std::min(part, 1.0);
    std::vector<double> out(targets);
    for (std::size_t k = 0; k < targets; ++k) {
      out[k] = (1 - part) * static_cast<double>(weights.values[from * targets + k]) +
               part * static_cast<double>(weights.values[to * targets + k]);
    }
    return out;
  }

  /// Points that are one in every frame become one vertex, in the order of the points.
  void weld() {
    detail::PointWelder welder;
    for (const Primitive& primitive : primitives_) {
      const std::size_t points = primitive.base.size() / 3;
      std::vector<Hash> motion(points);
      for (std::size_t k = 0; k < primitive.targets.size(); ++k) {
        if (primitive.targets[k] == kNoAccessor) continue;
        std::vector<float> target = target_of(primitive, k);
        for (float& value : target) value += 0.0F;  // -0 is 0
        for (std::size_t i = 0; i < points; ++i)
          motion[i].add({reinterpret_cast<const char*>(target.data() + 3 * i), 3 * sizeof(float)});
      }
      for (std::size_t i = 0; i < points; ++i)
        welder.add(primitive.base.data() + 3 * i, static_cast<std::uint32_t>(primitive.node), motion[i].value());
    }
    const std::vector<std::uint32_t>& vertex = welder.vertex();
    first_point_ = welder.first_point();
    std::map<std::pair<std::uint32_t, std::array<float, 2>>, std::uint32_t> places;
    for (std::size_t i = 0; i < corners_.size(); i += 3) {
      const std::array<std::uint32_t, 3> face = {vertex[corners_[i]], vertex[corners_[i + 1]], vertex[corners_[i + 2]]};
      if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0]) continue;  // nothing of it is left
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t point = corners_[i + k];
        const std::array<float, 2> uv = {uv_[2 * point], 1 - uv_[2 * point + 1]};  // glTF's v goes down
        PolygonMesh::Corner corner{face[k], PolygonMesh::kNoUv};
        if (std::isfinite(uv[0])) {
          const auto [found, is_new] =
              places.try_emplace({face[k], uv}, static_cast<std::uint32_t>(mesh_.uv.size() / 2));
          if (is_new) mesh_.uv.insert(mesh_.uv.end(), uv.begin(), uv.end());
          corner.uv = found->second;
        }
        mesh_.corners.push_back(corner);
      }
      mesh_.ends.push_back(mesh_.corners.size());
      mesh_.places.push_back(static_cast<std::uint32_t>(i / 3));
    }
    corners_.clear();
    uv_.clear();
  }

  Document document_;
  std::map<std::size_t, Weights> weights_;  ///< by node
  std::map<std::size_t, bool> moved_, used_;
  std::vector<char> visited_;
  bool moving_ = false;
  std::vector<Primitive> primitives_;
  std::size_t points_ = 0;
  std::vector<std::uint32_t> corners_;
  std::vector<float> uv_;
  detail::FrameTimes times_;
  std::vector<std::size_t> first_point_;  ///< of each vertex
  PolygonMesh mesh_;
};

}  // namespace

std::unique_ptr<AnimatedMesh> open_gltf(const fs::path& path) {
  try {
    return std::make_unique<GltfMesh>(path);
  } catch (const Json::exception& error) {
    throw_invalid_argument(path.string() + ": not as glTF has it: " + error.what());
  }
}

}  // namespace pleat
