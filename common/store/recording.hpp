// What data sets and results share: meshes, obstacles, and arrays that grow frame by frame without losing one.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/limits.hpp"
#include "common/frame/frame.hpp"
#include "common/store/dataset.hpp"
#include "common/store/hdf5.hpp"

namespace pleat::store {

/// /topology/{coarse,fine}/..., /topology/feature_vertices.
void write_topologies(hdf5::File& file, const MeshPair& topology);
/// Validated. Throws kDataLoss.
MeshPair read_topologies(const hdf5::File& file);

/// Throws kInvalidArgument unless the attributes `format` and `version` are these.
void check_format(const hdf5::File& file, const std::string& format);

/// An array of a recording: one row a frame.
struct Array {
  enum class Type { kFloat, kDouble, kUint32 };
  std::string name;
  Type type = Type::kFloat;
  std::vector<hsize_t> row;  ///< extents of a row; empty for scalars
  bool large = false;        ///< one chunk a frame, with a checksum, and compressed where wanted
};

/// The arrays of obstacles, in the order in which obstacle_rows gives their data.
std::vector<Array> obstacle_arrays(const std::vector<ObstacleShape>& shapes, const std::vector<Eigen::Index>& vertices);
/// Pointers into `frames`, checked: one per array of obstacle_arrays. Throws kInvalidArgument.
std::vector<const void*> obstacle_rows(const std::vector<ObstacleShape>& shapes,
                                       const std::vector<Eigen::Index>& vertices,
                                       const std::vector<ObstacleFrame>& frames);
void write_obstacle_shapes(hdf5::File& file, const std::vector<ObstacleShape>& shapes);
struct ObstacleTable {
  std::vector<ObstacleShape> shapes;
  std::vector<Eigen::Index> vertices;  ///< 0 unless a mesh
};
ObstacleTable read_obstacle_shapes(const hdf5::File& file);
std::vector<std::vector<ObstacleFrame>> read_obstacles(const hdf5::File& file, const ObstacleTable& table,
                                                       std::uint64_t first, std::uint64_t last);

/// Rows [first, last) of a (T, V, 3) array. Throws kDataLoss if its V differs.
std::vector<Positions> read_positions(const hdf5::File& file, const std::string& name, Eigen::Index vertices,
                                      std::uint64_t first, std::uint64_t last);

/// The attribute `frames_complete`, once it is known that there are so many: memory is taken for as many. kDataLoss.
std::uint64_t frames_complete(const hdf5::File& file);

/// Throws kInvalidArgument, naming the file, unless first <= last <= complete.
void check_range(const hdf5::File& file, std::uint64_t first, std::uint64_t last, std::uint64_t complete);

/// 64-bit FNV-1a of a text, as 16 hexadecimal digits.
std::string fingerprint(const std::string& text);

/// PATH.partial while it grows, PATH when it is finished.
class Recording {
 public:
  struct Plan {
    std::filesystem::path path;
    std::uint64_t frames = 0;
    std::vector<Array> arrays;
    std::string fingerprint;                        ///< of everything that a continued recording must share
    std::function<void(hdf5::File&)> write_header;  ///< constant parts
    bool resume = false;
    bool deflate = false;
  };

  explicit Recording(Plan plan);
  Recording(Recording&&) noexcept = default;
  Recording& operator=(Recording&&) = delete;
  ~Recording();

  std::uint64_t frames_complete() const { return frames_complete_; }
  const std::filesystem::path& partial_path() const { return partial_; }

  /// rows: one pointer per array. Throws kInvalidArgument beyond the plan, kResourceExhausted when the disk is full.
  void append(const std::vector<const void*>& rows);
  void finish();

 private:
  bool try_resume();
  void open_rows();
  void make(hdf5::File& file, std::uint64_t frames, bool deflate) const;
  void copy_compressed();

  /// Keeps a second writer away, from other processes too, as long as it lives.
  struct FileLock {
    explicit FileLock(const std::filesystem::path& path);
    ~FileLock();
    FileLock(const FileLock&) = delete;
    FileLock& operator=(const FileLock&) = delete;
    int descriptor = -1;
  };

  Plan plan_;
  std::filesystem::path partial_;
  std::unique_ptr<FileLock> lock_;
  std::optional<hdf5::File> file_;
  std::vector<hdf5::Rows> rows_;
  std::vector<std::optional<hdf5::Rows>> checksums_;  ///< of large arrays' rows
  std::uint64_t frames_complete_ = 0;
};

}  // namespace pleat::store
