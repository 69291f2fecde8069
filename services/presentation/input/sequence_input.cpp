#include "services/presentation/input/sequence_input.hpp"

#include <glob.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cctype>
#include <charconv>
#include <cstring>
#include <fstream>
#include <optional>

#include "common/base/error.hpp"
#include "common/mesh/obj.hpp"
#include "common/store/dataset.hpp"
#include "common/store/result.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "PC2 is read as it lies in the file");

constexpr std::size_t kPointCacheHeader = 32;
constexpr std::int32_t kMaxPoints = 4'000'000;

void check_finite(const Positions& positions, const std::string& what) {
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    if (!positions.row(v).allFinite())
      throw_invalid_argument(what + ": vertex " + std::to_string(v) + " is not finite");
  }
}

void check_vertex_count(Eigen::Index count, const Topology& rest, const std::string& what) {
  if (count != rest.vertex_count())
    throw_invalid_argument(what + " has " + std::to_string(count) + " vertices, the rest mesh " +
                           std::to_string(rest.vertex_count()));
}

class ObjSequence final : public FrameSequence {
 public:
  ObjSequence(std::vector<fs::path> files, const Topology& rest) : files_(std::move(files)), rest_(rest) {
    positions(0);  // a wrong first frame is worth an error before services start
  }
  std::size_t frame_count() const override { return files_.size(); }
  Positions positions(std::size_t frame) const override { return read_obj_frame(files_.at(frame), rest_); }

 private:
  std::vector<fs::path> files_;
  Topology rest_;
};

class PointCacheSequence final : public FrameSequence {
 public:
  PointCacheSequence(const fs::path& path, const Topology& rest) : cache_(path) {
    check_vertex_count(cache_.point_count(), rest, path.string());
  }
  std::size_t frame_count() const override { return cache_.sample_count(); }
  Positions positions(std::size_t frame) const override { return cache_.sample(frame); }

 private:
  PointCache cache_;
};

class ResultSequence final : public FrameSequence {
 public:
  ResultSequence(const fs::path& path, const Topology& rest) : path_(path), reader_(path) {
    check_vertex_count(reader_.info().topology.coarse.vertex_count(), rest, path.string());
  }
  std::size_t frame_count() const override { return reader_.frames_complete(); }
  Positions positions(std::size_t frame) const override {
    Positions positions = std::move(reader_.coarse(frame, frame + 1).at(0));
    check_finite(positions, path_.string() + " frame " + std::to_string(frame));
    return positions;
  }
  std::vector<ObstacleShape> obstacle_shapes() const override { return reader_.info().obstacles; }
  std::vector<ObstacleFrame> obstacles(std::size_t frame) const override {
    return std::move(reader_.obstacles(frame, frame + 1).at(0));
  }
  double frame_time_s() const override { return reader_.info().frame_time_s; }

 private:
  fs::path path_;
  ResultReader reader_;
};

class DatasetSequence final : public FrameSequence {
 public:
  DatasetSequence(const fs::path& folder, const std::string& name, const Topology& rest)
      : reader_(folder), name_(name) {
    check_vertex_count(reader_.topology().coarse.vertex_count(), rest, folder.string());
    for (SequenceInfo& info : reader_.sequences())
      if (info.name == name) info_ = std::move(info);
    if (info_.name.empty()) throw_not_found(folder.string() + " has no sequence '" + name + "'");
  }
  std::size_t frame_count() const override { return info_.frames_complete; }
  Positions positions(std::size_t frame) const override {
    Positions positions = std::move(reader_.coarse(name_, frame, frame + 1).at(0));
    check_finite(positions, "sequence " + name_ + " frame " + std::to_string(frame));
    return positions;
  }
  std::vector<ObstacleShape> obstacle_shapes() const override { return info_.obstacles; }
  std::vector<ObstacleFrame> obstacles(std::size_t frame) const override {
    return std::move(reader_.obstacles(name_, frame, frame + 1).at(0));
  }
  double frame_time_s() const override { return reader_.master().frame_time_s; }

 private:
  DatasetReader reader_;
  std::string name_;
  SequenceInfo info_;
};

std::string lower_extension(const fs::path& path) {
  std::string extension = path.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return extension;
}

std::vector<fs::path> files_of_folder(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder))
    if (entry.is_regular_file() && lower_extension(entry.path()) == ".obj") files.push_back(entry.path());
  if (files.empty()) throw_not_found(folder.string() + ": no .obj file in this folder");
  return files;
}

std::vector<fs::path> files_of_glob(const std::string& pattern) {
  glob_t found{};
  const int status = ::glob(pattern.c_str(), GLOB_TILDE, nullptr, &found);
  std::vector<fs::path> files(found.gl_pathv, found.gl_pathv + (status == 0 ? found.gl_pathc : 0));
  ::globfree(&found);
  if (files.empty()) throw_not_found(pattern + ": no file matches");
  return files;
}

/// A printf pattern, taken apart: the text never reaches printf.
struct NumberPattern {
  std::string before, after;
};

std::optional<NumberPattern> parse_number_pattern(const std::string& source) {
  const auto percent = source.find('%');
  if (percent == std::string::npos) return std::nullopt;
  auto end = percent + 1;
  while (end < source.size() && std::isdigit(static_cast<unsigned char>(source[end])) != 0) ++end;
  if (end >= source.size() || source[end] != 'd' || source.find('%', end) != std::string::npos)
    throw_invalid_argument(source + ": a frame pattern needs exactly one %d, as in cloth_%04d.obj");
  return NumberPattern{source.substr(0, percent), source.substr(end + 1)};
}

std::vector<fs::path> files_of_pattern(const std::string& source, const NumberPattern& pattern) {
  const fs::path before = pattern.before;
  const fs::path folder = before.parent_path().empty() ? fs::path(".") : before.parent_path();
  const std::string prefix = before.filename().string();
  if (pattern.after.find('/') != std::string::npos)
    throw_invalid_argument(source + ": the frame number must be in the file's name, not in a folder's");
  if (!fs::is_directory(folder)) throw_not_found(folder.string() + ": no such folder");
  std::vector<std::pair<std::uint64_t, fs::path>> found;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (name.size() <= prefix.size() + pattern.after.size() || !name.starts_with(prefix) ||
        !name.ends_with(pattern.after))
      continue;
    const char* first = name.data() + prefix.size();
    const char* last = name.data() + name.size() - pattern.after.size();
    std::uint64_t number = 0;
    const auto parsed = std::from_chars(first, last, number);
    if (parsed.ec == std::errc{} && parsed.ptr == last) found.emplace_back(number, entry.path());
  }
  if (found.empty()) throw_not_found(source + ": no file matches");
  std::sort(found.begin(), found.end());
  std::vector<fs::path> files;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (found[i].first != found[0].first + i)
      throw_not_found(source + ": frame " + std::to_string(found[0].first + i) + " is missing");
    files.push_back(found[i].second);
  }
  return files;
}

}  // namespace

bool natural_less(const std::string& a, const std::string& b) {
  std::size_t i = 0, j = 0;
  const auto digit = [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; };
  while (i < a.size() && j < b.size()) {
    if (digit(a[i]) && digit(b[j])) {
      while (i < a.size() && a[i] == '0') ++i;
      while (j < b.size() && b[j] == '0') ++j;
      std::size_t i_end = i, j_end = j;
      while (i_end < a.size() && digit(a[i_end])) ++i_end;
      while (j_end < b.size() && digit(b[j_end])) ++j_end;
      if (i_end - i != j_end - j) return i_end - i < j_end - j;
      const int order = a.compare(i, i_end - i, b, j, j_end - j);
      if (order != 0) return order < 0;
      i = i_end;
      j = j_end;
    } else if (a[i] != b[j]) {
      return a[i] < b[j];
    } else {
      ++i;
      ++j;
    }
  }
  if (i < a.size() || j < b.size()) return j < b.size();
  return a < b;  // "a02" and "a2": some fixed order
}

PointCache::PointCache(const fs::path& path) : path_(path) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream || fs::is_directory(path)) throw_not_found(path.string() + ": can't be read");
  const std::uintmax_t size = fs::file_size(path);
  std::array<char, kPointCacheHeader> header{};
  if (size < header.size() || !stream.read(header.data(), header.size()))
    throw_data_loss(path.string() + ": truncated, " + std::to_string(size) + " bytes are less than a PC2 header");
  if (std::memcmp(header.data(), "POINTCACHE2\0", 12) != 0) throw_invalid_argument(path.string() + ": not a PC2 file");
  const auto integer_at = [&header](std::size_t offset) {
    std::int32_t value = 0;
    std::memcpy(&value, header.data() + offset, sizeof value);
    return value;
  };
  const std::int32_t version = integer_at(12), points = integer_at(16), samples = integer_at(28);
  if (version != 1) throw_invalid_argument(path.string() + ": PC2 version " + std::to_string(version) + ", not 1");
  if (points <= 0 || points > kMaxPoints)
    throw_invalid_argument(path.string() + ": PC2 with " + std::to_string(points) + " points");
  if (samples <= 0) throw_invalid_argument(path.string() + ": PC2 with " + std::to_string(samples) + " samples");
  const auto needed =
      kPointCacheHeader + static_cast<std::uintmax_t>(points) * static_cast<std::uintmax_t>(samples) * 12;
  if (size < needed)
    throw_data_loss(path.string() + ": truncated, " + std::to_string(size) + " bytes instead of " +
                    std::to_string(needed));
  points_ = points;
  samples_ = static_cast<std::size_t>(samples);
}

Positions PointCache::sample(std::size_t index) const {
  if (index >= samples_)
    throw_invalid_argument(path_.string() + ": no sample " + std::to_string(index) + " of " + std::to_string(samples_));
  std::ifstream stream(path_, std::ios::binary);
  Positions positions(points_, 3);
  const auto bytes = static_cast<std::streamsize>(points_) * 12;
  stream.seekg(static_cast<std::streamoff>(kPointCacheHeader) +
               static_cast<std::streamoff>(index) * static_cast<std::streamoff>(bytes));
  if (!stream.read(reinterpret_cast<char*>(positions.data()), bytes))
    throw_data_loss(path_.string() + ": sample " + std::to_string(index) + " can't be read");
  check_finite(positions, path_.string() + " sample " + std::to_string(index));
  return positions;
}

std::unique_ptr<FrameSequence> open_frame_sequence(const std::string& source, const Topology& rest) {
  if (source.empty()) throw_invalid_argument("no frames given");
  const fs::path path = source;
  std::error_code ignored;
  if (fs::is_directory(path, ignored)) {
    if (fs::exists(path / "dataset.h5", ignored))
      throw_invalid_argument(source + ": a data set; name one of its sequences, " + source + "/sequences/NAME.h5");
    auto files = files_of_folder(path);
    std::sort(files.begin(), files.end(),
              [](const fs::path& a, const fs::path& b) { return natural_less(a.string(), b.string()); });
    return std::make_unique<ObjSequence>(std::move(files), rest);
  }
  if (!fs::exists(path, ignored)) {
    if (const auto pattern = parse_number_pattern(source))
      return std::make_unique<ObjSequence>(files_of_pattern(source, *pattern), rest);
    if (source.find_first_of("*?[") != std::string::npos) {
      auto files = files_of_glob(source);
      std::sort(files.begin(), files.end(),
                [](const fs::path& a, const fs::path& b) { return natural_less(a.string(), b.string()); });
      return std::make_unique<ObjSequence>(std::move(files), rest);
    }
    throw_not_found(source + ": no such file or folder");
  }
  const std::string extension = lower_extension(path);
  if (extension == ".obj") return std::make_unique<ObjSequence>(std::vector<fs::path>{path}, rest);
  if (extension == ".pc2") return std::make_unique<PointCacheSequence>(path, rest);
  if (extension == ".h5" || extension == ".hdf5" || extension == ".partial") {
    const fs::path folder = fs::absolute(path).parent_path();
    if (folder.filename() == "sequences" && fs::exists(folder.parent_path() / "dataset.h5", ignored)) {
      fs::path name = path.filename();
      if (extension == ".partial") name = name.stem();
      return std::make_unique<DatasetSequence>(folder.parent_path(), name.stem().string(), rest);
    }
    return std::make_unique<ResultSequence>(path, rest);
  }
  throw_invalid_argument(source + ": frames are read from .obj, .pc2, .h5 and folders of .obj");
}

}  // namespace pleat::presentation
