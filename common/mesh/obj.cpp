#include "common/mesh/obj.hpp"

#include <charconv>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>
#include <string_view>
#include <vector>

#include "common/base/error.hpp"

namespace pleat {
namespace {

struct Corner {
  std::uint32_t vertex;
  std::uint32_t uv;  // kNoUv if absent
};
constexpr std::uint32_t kNoUv = 0xffffffffu;

class Reader {
 public:
  Reader(std::istream& stream, std::string name, const ObjLimits& limits)
      : stream_(stream), name_(std::move(name)), limits_(limits) {}

  Topology read() {
    std::string line;
    while (std::getline(stream_, line)) {
      ++line_;
      rest_ = line;
      const std::string_view keyword = next_word();
      if (keyword == "v") {
        read_floats(3, positions_);
        check_limit(positions_.size() / 3, limits_.max_vertices, "vertices");
      } else if (keyword == "vt") {
        read_floats(2, uv_);
        check_limit(uv_.size() / 2, limits_.max_vertices, "material coordinates");
      } else if (keyword == "f") {
        read_face();
      }
    }
    if (stream_.bad()) throw_data_loss(name_ + ": reading failed after line " + std::to_string(line_));
    return finish();
  }

 private:
  [[noreturn]] void fail(const std::string& message) const {
    throw_invalid_argument(name_ + ":" + std::to_string(line_) + ": " + message);
  }

  void check_limit(std::size_t count, std::size_t limit, const char* what) const {
    if (count > limit) {
      throw Error(ErrorCode::kResourceExhausted,
                  name_ + ":" + std::to_string(line_) + ": more than " + std::to_string(limit) + " " + what);
    }
  }

  std::string_view next_word() {
    const auto begin = rest_.find_first_not_of(" \t\r");
    if (begin == std::string_view::npos) return rest_ = {};
    auto end = rest_.find_first_of(" \t\r", begin);
    if (end == std::string_view::npos) end = rest_.size();
    const std::string_view word = rest_.substr(begin, end - begin);
    rest_.remove_prefix(end);
    return word;
  }

  void read_floats(int count, std::vector<float>& out) {
    for (int i = 0; i < count; ++i) {
      std::string_view word = next_word();
      if (!word.empty() && word.front() == '+') word.remove_prefix(1);
      float value = 0;
      const auto result = std::from_chars(word.data(), word.data() + word.size(), value);
      if (word.empty() || result.ec != std::errc{} || result.ptr != word.data() + word.size()) {
        fail("expected a number, found '" + std::string(word.substr(0, 40)) + "'");
      }
      if (!std::isfinite(value)) fail("a coordinate is not finite");
      out.push_back(value);
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
    if (index < 0 || index >= kNoUv) fail(std::string(what) + " index " + std::to_string(value) + " is out of range");
    return static_cast<std::uint32_t>(index);
  }

  void read_face() {
    polygon_.clear();
    for (std::string_view word = next_word(); !word.empty(); word = next_word()) {
      const auto slash = word.find('/');
      Corner corner{read_index(word.substr(0, slash), positions_.size() / 3, "vertex"), kNoUv};
      if (slash != std::string_view::npos) {
        const std::string_view after = word.substr(slash + 1);
        const std::string_view uv = after.substr(0, after.find('/'));
        if (!uv.empty()) corner.uv = read_index(uv, uv_.size() / 2, "material coordinate");
      }
      (corner.uv == kNoUv ? without_uv_ : with_uv_) = true;
      polygon_.push_back(corner);
    }
    if (polygon_.size() < 3) fail("a face with " + std::to_string(polygon_.size()) + " corners");
    for (std::size_t i = 2; i < polygon_.size(); ++i) {
      for (const Corner& corner : {polygon_[0], polygon_[i - 1], polygon_[i]}) corners_.push_back(corner);
    }
    check_limit(corners_.size() / 3, limits_.max_faces, "faces");
  }

  Topology finish() {
    if (with_uv_ && without_uv_)
      throw_invalid_argument(name_ + ": some face corners have material coordinates (`vt`) and some do not");
    Topology t;
    const auto faces = static_cast<Eigen::Index>(corners_.size() / 3);
    t.rest_positions = Eigen::Map<Positions>(positions_.data(), static_cast<Eigen::Index>(positions_.size() / 3), 3);
    t.faces.resize(faces, 3);
    if (with_uv_) {
      t.uv = Eigen::Map<Uv>(uv_.data(), static_cast<Eigen::Index>(uv_.size() / 2), 2);
      t.uv_faces.resize(faces, 3);
    }
    for (std::size_t i = 0; i < corners_.size(); ++i) {
      t.faces.data()[i] = corners_[i].vertex;
      if (with_uv_) t.uv_faces.data()[i] = corners_[i].uv;
    }
    validate_topology(t, name_);
    return t;
  }

  std::istream& stream_;
  std::string name_;
  ObjLimits limits_;
  std::size_t line_ = 0;
  std::string_view rest_;
  std::vector<float> positions_, uv_;
  std::vector<Corner> corners_, polygon_;
  bool with_uv_ = false, without_uv_ = false;
};

}  // namespace

Topology read_obj(std::istream& stream, const std::string& name, const ObjLimits& limits) {
  return Reader(stream, name, limits).read();
}

Topology read_obj(const std::filesystem::path& path, const ObjLimits& limits) {
  std::ifstream stream(path);
  if (!stream || std::filesystem::is_directory(path)) throw_not_found(path.string() + ": can't be read");
  return read_obj(stream, path.string(), limits);
}

void write_obj(const std::filesystem::path& path, const Topology& topology) {
  write_obj(path, topology, topology.rest_positions);
}

void write_obj(const std::filesystem::path& path, const Topology& topology, const Positions& positions) {
  if (positions.rows() != topology.vertex_count()) {
    throw_invalid_argument(path.string() + ": " + std::to_string(positions.rows()) + " positions for a mesh of " +
                           std::to_string(topology.vertex_count()) + " vertices");
  }
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "w"), &std::fclose);
  if (!file) throw_invalid_argument(path.string() + ": can't be opened for writing");
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    std::fprintf(file.get(), "v %.9g %.9g %.9g\n", static_cast<double>(positions(v, 0)),
                 static_cast<double>(positions(v, 1)), static_cast<double>(positions(v, 2)));
  }
  for (Eigen::Index u = 0; u < topology.uv.rows(); ++u) {
    std::fprintf(file.get(), "vt %.9g %.9g\n", static_cast<double>(topology.uv(u, 0)),
                 static_cast<double>(topology.uv(u, 1)));
  }
  const bool with_uv = topology.uv_faces.rows() > 0;
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) {
    std::fputc('f', file.get());
    for (int k = 0; k < 3; ++k) {
      if (with_uv) {
        std::fprintf(file.get(), " %u/%u", topology.faces(f, k) + 1, topology.uv_faces(f, k) + 1);
      } else {
        std::fprintf(file.get(), " %u", topology.faces(f, k) + 1);
      }
    }
    std::fputc('\n', file.get());
  }
  if (std::fflush(file.get()) != 0 || std::ferror(file.get())) {
    throw Error(ErrorCode::kResourceExhausted, path.string() + ": writing failed (disk full?)");
  }
}

}  // namespace pleat
