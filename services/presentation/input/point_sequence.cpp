#include "services/presentation/input/point_sequence.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <limits>
#include <regex>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/text_file.hpp"
#include "common/mesh/animated_mesh.hpp"
#include "common/mesh/mesh_file.hpp"
#include "common/store/hdf5.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "numbers are turned from the file's order to this one");

constexpr std::uint64_t kMaxPoints = 4'000'000;
constexpr std::uint64_t kMaxFrames = std::numeric_limits<std::int32_t>::max();
constexpr hsize_t kMaxValues = 10'000'000'000;

Positions check_finite(Positions positions, const std::string& name, std::size_t frame) {
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    if (!positions.row(v).allFinite()) {
      throw_invalid_argument(name + " sample " + std::to_string(frame) + ": vertex " + std::to_string(v) +
                             " is not finite");
    }
  }
  return positions;
}

/// Frames of equal size one behind the other in a file.
class FlatFile : public PointSequence {
 public:
  Eigen::Index point_count() const override { return points_; }
  std::size_t frame_count() const override { return frames_; }
  double frame_time_s() const override { return frame_time_s_; }
  std::string warning() const override { return warning_; }

  Positions positions(std::size_t frame) const override {
    if (frame >= frames_) {
      throw_invalid_argument(name_ + ": no sample " + std::to_string(frame) + " of " + std::to_string(frames_));
    }
    std::ifstream stream(name_, std::ios::binary);
    const std::size_t values = 3 * static_cast<std::size_t>(points_);
    std::vector<char> bytes(values * width_);
    stream.seekg(static_cast<std::streamoff>(begin_ + frame * bytes.size()));
    if (!stream.read(bytes.data(), static_cast<std::streamsize>(bytes.size())))
      throw_data_loss(name_ + ": sample " + std::to_string(frame) + " can't be read");
    if (swapped_) {
      for (std::size_t i = 0; i < values; ++i) std::reverse(bytes.data() + i * width_, bytes.data() + (i + 1) * width_);
    }
    Positions positions(points_, 3);
    if (width_ == sizeof(float)) {
      std::memcpy(positions.data(), bytes.data(), bytes.size());
    } else {
      for (std::size_t i = 0; i < values; ++i) {
        double value = 0;
        std::memcpy(&value, bytes.data() + i * width_, sizeof value);
        positions.data()[i] = static_cast<float>(value);
      }
    }
    return check_finite(std::move(positions), name_, frame);
  }

 protected:
  explicit FlatFile(const fs::path& path) : name_(path.string()), stream_(path, std::ios::binary) {
    std::error_code ignored;
    if (!stream_ || fs::is_directory(path, ignored)) throw_not_found(name_ + ": can't be read");
    refuse_placeholder(path);
    size_ = fs::file_size(path);
  }

  /// The header has said how much there is: is it there?
  void finish_header(std::uint64_t points, std::uint64_t frames, std::uint64_t begin, const char* format) {
    if (points == 0 || points > kMaxPoints)
      throw_invalid_argument(name_ + ": " + format + " with " + std::to_string(points) + " points");
    if (frames == 0 || frames > kMaxFrames)
      throw_invalid_argument(name_ + ": " + format + " with " + std::to_string(frames) + " samples");
    const std::uint64_t frame_bytes = points * 3 * width_, needed = begin + frames * frame_bytes;
    if (size_ < needed)
      throw_data_loss(name_ + ": truncated, " + std::to_string(size_) + " bytes instead of " + std::to_string(needed));
    if (size_ > needed) {
      warning_ = name_ + ": its header speaks of " + std::to_string(frames) + " frames, but " +
                 std::to_string(size_ - needed) + " bytes follow them (a frame has " + std::to_string(frame_bytes) +
                 ")";
    }
    points_ = static_cast<Eigen::Index>(points);
    frames_ = static_cast<std::size_t>(frames);
    begin_ = begin;
    stream_.close();
  }

  template <class T>
  T read_number(const char* format) {
    char bytes[sizeof(T)];
    if (!stream_.read(bytes, sizeof bytes))
      throw_data_loss(name_ + ": truncated, " + std::to_string(size_) + " bytes are less than a header of " + format);
    if (swapped_) std::reverse(bytes, bytes + sizeof bytes);
    T value{};
    std::memcpy(&value, bytes, sizeof value);
    return value;
  }

  /// A number of points or samples.
  std::uint64_t read_count(const char* format, const char* what) {
    const auto count = read_number<std::int32_t>(format);
    if (count < 0) throw_invalid_argument(name_ + ": " + format + " with " + std::to_string(count) + " " + what);
    return static_cast<std::uint64_t>(count);
  }

  std::string name_;
  std::ifstream stream_;
  std::uint64_t size_ = 0, begin_ = 0;
  std::size_t width_ = sizeof(float);
  bool swapped_ = false;
  double frame_time_s_ = 0;
  std::string warning_;

 private:
  Eigen::Index points_ = 0;
  std::size_t frames_ = 0;
};

class Pc2File final : public FlatFile {
 public:
  explicit Pc2File(const fs::path& path) : FlatFile(path) {
    std::array<char, 12> magic{};
    if (!stream_.read(magic.data(), magic.size()))
      throw_data_loss(name_ + ": truncated, " + std::to_string(size_) + " bytes are less than a PC2 header");
    if (std::memcmp(magic.data(), "POINTCACHE2\0", 12) != 0) throw_invalid_argument(name_ + ": not a PC2 file");
    const auto version = read_number<std::int32_t>("PC2");
    swapped_ = static_cast<std::int32_t>(__builtin_bswap32(static_cast<std::uint32_t>(version))) == 1;
    if (version != 1 && !swapped_)
      throw_invalid_argument(name_ + ": PC2 version " + std::to_string(version) + ", not 1");
    const std::uint64_t points = read_count("PC2", "points");
    read_number<float>("PC2");  // start frame
    read_number<float>("PC2");  // samples a frame
    finish_header(points, read_count("PC2", "samples"), 32, "PC2");
  }
};

class MddFile final : public FlatFile {
 public:
  explicit MddFile(const fs::path& path) : FlatFile(path) {
    swapped_ = true;
    const std::uint64_t frames = read_count("MDD", "samples");
    const std::uint64_t points = read_count("MDD", "points");
    if (frames > size_ / 4)
      throw_data_loss(name_ + ": truncated, " + std::to_string(size_) + " bytes for " + std::to_string(frames) +
                      " frames");
    float first = 0, last = 0;
    for (std::uint64_t k = 0; k < frames; ++k) {
      last = read_number<float>("MDD");
      if (k == 0) first = last;
    }
    const double span = static_cast<double>(last) - static_cast<double>(first);
    if (frames > 1 && std::isfinite(span) && span > 0) frame_time_s_ = span / static_cast<double>(frames - 1);
    finish_header(points, frames, 8 + 4 * frames, "MDD");
  }
};

class NpyFile final : public FlatFile {
 public:
  explicit NpyFile(const fs::path& path) : FlatFile(path) {
    std::array<char, 8> magic{};
    if (!stream_.read(magic.data(), magic.size()) || std::memcmp(magic.data(), "\x93NUMPY", 6) != 0)
      throw_invalid_argument(name_ + ": not a .npy file");
    const bool short_header = magic[6] == 1;
    const std::uint64_t length = short_header ? read_number<std::uint16_t>("npy") : read_number<std::uint32_t>("npy");
    if (length > 4096) throw_invalid_argument(name_ + ": a header of " + std::to_string(length) + " bytes");
    std::string header(length, '\0');
    if (!stream_.read(header.data(), static_cast<std::streamsize>(length)))
      throw_data_loss(name_ + ": truncated in the header");
    std::smatch type, shape;
    static const std::regex kType("'descr': *'([<>|=])f([48])'"), kShape("'shape': *\\(([0-9, ]*)\\)");
    if (!std::regex_search(header, type, kType) || header.find("'fortran_order': False") == std::string::npos ||
        !std::regex_search(header, shape, kShape)) {
      throw_invalid_argument(name_ + ": needs an array of float32 or float64 in C order");
    }
    std::vector<std::uint64_t> extents;
    const std::string text = shape[1].str();
    for (std::size_t i = 0; i < text.size();) {
      if (text[i] < '0' || text[i] > '9') {
        ++i;
        continue;
      }
      std::uint64_t value = 0;
      for (; i < text.size() && text[i] >= '0' && text[i] <= '9' && value < kMaxValues; ++i)
        value = 10 * value + static_cast<std::uint64_t>(text[i] - '0');
      extents.push_back(value);
    }
    if (extents.size() == 2) extents.insert(extents.begin(), 1);
    if (extents.size() != 3 || extents[2] != 3)
      throw_invalid_argument(name_ + ": its shape is (" + text + "), not (frames, points, 3)");
    swapped_ = type[1].str() == ">";
    width_ = type[2].str() == "4" ? sizeof(float) : sizeof(double);
    finish_header(extents[1], extents[0], (short_header ? 10 : 12) + length, "npy");
  }
};

class ArrayFile final : public PointSequence {
 public:
  ArrayFile(const fs::path& path, const std::string& array) : path_(path), array_(array) {
    refuse_placeholder(path);
    const auto lock = hdf5::lock();
    const hdf5::File file = hdf5::File::open(path, false);
    if (!file.exists(array) || !file.is_array(array)) throw_invalid_argument(name() + ": no such array");
    const auto extents = file.extents(array, 3, kMaxValues);
    if (extents[2] != 3) throw_invalid_argument(name() + " has " + std::to_string(extents[2]) + " columns, not 3");
    if (extents[0] == 0 || extents[0] > kMaxFrames) throw_invalid_argument(name() + " has no samples");
    if (extents[1] == 0 || extents[1] > kMaxPoints)
      throw_invalid_argument(name() + ": " + std::to_string(extents[1]) + " points");
    frames_ = static_cast<std::size_t>(extents[0]);
    points_ = static_cast<Eigen::Index>(extents[1]);
  }
  Eigen::Index point_count() const override { return points_; }
  std::size_t frame_count() const override { return frames_; }
  Positions positions(std::size_t frame) const override {
    Positions positions(points_, 3);
    {
      const auto lock = hdf5::lock();
      const hdf5::File file = hdf5::File::open(path_, false);
      file.rows(array_).read(H5T_NATIVE_FLOAT, frame, 1, positions.data());
    }
    return check_finite(std::move(positions), name(), frame);
  }

 private:
  std::string name() const { return path_.string() + ":" + array_; }

  fs::path path_;
  std::string array_;
  std::size_t frames_ = 0;
  Eigen::Index points_ = 0;
};

class AnimatedPoints final : public PointSequence {
 public:
  explicit AnimatedPoints(const fs::path& path) : mesh_(open_animated_mesh(path)) {}
  Eigen::Index point_count() const override { return static_cast<Eigen::Index>(mesh_->mesh().positions.size() / 3); }
  std::size_t frame_count() const override { return mesh_->frame_count(); }
  Positions positions(std::size_t frame) const override { return mesh_->positions(frame); }
  double frame_time_s() const override { return mesh_->frame_time_s(); }

 private:
  std::unique_ptr<AnimatedMesh> mesh_;
};

/// FILE.h5:/array as its two parts.
std::pair<fs::path, std::string> split_array(const std::string& source) {
  for (const char* ending : {".h5:", ".hdf5:"}) {
    const auto place = source.rfind(ending);
    if (place == std::string::npos) continue;
    const std::size_t colon = place + std::strlen(ending) - 1;
    return {source.substr(0, colon), source.substr(colon + 1)};
  }
  return {source, "/positions"};
}

}  // namespace

bool is_point_sequence(const std::string& source) {
  const std::string ending = lower_extension(split_array(source).first);
  if (is_animated_mesh_file(source)) return true;
  return ending == ".pc2" || ending == ".mdd" || ending == ".npy" || ending == ".h5" || ending == ".hdf5";
}

std::unique_ptr<PointSequence> open_points(const std::string& source) {
  const auto [path, array] = split_array(source);
  std::error_code ignored;
  if (!fs::exists(path, ignored)) throw_not_found(path.string() + ": no such file");
  const std::string ending = lower_extension(path);
  if (is_animated_mesh_file(path)) return std::make_unique<AnimatedPoints>(path);
  if (ending == ".pc2") return std::make_unique<Pc2File>(path);
  if (ending == ".mdd") return std::make_unique<MddFile>(path);
  if (ending == ".npy") return std::make_unique<NpyFile>(path);
  if (ending == ".h5" || ending == ".hdf5") return std::make_unique<ArrayFile>(path, array);
  throw_invalid_argument(source + ": points are read from .pc2, .mdd, .npy, .h5, .glb, .gltf, .fbx, .abc and .usda");
}

}  // namespace pleat::presentation
