#include "common/mesh/ply.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <optional>
#include <sstream>

#include "common/base/error.hpp"
#include "common/base/limits.hpp"
#include "common/base/text_file.hpp"

namespace pleat {
namespace {

constexpr std::uint64_t kMaxCorners = 1000;

enum class Type { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

struct Property {
  std::string name;
  Type type = Type::kFloat;
  std::optional<Type> count;  ///< of a list
};

struct Element {
  std::string name;
  std::uint64_t count = 0;
  std::vector<Property> properties;

  std::optional<std::size_t> find(std::initializer_list<const char*> names, bool list) const {
    for (std::size_t i = 0; i < properties.size(); ++i) {
      for (const char* wanted : names) {
        if (properties[i].name == wanted && properties[i].count.has_value() == list) return i;
      }
    }
    return std::nullopt;
  }
};

class PlyReader {
 public:
  explicit PlyReader(const std::filesystem::path& path) : name_(path.string()), stream_(path, std::ios::binary) {
    std::error_code ignored;
    if (!stream_ || std::filesystem::is_directory(path, ignored)) throw_not_found(name_ + ": can't be read");
    refuse_placeholder(path);
    read_header();
  }

  PolygonMesh read() {
    for (const Element& element : elements_) {
      if (element.name == "vertex") {
        read_vertices(element);
      } else if (element.name == "face") {
        read_faces(element);
      } else {
        for (std::uint64_t i = 0; i < element.count; ++i) read_row(element);
      }
    }
    return std::move(out_);
  }

 private:
  [[noreturn]] void fail(const std::string& message) const { throw_invalid_argument(name_ + ": " + message); }

  Type type_of(const std::string& word) const {
    constexpr std::pair<const char*, Type> kNames[] = {
        {"char", Type::kInt8},   {"int8", Type::kInt8},     {"uchar", Type::kUint8},   {"uint8", Type::kUint8},
        {"short", Type::kInt16}, {"int16", Type::kInt16},   {"ushort", Type::kUint16}, {"uint16", Type::kUint16},
        {"int", Type::kInt32},   {"int32", Type::kInt32},   {"uint", Type::kUint32},   {"uint32", Type::kUint32},
        {"float", Type::kFloat}, {"float32", Type::kFloat}, {"double", Type::kDouble}, {"float64", Type::kDouble}};
    for (const auto& [name, type] : kNames) {
      if (word == name) return type;
    }
    fail("unknown type '" + word.substr(0, 40) + "'");
  }

  void read_header() {
    std::string line;
    if (!std::getline(stream_, line) || line.substr(0, 3) != "ply") fail("not a PLY file");
    bool with_format = false;
    while (std::getline(stream_, line)) {
      if (!line.empty() && line.back() == '\r') line.pop_back();
      std::istringstream words(line);
      std::string word, first, second, third;
      words >> word;
      if (word == "end_header") {
        if (!with_format) fail("the header names no format");
        return;
      }
      if (word == "format") {
        words >> first;
        with_format = true;
        text_ = first == "ascii";
        swap_ = first == (std::endian::native == std::endian::little ? "binary_big_endian" : "binary_little_endian");
        if (!text_ && first != "binary_little_endian" && first != "binary_big_endian")
          fail("unknown format '" + first + "'");
      } else if (word == "element") {
        Element element;
        if (!(words >> element.name >> element.count)) fail("element without a count");
        const std::uint64_t limit = element.name == "vertex" ? kMaxVertices : kMaxFaces;
        if (element.count > limit) {
          throw Error(ErrorCode::kResourceExhausted,
                      name_ + ": more than " + std::to_string(limit) + " of element '" + element.name + "'");
        }
        elements_.push_back(std::move(element));
      } else if (word == "property") {
        if (elements_.empty()) fail("a property before the first element");
        Property property;
        words >> first;
        if (first == "list") {
          words >> first >> second;
          property.count = type_of(first);
          first = second;
        }
        property.type = type_of(first);
        words >> property.name;
        elements_.back().properties.push_back(std::move(property));
      } else if (word != "comment" && word != "obj_info" && !word.empty()) {
        fail("unknown line '" + line.substr(0, 40) + "' in the header");
      }
    }
    throw_data_loss(name_ + ": truncated in the header");
  }

  template <class T>
  double number_of() {
    T value{};
    char bytes[sizeof(T)];
    stream_.read(bytes, sizeof(T));
    if (swap_) std::reverse(bytes, bytes + sizeof(T));
    std::memcpy(&value, bytes, sizeof(T));
    return static_cast<double>(value);
  }

  double number(Type type) {
    double value = 0;
    if (text_) {
      stream_ >> value;
    } else {
      switch (type) {
        case Type::kInt8:
          value = number_of<std::int8_t>();
          break;
        case Type::kUint8:
          value = number_of<std::uint8_t>();
          break;
        case Type::kInt16:
          value = number_of<std::int16_t>();
          break;
        case Type::kUint16:
          value = number_of<std::uint16_t>();
          break;
        case Type::kInt32:
          value = number_of<std::int32_t>();
          break;
        case Type::kUint32:
          value = number_of<std::uint32_t>();
          break;
        case Type::kFloat:
          value = number_of<float>();
          break;
        case Type::kDouble:
          value = number_of<double>();
          break;
      }
    }
    if (!stream_) throw_data_loss(name_ + ": truncated, or a value is no number");
    return value;
  }

  /// Scalars of a row into row_, its lists into lists_, by property.
  void read_row(const Element& element) {
    row_.assign(element.properties.size(), 0);
    lists_.resize(std::max(lists_.size(), element.properties.size()));
    for (std::size_t p = 0; p < element.properties.size(); ++p) {
      const Property& property = element.properties[p];
      if (!property.count) {
        row_[p] = number(property.type);
        continue;
      }
      const double count = number(*property.count);
      if (!(count >= 0 && count <= static_cast<double>(kMaxCorners)))
        fail("a list of " + std::to_string(count) + " values");
      lists_[p].clear();
      for (int i = 0; i < static_cast<int>(count); ++i) lists_[p].push_back(number(property.type));
    }
  }

  void read_vertices(const Element& element) {
    const auto x = element.find({"x"}, false), y = element.find({"y"}, false), z = element.find({"z"}, false);
    const auto u = element.find({"s", "u", "texture_u"}, false), v = element.find({"t", "v", "texture_v"}, false);
    if (!x || !y || !z) fail("its vertices have no x, y and z");
    for (std::uint64_t i = 0; i < element.count; ++i) {
      read_row(element);
      for (const std::size_t p : {*x, *y, *z}) {
        if (!std::isfinite(static_cast<float>(row_[p]))) fail("vertex " + std::to_string(i) + " is not finite");
        out_.positions.push_back(static_cast<float>(row_[p]));
      }
      if (!u || !v) continue;
      for (const std::size_t p : {*u, *v}) {
        if (!std::isfinite(static_cast<float>(row_[p]))) {
          fail("vertex " + std::to_string(i) + ": a material coordinate is not finite");
        }
        out_.uv.push_back(static_cast<float>(row_[p]));
      }
    }
  }

  void read_faces(const Element& element) {
    const auto indices = element.find({"vertex_indices", "vertex_index"}, true);
    if (!indices) fail("its faces have no vertex_indices");
    const bool with_uv = !out_.uv.empty();
    for (std::uint64_t f = 0; f < element.count; ++f) {
      read_row(element);
      const std::size_t begin = out_.corners.size();
      for (const double value : lists_[*indices]) {
        if (!(value >= 0 && value < 4294967295.0))
          fail("face " + std::to_string(f) + " names a vertex that does not exist");
        const auto index = static_cast<std::uint32_t>(value);
        if (out_.corners.size() > begin && out_.corners.back().vertex == index) continue;
        out_.corners.push_back({index, with_uv ? index : PolygonMesh::kNoUv});
      }
      if (out_.corners.size() > begin + 1 && out_.corners.back().vertex == out_.corners[begin].vertex)
        out_.corners.pop_back();
      if (out_.corners.size() < begin + 3) fail("face " + std::to_string(f) + " has fewer than 3 different corners");
      out_.ends.push_back(out_.corners.size());
      out_.places.push_back(static_cast<std::uint32_t>(f));
    }
  }

  std::string name_;
  std::ifstream stream_;
  std::vector<Element> elements_;
  bool text_ = false, swap_ = false;
  std::vector<double> row_;
  std::vector<std::vector<double>> lists_;
  PolygonMesh out_;
};

}  // namespace

PolygonMesh read_ply(const std::filesystem::path& path) { return PlyReader(path).read(); }

}  // namespace pleat
