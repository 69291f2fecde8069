// What Pleat takes at most, wherever it comes from: one place, so that what one program writes another one reads.
#pragma once

#include <cstdint>

namespace pleat {

inline constexpr std::uint64_t kMaxVertices = 4'000'000;  ///< of one mesh
inline constexpr std::uint64_t kMaxFaces = 8'000'000;     ///< of one mesh
inline constexpr std::uint64_t kMaxCapsules = 10'000;     ///< of one obstacle
inline constexpr std::uint64_t kMaxFrames = 1'000'000;    ///< of one scene, motion or job

/// Of the fine mesh of one session or job, where a service is not told otherwise.
inline constexpr std::int64_t kDefaultMaxFineVertices = 1'000'000;

}  // namespace pleat
