#include "common/mesh/obj.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <streambuf>
#include <string_view>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/text_file.hpp"
#include "common/base/whole_file.hpp"
#include "common/mesh/polygons.hpp"

namespace pleat {
namespace {

/// Lines as the format means them: ends of line of any system, a backslash at the end joins the next one, comments are
/// no lines, marks of byte order are no characters.
class LogicalLines {
 public:
  LogicalLines(std::istream& stream, const std::string& name) : buffer_(*stream.rdbuf()), name_(name) {}

  /// False at the end of the file. number(): of the physical line that it begins in.
  bool next(std::string& line) {
    line.clear();
    begin_ = end_ + 1;
    while (physical(line)) {
      ++end_;
      const auto last = line.find_last_not_of(" \t");
      if (last == std::string::npos || line[last] != '\\' || is_comment(line)) return true;
      line.resize(last);
      line += ' ';
    }
    return !line.empty();
  }
  std::size_t number() const { return begin_; }

 private:
  static bool is_comment(const std::string& line) {
    const auto first = line.find_first_not_of(" \t");
    return first != std::string::npos && line[first] == '#';
  }

  /// Appends a line of the file; false if there is none.
  bool physical(std::string& line) {
    const std::size_t start = line.size();
    int c = buffer_.sbumpc();
    if (c == EOF) return false;
    for (; c != EOF && c != '\n' && c != '\r'; c = buffer_.sbumpc()) line += static_cast<char>(c);
    if (c == '\r' && buffer_.sgetc() == '\n') buffer_.sbumpc();
    if (end_ == 0) check_text(line, name_);
    while (std::string_view(line).substr(start).starts_with(kByteOrderMark)) line.erase(start, kByteOrderMark.size());
    return true;
  }

  std::streambuf& buffer_;
  const std::string& name_;
  std::size_t begin_ = 0, end_ = 0;
};

class Reader {
 public:
  Reader(std::istream& stream, std::string name, const ObjLimits& limits)
      : name_(std::move(name)), lines_(stream, name_), limits_(limits) {}

  PolygonMesh read() {
    std::string line;
    while (lines_.next(line)) {
      rest_ = line;
      const std::string_view keyword = next_word();
      if (keyword == "v") {
        read_floats(3, 3, out_.positions);
        check_limit(out_.positions.size() / 3, limits_.max_vertices, "vertices");
      } else if (keyword == "vt") {
        read_floats(2, 1, out_.uv);
        check_limit(out_.uv.size() / 2, limits_.max_vertices, "material coordinates");
      } else if (keyword == "f" || keyword == "fo") {
        read_face();
      } else if (keyword == "o" || keyword == "g") {
        object_ = next_word();
      } else {
        check_ignored(keyword);
      }
    }
    return std::move(out_);
  }

 private:
  [[noreturn]] void fail(const std::string& message) const {
    throw_invalid_argument(name_ + ":" + std::to_string(lines_.number()) + ": " + message);
  }

  void check_limit(std::size_t count, std::size_t limit, const char* what) const {
    if (count > limit) {
      throw Error(ErrorCode::kResourceExhausted,
                  name_ + ":" + std::to_string(lines_.number()) + ": more than " + std::to_string(limit) + " " + what);
    }
  }

  /// PolygonMesh that say nothing about the shape are words. Anything else is a damaged line, and what it said is lost.
  void check_ignored(std::string_view keyword) const {
    if (keyword.empty() || keyword.front() == '#') return;
    const auto is_letter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); };
    const auto in_word = [&](char c) { return is_letter(c) || (c >= '0' && c <= '9') || c == '_' || c == '-'; };
    const bool is_word = is_letter(keyword.front()) && std::all_of(keyword.begin(), keyword.end(), in_word);
    const bool is_data = keyword == "V" || keyword == "F" || keyword == "VT";
    const bool runs_on = keyword.size() > 1 && (keyword[0] == 'v' || keyword[0] == 'f') && !is_letter(keyword[1]);
    if (is_word && !is_data && !runs_on) return;
    fail("expected a statement, found '" + std::string(keyword.substr(0, 40)) + "'");
  }

  std::string_view next_word() {
    const auto begin = rest_.find_first_not_of(" \t");
    if (begin == std::string_view::npos) return rest_ = {};
    auto end = rest_.find_first_of(" \t", begin);
    if (end == std::string_view::npos) end = rest_.size();
    const std::string_view word = rest_.substr(begin, end - begin);
    rest_.remove_prefix(end);
    return word;
  }

  /// `count` numbers, of which all but the first `needed` may be absent and are then 0.
  void read_floats(int count, int needed, std::vector<float>& out) {
    for (int i = 0; i < count; ++i) {
      std::string_view word = next_word();
      if (word.empty() && i >= needed) {
        out.push_back(0);
        continue;
      }
      const bool sign = word.size() > 1 && word.front() == '+' && word[1] != '-';
      if (sign) word.remove_prefix(1);
      double value = 0;  // numbers too small for a float are zero
      const auto result = std::from_chars(word.data(), word.data() + word.size(), value);
      const auto narrow = static_cast<float>(value);
      if (word.empty() || result.ec != std::errc{} || result.ptr != word.data() + word.size() ||
          (std::isfinite(value) && !std::isfinite(narrow))) {
        fail("expected a number, found '" + std::string(word.substr(0, 40)) + "'");
      }
      if (!std::isfinite(narrow)) fail("a coordinate is not finite");
      out.push_back(narrow);
    }
  }

  // One index of a corner; `count` elements have been read so far, negative indices count back from there.
  std::uint32_t read_index(std::string_view text, std::size_t count, const char* what) const {
    long long value = 0;
    const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
    if (text.empty() || result.ec != std::errc{} || result.ptr != text.data() + text.size()) {
      fail("expected an index, found '" + std::string(text.substr(0, 40)) + "'");
    }
    if (value == 0) fail(std::string(what) + " index 0 (indices start at 1)");
    const long long index = value > 0 ? value - 1 : static_cast<long long>(count) + value;
    // A positive index may point forward in the file: checked at the end. The format's relative ones can't.
    if (index < 0 || index >= PolygonMesh::kNoUv)
      fail(std::string(what) + " index " + std::to_string(value) + " is out of range");
    return static_cast<std::uint32_t>(index);
  }

  void read_face() {
    std::vector<PolygonMesh::Corner>& corners = out_.corners;
    const std::size_t begin = corners.size();
    for (std::string_view word = next_word(); !word.empty() && word.front() != '#'; word = next_word()) {
      const auto slash = word.find('/');
      PolygonMesh::Corner corner{read_index(word.substr(0, slash), out_.positions.size() / 3, "vertex"),
                                 PolygonMesh::kNoUv};
      if (slash != std::string_view::npos) {
        const std::string_view after = word.substr(slash + 1);
        const std::string_view uv = after.substr(0, after.find('/'));
        if (!uv.empty()) corner.uv = read_index(uv, out_.uv.size() / 2, "material coordinate");
      }
      if (corner.uv == PolygonMesh::kNoUv && out_.without_uv.empty()) {
        out_.without_uv = "line " + std::to_string(lines_.number());
        if (!object_.empty()) out_.without_uv += ", object '" + object_.substr(0, 60) + "'";
      }
      // A corner that comes twice in a row bounds nothing.
      if (corners.size() == begin || corners.back().vertex != corner.vertex) corners.push_back(corner);
    }
    if (corners.size() > begin + 1 && corners.back().vertex == corners[begin].vertex) corners.pop_back();
    if (corners.size() < begin + 3) {
      fail("a face with " + std::to_string(corners.size() - begin) + " different corners");
    }
    out_.ends.push_back(corners.size());
    out_.places.push_back(static_cast<std::uint32_t>(lines_.number()));
    check_limit(corners.size() - 2 * out_.ends.size(), limits_.max_faces, "faces");
  }

  std::string name_;
  LogicalLines lines_;
  ObjLimits limits_;
  std::string_view rest_;
  std::string object_;
  PolygonMesh out_;
};

std::ifstream open_obj(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  std::error_code ignored;
  if (!stream || std::filesystem::is_directory(path, ignored)) throw_not_found(path.string() + ": can't be read");
  return stream;
}

}  // namespace

Topology read_obj(std::istream& stream, const std::string& name, MeshUse use, const ObjLimits& limits) {
  return to_topology(Reader(stream, name, limits).read(), name, use);
}

Topology read_obj(const std::filesystem::path& path, MeshUse use, const ObjLimits& limits) {
  std::ifstream stream = open_obj(path);
  return read_obj(stream, path.string(), use, limits);
}

Positions read_obj_frame(const std::filesystem::path& path, const Topology& rest, const ObjLimits& limits) {
  std::ifstream stream = open_obj(path);
  return to_frame(Reader(stream, path.string(), limits).read(), rest, path.string());
}

void write_obj(const std::filesystem::path& path, const Topology& topology) {
  write_obj(path, topology, topology.rest_positions);
}

void write_obj(const std::filesystem::path& path, const Topology& topology, const Positions& positions,
               std::string_view comment) {
  if (positions.rows() != topology.vertex_count()) {
    throw_invalid_argument(path.string() + ": " + std::to_string(positions.rows()) + " positions for a mesh of " +
                           std::to_string(topology.vertex_count()) + " vertices");
  }
  WholeFile file(path);
  file.write(kObjMark);
  file.write("\n");
  file.write(comment);
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    std::fprintf(file.stream(), "v %.9g %.9g %.9g\n", static_cast<double>(positions(v, 0)),
                 static_cast<double>(positions(v, 1)), static_cast<double>(positions(v, 2)));
  }
  for (Eigen::Index u = 0; u < topology.uv.rows(); ++u) {
    std::fprintf(file.stream(), "vt %.9g %.9g\n", static_cast<double>(topology.uv(u, 0)),
                 static_cast<double>(topology.uv(u, 1)));
  }
  const bool with_uv = topology.uv_faces.rows() > 0;
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) {
    std::fputc('f', file.stream());
    for (int k = 0; k < 3; ++k) {
      if (with_uv) {
        std::fprintf(file.stream(), " %u/%u", topology.faces(f, k) + 1, topology.uv_faces(f, k) + 1);
      } else {
        std::fprintf(file.stream(), " %u", topology.faces(f, k) + 1);
      }
    }
    std::fputc('\n', file.stream());
  }
  file.commit();
}

}  // namespace pleat
