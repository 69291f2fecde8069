// The forms in which arrays lie in report.html.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// RFC 4648 base64 with padding.
std::string base64(std::span<const std::uint8_t> bytes);

/// zlib stream (RFC 1950), which a browser's DecompressionStream("deflate") reads. level: 1 to 9.
std::vector<std::uint8_t> deflate(std::span<const std::uint8_t> bytes, int level = 6);

/// Bytes of 32-bit words, little-endian, all lowest bytes first, then the next ones: deflates far better.
std::vector<std::uint8_t> byte_planes(std::span<const std::uint32_t> words);

/// A sequence of meshes of one topology. Frame t, vertex v, axis a: position = origin[t][a] + step * q[t][v][a].
struct QuantizedSequence {
  std::size_t frames = 0;
  std::size_t vertices = 0;
  float step = 0;             ///< metres; the largest extent of a frame's bounding box / 65535
  std::vector<float> origin;  ///< (T x 3) lower corner of each frame's bounding box
  /// Residuals of q, 16-bit wrap-around, zig-zag coded (0,-1,1,-2,... -> 0,1,2,3,...), split into the plane of low
  /// bytes and the plane of high bytes, deflated. Order frame, axis, vertex. r[0] = q[0] minus its predecessor in
  /// vertex order, r[t] = q[t] - q[t-1] for the others: cloth moves smoothly, so that most high bytes are 0.
  std::vector<std::uint8_t> deflated;
};

/// Quantises frames 0, stride, 2 stride, ... below `count`. Throws kInvalidArgument if a frame has another vertex count
/// or a value is not finite; `name` is named. O(T V); holds one byte array of 6 T V bytes.
QuantizedSequence quantize_sequence(const std::function<Positions(std::size_t)>& frame, std::size_t count,
                                    std::size_t stride, Eigen::Index vertices, const std::string& name);

}  // namespace pleat
