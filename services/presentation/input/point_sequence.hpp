// Points over time, without faces: point caches and arrays of other tools. Cloth, bodies and obstacles alike.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>

#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

/// Frames of one set of points, read one by one. Files are untrusted: every count is checked against the file's size
/// before memory is taken, every value is checked to be finite.
class PointSequence {
 public:
  virtual ~PointSequence() = default;
  virtual Eigen::Index point_count() const = 0;
  virtual std::size_t frame_count() const = 0;
  /// (points x 3). Throws kInvalidArgument (range; values that are not finite), kDataLoss; the file is named.
  virtual Positions positions(std::size_t frame) const = 0;
  /// Seconds between frames; 0 if the format does not say.
  virtual double frame_time_s() const { return 0; }
  /// What is odd about the file, in one line; empty if nothing is.
  virtual std::string warning() const { return {}; }
};

/// Whether `source` names a file that open_points reads, by its ending: .pc2, .mdd, .npy, .h5, .hdf5, .h5:/array, .glb,
/// .gltf, .usda, .usd.
bool is_point_sequence(const std::string& source);

/// Opens
///   FILE.pc2               char[12] "POINTCACHE2\0", int32 version 1, int32 points, float start frame, float sample
///   rate,
///                          int32 samples; then samples x points x 3 float32; of either byte order
///   FILE.mdd               big-endian: int32 frames, int32 points, float time_s of each frame; then the frames
///   FILE.npy               a NumPy array (T, points, 3) or (points, 3), float32 or float64 of either byte order
///   FILE.h5                the array `positions` (T, points, 3), of any floating type
///   FILE.h5:/group/array   another array of that shape
///   FILE.glb, .gltf, .usda the points of open_animated_mesh
/// Throws kNotFound (no such file or array), kInvalidArgument (not of that format or shape), kDataLoss (truncated).
std::unique_ptr<PointSequence> open_points(const std::string& source);

}  // namespace pleat::presentation
