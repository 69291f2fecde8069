#include "common/mesh/usd_text.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <string_view>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/limits.hpp"
#include "common/base/text_file.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxCorners = 4 * kMaxFaces;
constexpr std::size_t kMaxBytes = std::size_t{4} << 30;
constexpr int kMaxDepth = 100;

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }
bool is_word(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == ':' ||
         c == '.' || c == '-' || c == '+';
}

/// One part of the file.
struct Range {
  std::size_t begin = 0, end = 0;
};

/// Values of an attribute: at once, and over time.
struct Attribute {
  std::string type;
  std::optional<Range> value;
  std::map<double, Range> samples;
  std::string interpolation;
};

struct Prim {
  std::string kind, name, type;  ///< "def", "ball", "Mesh"
  std::size_t line = 0;
  std::map<std::string, Attribute, std::less<>> attributes;
  std::vector<Prim> children;
};

/// Reads the layer's structure; numbers stay where they are in the text.
class Parser {
 public:
  Parser(std::string_view text, const std::string& name) : text_(text), name_(name) {}

  /// The layer's own metadata, as attributes; and its prims.
  Prim read() {
    Prim layer;
    skip();
    if (peek() == '(') read_metadata(layer);
    while (skip(), at_ < text_.size()) layer.children.push_back(read_prim(0));
    return layer;
  }

 private:
  [[noreturn]] void fail(const std::string& message) const {
    const auto line =
        1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(std::min(at_, text_.size())), '\n');
    throw_invalid_argument(name_ + ":" + std::to_string(line) + ": " + message);
  }
  char peek() const { return at_ < text_.size() ? text_[at_] : '\0'; }
  void skip() {
    while (at_ < text_.size()) {
      if (is_space(text_[at_]) || text_[at_] == ';') {
        ++at_;
      } else if (text_[at_] == '#') {
        while (at_ < text_.size() && text_[at_] != '\n') ++at_;
      } else {
        return;
      }
    }
  }
  void expect(char c) {
    skip();
    if (peek() != c) fail(std::string("expected '") + c + "'");
    ++at_;
  }
  std::string word() {
    skip();
    const std::size_t begin = at_;
    while (at_ < text_.size() && is_word(text_[at_])) ++at_;
    if (at_ == begin) fail(at_ < text_.size() ? std::string("unexpected '") + text_[at_] + "'" : "ends too early");
    return std::string(text_.substr(begin, at_ - begin));
  }
  std::string quoted() {
    skip();
    const Range range = skip_value();
    if (range.end < range.begin + 2) fail("expected a name in quotes");
    return std::string(text_.substr(range.begin + 1, range.end - range.begin - 2));
  }

  void skip_quoted(char quote) {
    const bool triple = text_.substr(at_, 3) == std::string(3, quote);
    const std::size_t length = triple ? 3 : 1;
    at_ += length;
    while (at_ < text_.size()) {
      if (text_[at_] == '\\') {
        at_ += 2;
      } else if (text_.substr(at_, length) == std::string(length, quote)) {
        at_ += length;
        return;
      } else {
        ++at_;
      }
    }
    fail("a text without its end");
  }

  /// One value: a number, a word, a text, an asset, a path, or brackets with all in them.
  Range skip_value() {
    skip();
    const std::size_t begin = at_;
    std::size_t open = 0;
    do {
      const char c = peek();
      if (at_ >= text_.size()) fail("ends within a value");
      if (c == '"' || c == '\'') {
        skip_quoted(c);
      } else if (c == '@') {
        const auto end =
            text_.find(text_.substr(at_, 3) == "@@@" ? "@@@" : "@", at_ + (text_.substr(at_, 3) == "@@@" ? 3 : 1));
        if (end == std::string_view::npos) fail("an asset without its end");
        at_ = end + (text_.substr(at_, 3) == "@@@" ? 3 : 1);
      } else if (c == '<') {
        const auto end = text_.find('>', at_);
        if (end == std::string_view::npos) fail("a path without its end");
        at_ = end + 1;
      } else if (c == '(' || c == '[' || c == '{') {
        ++open;
        ++at_;
      } else if (c == ')' || c == ']' || c == '}') {
        if (open == 0) fail(std::string("unexpected '") + c + "'");
        --open;
        ++at_;
      } else if (c == '#') {
        skip();
      } else if (open > 0 && !is_word(c)) {
        ++at_;
      } else if (is_word(c)) {
        while (at_ < text_.size() && is_word(text_[at_])) ++at_;
      } else {
        fail(std::string("unexpected '") + c + "'");
      }
    } while (open > 0);
    return {begin, at_};
  }

  /// "( key = value ... )": strings and entries of lists are skipped as they are.
  void read_metadata(Prim& prim) {
    expect('(');
    while (skip(), peek() != ')') {
      if (peek() == '"' || peek() == '\'') {
        skip_value();
        continue;
      }
      std::string key = word();
      skip();
      if (peek() != '=') {  // "prepend references = ...", "string key = ..."
        key = word();
        skip();
      }
      expect('=');
      prim.attributes[key].value = skip_value();
    }
    ++at_;
  }

  Prim read_prim(int depth) {
    if (depth > kMaxDepth) fail("prims nested too deeply");
    Prim prim;
    prim.line = at_;
    prim.kind = word();
    if (prim.kind != "def" && prim.kind != "over" && prim.kind != "class")
      fail("expected a prim, not '" + prim.kind.substr(0, 40) + "'");
    skip();
    if (peek() != '"') prim.type = word();
    prim.name = quoted();
    skip();
    if (peek() == '(') {
      Prim metadata;
      read_metadata(metadata);
    }
    expect('{');
    while (skip(), peek() != '}') read_member(prim, depth);
    ++at_;
    return prim;
  }

  void read_member(Prim& prim, int depth) {
    const std::size_t begin = at_;
    std::string first = word();
    if (first == "def" || first == "over" || first == "class") {
      at_ = begin;
      prim.children.push_back(read_prim(depth + 1));
      return;
    }
    if (first == "variantSet") {
      quoted();
      expect('=');
      skip_value();
      return;
    }
    if (first == "reorder") {
      word();
      expect('=');
      skip_value();
      return;
    }
    // [prepend ...] [custom] [uniform] type[[]] name[.timeSamples] [= value] [(metadata)]
    std::string type, name = first;
    while (true) {
      skip();
      if (peek() == '[' && text_.substr(at_, 2) == "[]") {
        name += "[]";
        at_ += 2;
        continue;
      }
      if (peek() == '=' || peek() == '(' || peek() == '}' || !is_word(peek())) break;
      // Of "float radius" + newline + "float size" the name ends the statement.
      if (!type.empty() && type != "custom" && type != "uniform" && type != "varying" && type != "prepend" &&
          type != "append" && type != "delete" && type != "add") {
        break;
      }
      type = name;
      name = word();
    }
    bool sampled = false;
    if (constexpr std::string_view kSuffix = ".timeSamples"; name.ends_with(kSuffix)) {
      name.resize(name.size() - kSuffix.size());
      sampled = true;
    }
    Attribute& attribute = prim.attributes[name];
    attribute.type = type;
    if (peek() == '=') {
      ++at_;
      if (sampled) {
        read_samples(attribute);
      } else {
        attribute.value = skip_value();
      }
    }
    skip();
    if (peek() == '(') {
      Prim metadata;
      read_metadata(metadata);
      if (const auto found = metadata.attributes.find("interpolation"); found != metadata.attributes.end()) {
        const Range range = *found->second.value;
        if (range.end > range.begin + 2)
          attribute.interpolation = text_.substr(range.begin + 1, range.end - range.begin - 2);
      }
    }
  }

  void read_samples(Attribute& attribute) {
    expect('{');
    while (skip(), peek() != '}') {
      const std::size_t begin = at_;
      while (at_ < text_.size() && is_word(text_[at_]) && text_[at_] != ':') ++at_;
      const std::string time(text_.substr(begin, at_ - begin));
      double value = 0;
      if (std::from_chars(time.data(), time.data() + time.size(), value).ec != std::errc{} || !std::isfinite(value))
        fail("a sample at '" + time.substr(0, 40) + "'");
      expect(':');
      const Range range = skip_value();
      if (text_.substr(range.begin, range.end - range.begin) != "None") attribute.samples[value] = range;
      skip();
      if (peek() == ',') ++at_;
    }
    ++at_;
  }

  std::string_view text_;
  const std::string& name_;
  std::size_t at_ = 0;
};

/// One `Mesh` prim.
struct Part {
  std::string name;
  Attribute points;
  Eigen::Affine3d place;
  std::size_t count = 0;
};

class UsdMesh final : public AnimatedMesh {
 public:
  explicit UsdMesh(const fs::path& path) : name_(path.string()) {
    std::error_code ignored;
    if (!fs::is_regular_file(path, ignored)) throw_not_found(name_ + ": can't be read");
    refuse_binary(path);
    text_ = read_text_file(path, kMaxBytes);
    if (!text_.starts_with("#usda")) throw_invalid_argument(name_ + ": not USD text, which begins with #usda");
    const Prim layer = Parser(text_, name_).read();
    double metres = 0.01, rate = 24;
    if (const auto given = number_of(layer, "metersPerUnit")) metres = *given;
    if (const auto given = number_of(layer, "timeCodesPerSecond")) {
      rate = *given;
    } else if (const auto frames = number_of(layer, "framesPerSecond")) {
      rate = *frames;
    }
    if (!(metres > 0) || !(rate > 0) || !std::isfinite(metres) || !std::isfinite(rate))
      fail("its units are not above 0");
    Eigen::Affine3d stage(Eigen::Scaling(metres));
    if (word_of(layer, "upAxis") == "Z")
      stage.rotate(Eigen::AngleAxisd(-std::numbers::pi / 2, Eigen::Vector3d::UnitX()));
    for (const Prim& prim : layer.children) visit(prim, stage);
    if (parts_.empty()) fail("no Mesh in it");
    std::vector<double> keys;
    for (const Part& part : parts_) {
      for (const auto& [time, range] : part.points.samples) keys.push_back(time);
    }
    times_ = detail::even_times(std::move(keys), name_);
    frame_time_s_ = times_.step / rate;
    const Positions first = positions(0);
    mesh_.positions.assign(first.data(), first.data() + first.size());
  }

  const PolygonMesh& mesh() const override { return mesh_; }
  std::size_t frame_count() const override { return times_.count; }
  double frame_time_s() const override { return frame_time_s_; }

  Positions positions(std::size_t frame) const override {
    if (frame >= times_.count) fail("no frame " + std::to_string(frame) + " of " + std::to_string(times_.count));
    const double time = times_.first + static_cast<double>(frame) * times_.step;
    Positions out(static_cast<Eigen::Index>(vertices_), 3);
    Eigen::Index begin = 0;
    for (const Part& part : parts_) {
      const auto count = static_cast<Eigen::Index>(part.count);
      const std::vector<float> points = points_at(part, time);
      const Eigen::Map<const Positions> rows(points.data(), count, 3);
      out.middleRows(begin, count) =
          ((rows.cast<double>() * part.place.linear().transpose()).rowwise() + part.place.translation().transpose())
              .cast<float>();
      begin += count;
    }
    if (!all_finite(out)) fail("frame " + std::to_string(frame) + " is not finite");
    return out;
  }

 private:
  [[noreturn]] void fail(const std::string& message) const { throw_invalid_argument(name_ + ": " + message); }

  void refuse_binary(const fs::path& path) const {
    std::ifstream stream(path, std::ios::binary);
    std::string magic(8, '\0');
    if (stream.read(magic.data(), 8) && magic == "PXR-USDC") fail("is binary USD; save it as text (.usda)");
  }

  /// All numbers in a value, whatever brackets are around them.
  template <class T>
  std::vector<T> numbers(const Range& range, std::size_t most, const std::string& what) const {
    std::vector<T> values;
    const char* at = text_.data() + range.begin;
    const char* const end = text_.data() + range.end;
    while (at < end) {
      if (is_space(*at) || *at == '(' || *at == ')' || *at == '[' || *at == ']' || *at == ',' || *at == '+') {
        ++at;
        continue;
      }
      if (*at == '#') {
        while (at < end && *at != '\n') ++at;
        continue;
      }
      T value{};
      const auto [next, error] = std::from_chars(at, end, value);
      if (error != std::errc{}) fail(what + ": not a number: '" + std::string(at, std::min(at + 20, end)) + "'");
      if (values.size() == most)
        throw Error(ErrorCode::kResourceExhausted,
                    name_ + ": " + what + " has more than " + std::to_string(most) + " values");
      values.push_back(value);
      at = next;
    }
    return values;
  }

  const Attribute* find(const Prim& prim, std::string_view name) const {
    const auto found = prim.attributes.find(name);
    return found == prim.attributes.end() ? nullptr : &found->second;
  }
  std::optional<double> number_of(const Prim& prim, std::string_view name) const {
    const Attribute* attribute = find(prim, name);
    if (attribute == nullptr || !attribute->value) return std::nullopt;
    const auto values = numbers<double>(*attribute->value, 16, std::string(name));
    return values.empty() ? std::nullopt : std::optional(values[0]);
  }
  /// Without its quotes.
  std::string word_of(const Prim& prim, std::string_view name) const {
    const Attribute* attribute = find(prim, name);
    if (attribute == nullptr || !attribute->value) return {};
    std::string word = text_.substr(attribute->value->begin, attribute->value->end - attribute->value->begin);
    std::erase_if(word, [](char c) { return c == '"' || c == '\''; });
    return word;
  }

  Eigen::Affine3d local_transform(const Prim& prim) const {
    Eigen::Affine3d transform = Eigen::Affine3d::Identity();
    const Attribute* order = find(prim, "xformOpOrder");
    if (order == nullptr || !order->value) return transform;
    const std::string list = text_.substr(order->value->begin, order->value->end - order->value->begin);
    for (std::size_t at = list.find('"'); at != std::string::npos; at = list.find('"', at)) {
      const std::size_t end = list.find('"', at + 1);
      if (end == std::string::npos) break;
      const std::string op = list.substr(at + 1, end - at - 1);
      at = end + 1;
      if (op == "!resetXformStack!") {
        fail("prim '" + prim.name + "': !resetXformStack! is not read");
      }
      const bool inverse = op.starts_with("!invert!");
      const std::string name = inverse ? op.substr(8) : op;
      const Attribute* attribute = find(prim, name);
      if (attribute == nullptr) continue;
      if (!attribute->samples.empty())
        fail("prim '" + prim.name + "' is animated as a whole (" + name + "); bake its frames into the points");
      if (!attribute->value) continue;
      const Eigen::Affine3d step = operation(name, numbers<double>(*attribute->value, 16, name));
      transform = transform * (inverse ? step.inverse() : step);
    }
    return transform;
  }

  Eigen::Affine3d operation(const std::string& name, const std::vector<double>& v) const {
    const auto kind = name.substr(0, name.find(':', std::string("xformOp:").size()));
    const auto turn = [&](double degrees, const Eigen::Vector3d& axis) {
      return Eigen::AngleAxisd(degrees * std::numbers::pi / 180, axis);
    };
    const auto needs = [&](std::size_t count) {
      if (v.size() != count) fail(name + " has " + std::to_string(v.size()) + " values");
    };
    if (kind == "xformOp:transform") {
      needs(16);
      Eigen::Affine3d transform;
      transform.matrix() = Eigen::Map<const Eigen::Matrix4d>(v.data());  // rows of USD's are columns of ours
      return transform;
    }
    if (kind == "xformOp:translate") {
      needs(3);
      return Eigen::Affine3d(Eigen::Translation3d(v[0], v[1], v[2]));
    }
    if (kind == "xformOp:scale") {
      needs(3);
      return Eigen::Affine3d(Eigen::Scaling(v[0], v[1], v[2]));
    }
    if (kind == "xformOp:orient") {
      needs(4);
      return Eigen::Affine3d(Eigen::Quaterniond(v[0], v[1], v[2], v[3]).normalized());
    }
    constexpr std::string_view kRotate = "xformOp:rotate";
    if (kind.starts_with(kRotate)) {
      const std::string axes = kind.substr(kRotate.size());
      needs(axes.size());
      Eigen::Affine3d transform = Eigen::Affine3d::Identity();
      for (std::size_t i = 0; i < axes.size(); ++i) {
        if (axes[i] < 'X' || axes[i] > 'Z') fail("unknown " + name);
        const Eigen::Index axis = axes[i] - 'X';
        // The first of the axes is turned about first. The values are x, y, z in any order of the axes.
        const double degrees = v[axes.size() == 1 ? 0 : static_cast<std::size_t>(axis)];
        transform = Eigen::Affine3d(turn(degrees, Eigen::Vector3d::Unit(axis))) * transform;
      }
      return transform;
    }
    fail("unknown " + name);
  }

  void visit(const Prim& prim, const Eigen::Affine3d& above) {
    if (prim.kind == "class" || word_of(prim, "visibility") == "invisible") return;
    const Eigen::Affine3d place = above * local_transform(prim);
    if (prim.type == "Mesh" && prim.kind == "def") add_mesh(prim, place);
    for (const Prim& child : prim.children) visit(child, place);
  }

  void add_mesh(const Prim& prim, const Eigen::Affine3d& place) {
    const std::string what = "Mesh '" + prim.name + "'";
    Part part;
    part.name = prim.name;
    part.place = place;
    const Attribute *points = find(prim, "points"), *counts = find(prim, "faceVertexCounts"),
                    *indices = find(prim, "faceVertexIndices");
    for (const Attribute* needed : {counts, indices}) {
      if (needed == nullptr || (!needed->value && needed->samples.empty())) fail(what + " has no faces");
      if (needed->samples.size() > 1) fail(what + ": its faces change over time");
    }
    if (points == nullptr || (!points->value && points->samples.empty())) fail(what + " has no points");
    if (find(prim, "skel:skeleton") != nullptr || find(prim, "primvars:skel:jointIndices") != nullptr)
      fail(what + " is moved by a skeleton; bake its frames into the points");
    part.points = *points;
    part.count = values_at(part.points, 0, what).size() / 3;
    if (vertices_ + part.count > kMaxVertices)
      throw Error(ErrorCode::kResourceExhausted, name_ + ": more than " + std::to_string(kMaxVertices) + " vertices");
    const auto only = [](const Attribute& a) { return a.value ? *a.value : a.samples.begin()->second; };
    const auto sizes = numbers<std::uint32_t>(only(*counts), kMaxCorners, what + ": faceVertexCounts");
    const auto corners = numbers<std::uint32_t>(only(*indices), kMaxCorners, what + ": faceVertexIndices");

    // Material coordinates: `st`, else the first of their type.
    const Attribute* st = find(prim, "primvars:st");
    std::string st_name = "primvars:st";
    for (const auto& [name, attribute] : prim.attributes) {
      if (st == nullptr && attribute.type.starts_with("texCoord2") && name.starts_with("primvars:")) {
        st = &attribute;
        st_name = name;
      }
    }
    std::vector<float> uv;
    std::vector<std::uint32_t> uv_indices;
    if (st != nullptr && (st->value || !st->samples.empty())) {
      uv = numbers<float>(only(*st), 2 * kMaxCorners, what + ": " + st_name);
      if (const Attribute* given = find(prim, st_name + ":indices"); given != nullptr && given->value)
        uv_indices = numbers<std::uint32_t>(*given->value, kMaxCorners, what + ": " + st_name + ":indices");
    }
    const bool by_vertex =
        st != nullptr && st->interpolation != "faceVarying" &&
        (st->interpolation == "vertex" || st->interpolation == "varying" || uv.size() == 2 * part.count);
    const bool left_handed = word_of(prim, "orientation") == "leftHanded";
    append_faces(mesh_,
                 {.file = name_,
                  .mesh = what,
                  .sizes = sizes,
                  .vertices = corners,
                  .vertex_count = part.count,
                  .uv = uv,
                  .uv_indices = uv_indices,
                  .uv_by_vertex = by_vertex,
                  .clockwise = left_handed != (place.linear().determinant() < 0)},
                 vertices_);
    vertices_ += part.count;
    parts_.push_back(std::move(part));
  }

  std::vector<float> checked(const Range& range, const std::string& what) const {
    std::vector<float> values = numbers<float>(range, 3 * kMaxVertices, what + ": points");
    if (values.empty() || values.size() % 3 != 0) fail(what + ": points are not in threes");
    return values;
  }

  /// Linear between samples, constant before and after.
  std::vector<float> values_at(const Attribute& points, double time, const std::string& what) const {
    if (points.samples.empty()) return checked(*points.value, what);
    constexpr double kSame = 1e-3;  // of a frame
    const auto after = points.samples.upper_bound(time + kSame * times_.step);
    if (after == points.samples.begin()) return checked(after->second, what);
    const auto before = std::prev(after);
    std::vector<float> values = checked(before->second, what);
    const double part = after == points.samples.end() ? 0 : (time - before->first) / (after->first - before->first);
    if (part < kSame) return values;
    const std::vector<float> next = checked(after->second, what);
    if (next.size() != values.size()) fail(what + ": the number of its points changes over time");
    for (std::size_t i = 0; i < values.size(); ++i) values[i] += static_cast<float>(part) * (next[i] - values[i]);
    return values;
  }
  std::vector<float> points_at(const Part& part, double time) const {
    const std::string what = "Mesh '" + part.name + "'";
    std::vector<float> values = values_at(part.points, time, what);
    if (values.size() != 3 * part.count) fail(what + ": the number of its points changes over time");
    return values;
  }

  std::string name_;
  std::string text_;
  std::vector<Part> parts_;
  std::size_t vertices_ = 0;
  detail::FrameTimes times_;
  double frame_time_s_ = 0;
  PolygonMesh mesh_;
};

}  // namespace

std::unique_ptr<AnimatedMesh> open_usd_text(const fs::path& path) { return std::make_unique<UsdMesh>(path); }

}  // namespace pleat
