// Coarse frames made elsewhere: OBJ sequences, PC2 point caches, and our own HDF5 files, behind one interface.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

/// Frames of one mesh, read one by one. Files are untrusted: every count is checked against the file's size before
/// memory is taken, every value is checked to be finite.
class FrameSequence {
 public:
  virtual ~FrameSequence() = default;
  virtual std::size_t frame_count() const = 0;
  /// (V x 3) metres. Throws kInvalidArgument, kDataLoss or kNotFound; the file is named.
  virtual Positions positions(std::size_t frame) const = 0;
  /// Obstacles stored with the frames; none unless the format has them.
  virtual std::vector<ObstacleShape> obstacle_shapes() const { return {}; }
  virtual std::vector<ObstacleFrame> obstacles(std::size_t) const { return {}; }
  /// Seconds between frames; 0 if the format does not say.
  virtual double frame_time_s() const { return 0; }
};

/// Opens `source`, of the topology of `rest`:
///   a folder             its *.obj files, in natural order (frame2 before frame10)
///   a glob               "cloth_*.obj", quoted for the shell; natural order
///   a printf pattern     "cloth_%04d.obj", one %d; ascending numbers, without gaps
///   FILE.obj             one frame
///   FILE.pc2             a point cache
///   FILE.h5, .h5.partial a result (its coarse frames), or a sequence of a data set (DATASET/sequences/NAME.h5)
/// An OBJ frame must have the faces of `rest`; the other formats its vertex count.
/// Throws kNotFound (nothing there), kInvalidArgument (not of that format, another topology), kDataLoss (truncated).
std::unique_ptr<FrameSequence> open_frame_sequence(const std::string& source, const Topology& rest);

/// A PC2 point cache (3ds Max, Blender's mesh cache). Layout, little-endian: char[12] "POINTCACHE2\0", int32 version 1,
/// int32 points, float start frame, float sample rate, int32 samples; then samples x points x 3 float32.
class PointCache {
 public:
  /// Reads and checks the header against the file's size. Throws kNotFound, kInvalidArgument (not PC2, other version,
  /// counts not positive), kDataLoss (truncated).
  explicit PointCache(const std::filesystem::path& path);

  std::size_t sample_count() const { return samples_; }
  Eigen::Index point_count() const { return points_; }
  /// (points x 3). Throws kInvalidArgument (range, values not finite), kDataLoss (the file has shrunk).
  Positions sample(std::size_t index) const;

 private:
  std::filesystem::path path_;
  std::size_t samples_ = 0;
  Eigen::Index points_ = 0;
};

/// "a2" < "a10": runs of digits compare as numbers.
bool natural_less(const std::string& a, const std::string& b);

}  // namespace pleat::presentation
