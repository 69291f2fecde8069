// The forms in which arrays lie in report.html.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

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
  /// Residuals e of q, zig-zag coded (0,-1,1,-2,... -> 0,1,2,3,...), split into the plane of low bytes and the plane of
  /// high bytes, deflated. Order frame, axis, vertex. All differences are taken modulo 2^16 into [-32768, 32767]:
  ///   r[0] = q[0],  r[1] = q[1] - q[0],  r[t] = q[t] - 2 q[t-1] + q[t-2]     (smooth in time)
  ///   e[t][v] = r[t][v] - floor(mean of r[t][u] over the earlier mates u of v)  (smooth in space)
  /// A mate is another corner of a face at v, once per face; earlier means u < v. Without one, u = v - 1; vertex 0: 0.
  std::vector<std::uint8_t> deflated;
};

/// Quantises frames 0, stride, 2 stride, ... below `count`. Throws kInvalidArgument if a frame has another vertex count
/// or a value is not finite; `name` is named. So is a face index out of range. O(T V); holds 6 T V bytes.
QuantizedSequence quantize_sequence(const std::function<Positions(std::size_t)>& frame, std::size_t count,
                                    std::size_t stride, Eigen::Index vertices, const Faces& faces,
                                    const std::string& name);

}  // namespace pleat::presentation
