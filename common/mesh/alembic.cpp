#include "common/mesh/alembic.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <string_view>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/limits.hpp"
#include "common/base/text_file.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "the format is little-endian");

constexpr std::uint64_t kIsData = std::uint64_t{1} << 63;
constexpr std::size_t kKeyBytes = 16, kHashBytes = 32;              // before a sample, behind the headers of objects
constexpr std::uint64_t kMaxHeaderBytes = std::uint64_t{64} << 20;  // of all objects together, however they repeat
constexpr std::size_t kMaxCorners = 4 * kMaxFaces;
constexpr std::size_t kMaxObjects = 100'000;
constexpr int kMaxDepth = 100;

/// Types of numbers, by the format's own numbers.
enum Pod { kBool, kUint8, kInt8, kUint16, kInt16, kUint32, kInt32, kUint64, kInt64, kFloat16, kFloat32, kFloat64 };
constexpr std::array<std::size_t, 12> kPodBytes = {1, 1, 1, 2, 2, 4, 4, 8, 8, 2, 4, 8};

/// Takes numbers and texts off a block of headers.
class Block {
 public:
  Block(std::string bytes, const std::string& name) : bytes_(std::move(bytes)), name_(name) {}
  bool at_end() const { return at_ == bytes_.size(); }
  template <class T>
  T number() {
    T value{};
    std::memcpy(&value, take(sizeof(T)), sizeof(T));
    return value;
  }
  std::string text(std::size_t length) { return {take(length), length}; }

 private:
  const char* take(std::size_t count) {
    if (count > bytes_.size() - at_) throw_data_loss(name_ + ": a header of Alembic is cut off");
    at_ += count;
    return bytes_.data() + at_ - count;
  }
  std::string bytes_;
  const std::string& name_;
  std::size_t at_ = 0;
};

/// The container: groups of groups and blocks of bytes, each named by its place in the file.
class Ogawa {
 public:
  explicit Ogawa(const fs::path& path) : name_(path.string()) {
    std::error_code ignored;
    if (!fs::is_regular_file(path, ignored)) throw_not_found(name_ + ": can't be read");
    refuse_placeholder(path);
    size_ = fs::file_size(path);
    const std::string head = read(0, std::min<std::uint64_t>(size_, 16));
    if (head.starts_with("\x89HDF"))
      throw_invalid_argument(name_ + ": Alembic in its old HDF5 form; export it anew, as Ogawa");
    if (!head.starts_with("Ogawa")) throw_invalid_argument(name_ + ": not an Alembic file");
    if (head.size() < 16 || head[5] != '\xff')
      throw_data_loss(name_ + ": truncated or never finished by the program that wrote it");
    std::memcpy(&root_, head.data() + 8, 8);
  }

  const std::string& name() const { return name_; }
  std::uint64_t root() const { return root_; }

  /// The children of a group; data have the bit kIsData.
  std::vector<std::uint64_t> children(std::uint64_t group) {
    std::vector<std::uint64_t> places(child_count(group));
    if (places.empty()) return places;
    charge(places.size() * 8);
    const std::string bytes = read(group + 8, places.size() * 8);
    std::memcpy(places.data(), bytes.data(), bytes.size());
    return places;
  }
  /// One of them; nothing where it has fewer.
  std::optional<std::uint64_t> child(std::uint64_t group, std::uint64_t k) const {
    if (k >= child_count(group)) return std::nullopt;
    return word(group + 8 + 8 * k);
  }

  /// The block of bytes of headers.
  std::string header(std::uint64_t data) {
    charge(data_bytes(data));
    return this->data(data, 0, kMaxHeaderBytes);
  }
  /// `skip` bytes of it left out; at most `most`.
  std::string data(std::uint64_t data, std::uint64_t skip, std::uint64_t most) const {
    const std::uint64_t bytes = data_bytes(data);
    if (bytes <= skip) return {};
    if (bytes - skip > most)
      throw Error(ErrorCode::kResourceExhausted, name_ + ": an array of " + std::to_string(bytes) + " bytes");
    return read((data & ~kIsData) + 8 + skip, bytes - skip);
  }

 private:
  [[noreturn]] void damaged() const { throw_data_loss(name_ + ": truncated or damaged"); }
  void charge(std::uint64_t bytes) {
    headers_ += bytes;
    if (bytes > kMaxHeaderBytes || headers_ > kMaxHeaderBytes)
      throw Error(ErrorCode::kResourceExhausted, name_ + ": more than 64 MiB of headers");
  }
  std::uint64_t child_count(std::uint64_t group) const {
    if (group & kIsData) damaged();
    if (group == 0) return 0;  // an empty one
    const std::uint64_t count = word(group);
    if (count > (size_ - group - 8) / 8) damaged();
    return count;
  }
  std::uint64_t data_bytes(std::uint64_t data) const {
    if (!(data & kIsData)) damaged();
    const std::uint64_t place = data & ~kIsData;
    if (place == 0) return 0;
    const std::uint64_t bytes = word(place);
    if (bytes > size_ - place - 8) damaged();
    return bytes;
  }
  std::uint64_t word(std::uint64_t place) const {
    std::uint64_t value = 0;
    std::memcpy(&value, read(place, 8).data(), 8);
    return value;
  }
  std::string read(std::uint64_t place, std::uint64_t count) const {
    if (place > size_ || count > size_ - place) damaged();
    std::ifstream stream(name_, std::ios::binary);
    std::string bytes(count, '\0');
    stream.seekg(static_cast<std::streamoff>(place));
    if (!stream.read(bytes.data(), static_cast<std::streamsize>(count))) damaged();
    return bytes;
  }

  std::string name_;
  std::uint64_t size_ = 0, root_ = 0, headers_ = 0;
};

/// One property of an object.
struct Property {
  std::string name, metadata;
  bool compound = false, array = false;
  int pod = 0;
  std::size_t extent = 0;
  std::uint32_t samples = 0;
  std::uint32_t first_changed = 0, last_changed = 0;  ///< equal samples at both ends are stored once
  std::uint32_t time_sampling = 0;
  std::uint64_t group = 0;

  bool constant() const { return samples < 2 || last_changed == 0; }
};
using Properties = std::map<std::string, Property>;

struct Object {
  std::string name, metadata;
  std::uint64_t group = 0;
};

/// The value of KEY in "KEY=value;...".
std::string_view value_of(std::string_view metadata, std::string_view key) {
  while (!metadata.empty()) {
    const std::string_view pair = metadata.substr(0, metadata.find(';'));
    if (pair.starts_with(key) && pair.size() > key.size() && pair[key.size()] == '=')
      return pair.substr(key.size() + 1);
    metadata.remove_prefix(std::min(metadata.size(), pair.size() + 1));
  }
  return {};
}

/// Objects, properties and samples.
class Archive {
 public:
  explicit Archive(const fs::path& path) : file_(path) {
    const std::vector<std::uint64_t> parts = file_.children(file_.root());
    if (parts.size() < 6) throw_invalid_argument(name() + ": not an Alembic archive");
    Block times(file_.header(parts[4]), name());
    while (!times.at_end()) {
      times.number<std::uint32_t>();
      TimeSampling sampling;
      sampling.cycle = times.number<double>();
      const auto stored = times.number<std::uint32_t>();
      for (std::uint32_t k = 0; k < stored; ++k) sampling.times.push_back(times.number<double>());
      time_samplings_.push_back(std::move(sampling));
    }
    Block metadata(file_.header(parts[5]), name());
    metadata_.emplace_back();
    while (!metadata.at_end()) metadata_.push_back(metadata.text(metadata.number<std::uint8_t>()));
    top_ = parts[2];
  }

  const std::string& name() const { return file_.name(); }
  std::uint64_t top() const { return top_; }

  std::vector<Object> objects(std::uint64_t object) {
    const std::vector<std::uint64_t> children = file_.children(object);
    std::vector<Object> found;
    if (children.empty() || !(children.back() & kIsData)) return found;
    std::string headers = file_.header(children.back());
    headers.resize(headers.size() < kHashBytes ? 0 : headers.size() - kHashBytes);
    Block block(std::move(headers), name());
    while (!block.at_end()) {
      Object child;
      child.name = block.text(block.number<std::uint32_t>());
      const auto index = block.number<std::uint8_t>();
      child.metadata = index == 0xff ? block.text(block.number<std::uint32_t>()) : shared_metadata(index);
      if (found.size() + 1 >= children.size()) throw_data_loss(name() + ": object '" + child.name + "' is not there");
      child.group = children[found.size() + 1];
      found.push_back(std::move(child));
    }
    return found;
  }

  /// The properties of an object.
  Properties properties_of(std::uint64_t object) {
    const auto first = file_.child(object, 0);
    return !first || (*first & kIsData) ? Properties{} : properties(*first);
  }
  Properties properties(std::uint64_t compound) {
    const std::vector<std::uint64_t> children = file_.children(compound);
    Properties found;
    if (children.empty() || !(children.back() & kIsData)) return found;
    Block block(file_.header(children.back()), name());
    for (std::size_t k = 0; !block.at_end(); ++k) {
      Property property = header(block);
      if (k + 1 >= children.size()) throw_data_loss(name() + ": property '" + property.name + "' is not there");
      property.group = children[k];
      std::string key = property.name;
      found.try_emplace(std::move(key), std::move(property));
    }
    return found;
  }

  /// The times of all samples, ascending.
  std::vector<double> times(const Property& property) const {
    if (property.time_sampling >= time_samplings_.size())
      throw_data_loss(name() + ": '" + property.name + "' has no times");
    const TimeSampling& sampling = time_samplings_[property.time_sampling];
    const std::size_t stored = sampling.times.size();
    const bool cyclic = sampling.cycle < 1e30;  // else each sample has its own
    if (property.samples > kMaxFrames)
      throw Error(ErrorCode::kResourceExhausted, name() + ": more than " + std::to_string(kMaxFrames) + " samples");
    if (stored == 0 || (!cyclic && stored < property.samples))
      throw_data_loss(name() + ": '" + property.name + "' has more samples than times");
    std::vector<double> times;
    for (std::size_t k = 0; k < property.samples; ++k) {
      const std::size_t cycles = k / stored;
      const double cycle = cyclic ? sampling.cycle * static_cast<double>(cycles) : 0;
      times.push_back(sampling.times[cyclic ? k % stored : k] + cycle);
      if (!std::isfinite(times.back()) || (k > 0 && times[k] <= times[k - 1]))
        throw_invalid_argument(name() + ": the times of '" + property.name + "' do not ascend");
    }
    return times;
  }

  /// Sample k as numbers of type T; at most `most` of them.
  template <class T>
  std::vector<T> values(const Property& property, std::size_t k, std::size_t most) const {
    const std::string what = name() + ": '" + property.name + "'";
    if (property.compound || property.pod >= static_cast<int>(kPodBytes.size()))
      throw_invalid_argument(what + " has no numbers");
    if (property.samples == 0) return {};
    const std::size_t width = kPodBytes[static_cast<std::size_t>(property.pod)];
    std::size_t stored = 0;
    if (k >= property.first_changed && property.last_changed > 0)
      stored = std::min<std::size_t>(k, property.last_changed) - property.first_changed + 1;
    // An array's sample has its extents behind it.
    const auto data = file_.child(property.group, property.array ? 2 * stored : stored);
    if (!data) throw_data_loss(what + " has no sample " + std::to_string(k));
    const std::string bytes = file_.data(*data, kKeyBytes, most * width);
    if (bytes.size() % width != 0) throw_data_loss(what + ": " + std::to_string(bytes.size()) + " bytes");
    std::vector<T> values(bytes.size() / width);
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = number<T>(bytes.data() + i * width, property.pod);
    return values;
  }

 private:
  struct TimeSampling {
    double cycle = 0;
    std::vector<double> times;
  };

  const std::string& shared_metadata(std::size_t index) const {
    if (index >= metadata_.size()) throw_data_loss(name() + ": a header of Alembic names metadata that are not there");
    return metadata_[index];
  }

  Property header(Block& block) const {
    const auto info = block.number<std::uint32_t>();
    const std::uint32_t width = (info >> 2) & 3;
    const auto number = [&]() -> std::uint32_t {
      if (width == 0) return block.number<std::uint8_t>();
      return width == 1 ? block.number<std::uint16_t>() : block.number<std::uint32_t>();
    };
    Property property;
    property.compound = (info & 3) == 0;
    property.array = (info & 2) != 0;
    if (!property.compound) {
      property.pod = static_cast<int>((info >> 4) & 15);
      property.extent = (info >> 12) & 255;
      property.samples = number();
      if (info & 0x200) {
        property.first_changed = number();
        property.last_changed = number();
      } else if (!(info & 0x800)) {
        property.first_changed = 1;
        property.last_changed = property.samples > 0 ? property.samples - 1 : 0;
      }
      if (info & 0x100) property.time_sampling = number();
    }
    property.name = block.text(number());
    const std::uint32_t index = (info >> 20) & 255;
    property.metadata = index == 0xff ? block.text(number()) : shared_metadata(index);
    return property;
  }

  template <class T, class Stored>
  static T as(const char* bytes) {
    Stored value{};
    std::memcpy(&value, bytes, sizeof value);
    if constexpr (std::is_integral_v<T>) {
      // What does not fit becomes the largest: no index in range.
      if (!(static_cast<double>(value) >= 0 && static_cast<double>(value) <= static_cast<double>(~T{0}))) return ~T{0};
    }
    return static_cast<T>(value);
  }
  template <class T>
  static T number(const char* bytes, int pod) {
    switch (pod) {
      case kBool:
      case kUint8:
        return as<T, std::uint8_t>(bytes);
      case kInt8:
        return as<T, std::int8_t>(bytes);
      case kUint16:
        return as<T, std::uint16_t>(bytes);
      case kInt16:
        return as<T, std::int16_t>(bytes);
      case kUint32:
        return as<T, std::uint32_t>(bytes);
      case kInt32:
        return as<T, std::int32_t>(bytes);
      case kUint64:
        return as<T, std::uint64_t>(bytes);
      case kInt64:
        return as<T, std::int64_t>(bytes);
      case kFloat16: {
        const float value =
            static_cast<float>(Eigen::numext::bit_cast<Eigen::half>(as<std::uint16_t, std::uint16_t>(bytes)));
        return as<T, float>(reinterpret_cast<const char*>(&value));
      }
      case kFloat32:
        return as<T, float>(bytes);
      default:
        return as<T, double>(bytes);
    }
  }

  Ogawa file_;
  std::uint64_t top_ = 0;
  std::vector<TimeSampling> time_samplings_;
  std::vector<std::string> metadata_;
};

/// A property that may change, and when it does.
struct Animated {
  Property property;
  std::vector<double> times;  ///< none if it is constant
};

/// One Xform: what it does, as the format lists it, and the numbers of that over time.
struct Xform {
  std::string name;
  std::vector<std::uint32_t> operations;
  std::optional<Animated> numbers;
  bool inherits = true;
};

/// One PolyMesh or SubD.
struct Part {
  std::string name;
  Animated points;
  std::vector<Xform> above;  ///< outermost first
  std::size_t count = 0;
};

class AlembicMesh final : public AnimatedMesh {
 public:
  explicit AlembicMesh(const fs::path& path) : archive_(path) {
    std::vector<Xform> above;
    visit_children(archive_.top(), above, 0);
    if (parts_.empty()) fail("no PolyMesh in it");
    std::vector<double> keys;
    const auto add = [&keys](const Animated& animated) {
      keys.insert(keys.end(), animated.times.begin(), animated.times.end());
    };
    for (const Part& part : parts_) {
      add(part.points);
      for (const Xform& xform : part.above)
        if (xform.numbers) add(*xform.numbers);
    }
    times_ = detail::even_times(std::move(keys), archive_.name());
    const Positions first = positions(0);
    mesh_.positions.assign(first.data(), first.data() + first.size());
  }

  const PolygonMesh& mesh() const override { return mesh_; }
  std::size_t frame_count() const override { return times_.count; }
  double frame_time_s() const override { return times_.step; }

  Positions positions(std::size_t frame) const override {
    if (frame >= times_.count) fail("no frame " + std::to_string(frame) + " of " + std::to_string(times_.count));
    const double time = times_.first + static_cast<double>(frame) * times_.step;
    Positions out(static_cast<Eigen::Index>(vertices_), 3);
    Eigen::Index begin = 0;
    for (const Part& part : parts_) {
      const auto count = static_cast<Eigen::Index>(part.count);
      const std::vector<float> points = values_at<float>(part.points, time, 3 * kMaxVertices);
      if (points.size() != 3 * part.count) fail("Mesh '" + part.name + "': the number of its points changes over time");
      const Eigen::Affine3d place = place_at(part, time);
      const Eigen::Map<const Positions> rows(points.data(), count, 3);
      if (place.matrix().isIdentity(0)) {
        out.middleRows(begin, count) = rows;
      } else {
        out.middleRows(begin, count) =
            ((rows.cast<double>() * place.linear().transpose()).rowwise() + place.translation().transpose())
                .cast<float>();
      }
      begin += count;
    }
    if (!all_finite(out)) fail("frame " + std::to_string(frame) + " is not finite");
    return out;
  }

 private:
  [[noreturn]] void fail(const std::string& message) const { throw_invalid_argument(archive_.name() + ": " + message); }

  void visit_children(std::uint64_t group, std::vector<Xform>& above, int depth) {
    if (depth > kMaxDepth) fail("its objects are no tree");
    for (const Object& object : archive_.objects(group)) {
      if (++objects_ > kMaxObjects) fail("more than " + std::to_string(kMaxObjects) + " objects");
      const Properties properties = archive_.properties_of(object.group);
      const auto visible = properties.find("visible");
      if (visible != properties.end() && visible->second.pod == kInt8) {
        const std::vector<float> value = archive_.values<float>(visible->second, 0, 1);
        if (!value.empty() && value[0] == 0) continue;
      }
      const std::string_view schema = value_of(object.metadata, "schema");
      const std::size_t before = above.size();
      if (schema.starts_with("AbcGeom_Xform_")) above.push_back(read_xform(object, properties));
      if (schema.starts_with("AbcGeom_PolyMesh_") || schema.starts_with("AbcGeom_SubD_"))
        add_mesh(object, properties, above);
      visit_children(object.group, above, depth + 1);
      above.resize(before);
    }
  }

  Properties inside(const Properties& properties, const char* name) {
    const auto found = properties.find(name);
    return found == properties.end() || !found->second.compound ? Properties{}
                                                                : archive_.properties(found->second.group);
  }

  Animated animated(const Property& property) const {
    return {property, property.constant() ? std::vector<double>{} : archive_.times(property)};
  }

  Xform read_xform(const Object& object, const Properties& properties) {
    const Properties xform = inside(properties, ".xform");
    Xform read;
    read.name = object.name;
    if (const auto inherits = xform.find(".inherits"); inherits != xform.end()) {
      const std::vector<float> value = archive_.values<float>(inherits->second, 0, 1);
      read.inherits = value.empty() || value[0] != 0;
    }
    const auto operations = xform.find(".ops"), numbers = xform.find(".vals");
    if (operations == xform.end() || numbers == xform.end()) return read;
    for (const std::uint32_t code : archive_.values<std::uint32_t>(operations->second, 0, 255))
      read.operations.push_back(code >> 4);
    read.numbers = animated(numbers->second);
    transform(read, read.numbers->times.empty() ? 0 : read.numbers->times[0]);  // refused now, if ever
    return read;
  }

  Eigen::Affine3d transform(const Xform& xform, double time) const {
    Eigen::Affine3d place = Eigen::Affine3d::Identity();
    if (!xform.numbers) return place;
    const std::vector<double> values = values_at<double>(*xform.numbers, time, 16 * 255);
    std::size_t at = 0;
    const auto next = [&](std::size_t count) {
      if (count > values.size() - at) fail("Xform '" + xform.name + "' has too few numbers");
      at += count;
      return values.data() + at - count;
    };
    const auto turn = [](double degrees, const Eigen::Vector3d& axis) {
      return Eigen::AngleAxisd(degrees * std::numbers::pi / 180, axis);
    };
    for (const std::uint32_t operation : xform.operations) {
      switch (operation) {
        case 0:
          place.scale(Eigen::Map<const Eigen::Vector3d>(next(3)));
          break;
        case 1:
          place.translate(Eigen::Map<const Eigen::Vector3d>(next(3)));
          break;
        case 2: {
          const double* v = next(4);
          const Eigen::Vector3d axis(v[0], v[1], v[2]);
          if (axis.norm() > 0) place.rotate(turn(v[3], axis.normalized()));
          break;
        }
        case 3: {
          Eigen::Affine3d given;
          given.matrix() = Eigen::Map<const Eigen::Matrix4d>(next(16));  // rows of theirs are columns of ours
          place = place * given;
          break;
        }
        case 4:
        case 5:
        case 6:
          place.rotate(turn(*next(1), Eigen::Vector3d::Unit(static_cast<int>(operation) - 4)));
          break;
        default:
          fail("Xform '" + xform.name + "': unknown operation " + std::to_string(operation));
      }
    }
    return place;
  }

  Eigen::Affine3d place_at(const Part& part, double time) const {
    Eigen::Affine3d place = Eigen::Affine3d::Identity();
    for (const Xform& xform : part.above) {
      if (!xform.inherits) place.setIdentity();
      place = place * transform(xform, time);
    }
    return place;
  }

  void add_mesh(const Object& object, const Properties& properties, const std::vector<Xform>& above) {
    const std::string what = "Mesh '" + object.name + "'";
    const Properties mesh = inside(properties, ".geom");
    const auto get = [&](const char* name) -> const Property& {
      const auto found = mesh.find(name);
      if (found == mesh.end() || found->second.samples == 0) fail(what + " has no '" + name + "'");
      return found->second;
    };
    Part part{object.name, animated(get("P")), above, 0};
    for (const char* name : {".faceCounts", ".faceIndices"}) {
      if (!get(name).constant()) fail(what + ": its faces change over time");
    }
    part.count = archive_.values<float>(part.points.property, 0, 3 * kMaxVertices).size() / 3;
    if (vertices_ + part.count > kMaxVertices)
      throw Error(ErrorCode::kResourceExhausted,
                  archive_.name() + ": more than " + std::to_string(kMaxVertices) + " vertices");
    const auto sizes = archive_.values<std::uint32_t>(get(".faceCounts"), 0, kMaxCorners);
    const auto corners = archive_.values<std::uint32_t>(get(".faceIndices"), 0, kMaxCorners);
    std::vector<float> uv;
    std::vector<std::uint32_t> uv_indices;
    std::string_view scope;
    if (const auto found = mesh.find("uv"); found != mesh.end()) {
      scope = value_of(found->second.metadata, "geoScope");
      const Properties indexed = inside(mesh, "uv");
      const auto values = indexed.find(".vals"), indices = indexed.find(".indices");
      const bool compound = found->second.compound;
      if (!compound) uv = archive_.values<float>(found->second, 0, 2 * kMaxCorners);
      if (compound && values != indexed.end()) uv = archive_.values<float>(values->second, 0, 2 * kMaxCorners);
      if (compound && indices != indexed.end())
        uv_indices = archive_.values<std::uint32_t>(indices->second, 0, kMaxCorners);
    }
    const double size = place_at(part, part.points.times.empty() ? 0 : part.points.times[0]).linear().determinant();
    append_faces(mesh_,
                 {.file = archive_.name(),
                  .mesh = what,
                  .sizes = sizes,
                  .vertices = corners,
                  .vertex_count = part.count,
                  .uv = uv,
                  .uv_indices = uv_indices,
                  .uv_by_vertex = scope == "vtx" || scope == "var",
                  .clockwise = size >= 0},  // as the format has them
                 vertices_);
    vertices_ += part.count;
    parts_.push_back(std::move(part));
  }

  /// Linear between samples, constant before and after.
  template <class T>
  std::vector<T> values_at(const Animated& animated, double time, std::size_t most) const {
    constexpr double kSame = 1e-3;  // of a frame
    const std::vector<double>& times = animated.times;
    const auto after = std::upper_bound(times.begin(), times.end(), time + kSame * times_.step);
    const std::size_t next = static_cast<std::size_t>(after - times.begin()), before = next == 0 ? 0 : next - 1;
    std::vector<T> values = archive_.values<T>(animated.property, before, most);
    if (next == 0 || next == times.size()) return values;
    const double part = (time - times[before]) / (times[next] - times[before]);
    if (part < kSame) return values;
    const std::vector<T> later = archive_.values<T>(animated.property, next, most);
    if (later.size() != values.size()) fail("'" + animated.property.name + "' changes its size over time");
    for (std::size_t i = 0; i < values.size(); ++i) values[i] += static_cast<T>(part) * (later[i] - values[i]);
    return values;
  }

  Archive archive_;
  std::vector<Part> parts_;
  std::size_t vertices_ = 0, objects_ = 0;
  detail::FrameTimes times_;
  PolygonMesh mesh_;
};

}  // namespace

std::unique_ptr<AnimatedMesh> open_alembic(const fs::path& path) { return std::make_unique<AlembicMesh>(path); }

}  // namespace pleat
