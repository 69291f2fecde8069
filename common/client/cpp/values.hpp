// What a client sends and gets: plain arrays. No Eigen type is among them, because its layout depends on the compiler
// flags, and a client need not be compiled with ours. Metres, seconds, Y up, right-handed, counter-clockwise faces.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/base/error.hpp"

namespace pleat::client {

/// The constant part of a mesh. Arrays are row-major, without padding.
struct Mesh {
  std::vector<float> positions;         ///< (V x 3) at rest, metres
  std::vector<std::uint32_t> faces;     ///< (F x 3) vertex indices
  std::vector<float> uv;                ///< (U x 2) material coordinates, metres; a seam vertex has several
  std::vector<std::uint32_t> uv_faces;  ///< (F x 3) indices into uv, same face order; empty exactly when uv is

  std::size_t vertex_count() const { return positions.size() / 3; }
};

/// What stays constant of an obstacle: a sphere (no faces, no capsules), a capsule set, or a closed mesh.
struct ObstacleShape {
  std::string name;                  ///< unique in the session
  std::vector<std::uint32_t> faces;  ///< (F x 3) of a mesh
  std::uint32_t capsules = 0;        ///< of a capsule set
};

/// An obstacle in one frame. Exactly one of sphere (radius > 0), capsules and positions is given, as in its shape.
struct ObstacleFrame {
  std::string name;
  std::array<float, 3> center{};     ///< of a sphere
  float radius = 0;                  ///< of a sphere
  std::vector<float> positions;      ///< (V x 3) of a mesh
  std::vector<float> capsule_ends;   ///< (C x 2 x 3) the two ends of each capsule
  std::vector<float> capsule_radii;  ///< (C)
};

struct CoarseFrame {
  std::uint64_t index = 0;               ///< from 0, each once, in order
  double time_s = 0;                     ///< of the scene
  std::vector<float> positions;          ///< (V_coarse x 3)
  std::vector<float> velocities;         ///< (V_coarse x 3) m/s, or empty: the coordinator takes backward differences
  std::vector<ObstacleFrame> obstacles;  ///< those of the session, in any order
};

/// Time spent in a part of the work, without transport and waiting.
struct StageTime {
  std::string stage;  ///< "to_image"; a part of a stage has a dot in its name
  double ms = 0;
};

/// What refinement found and did (proto/pleat/v1/common.proto, RefinementReport).
struct RefinementReport {
  std::uint32_t self_intersections_before = 0, self_intersections_after = 0;
  std::uint32_t penetrations_before = 0, penetrations_after = 0;
  std::uint32_t vertices_moved = 0;
  float largest_move_m = 0;
  bool input_intersects = false;  ///< the coarse input was not clean: the result is no worse, but not guaranteed
};

/// What the fold step did (proto/pleat/v1/common.proto, FoldReport).
struct FoldReport {
  std::uint32_t steps = 0, layer_contacts = 0, obstacle_contacts = 0;
  bool restarted = false;  ///< begun anew from the upsampled coarse cloth
};

/// One answer: a fine frame, or why there is none. The session or job goes on either way.
struct EnhancedFrame {
  std::uint64_t index = 0;
  double time_s = 0;
  std::vector<float> positions;  ///< (V_fine x 3); with an error: empty, or in jobs the upsampled coarse mesh
  RefinementReport report;
  std::optional<FoldReport> fold;  ///< where the fold step is in use
  std::vector<StageTime> stage_times;
  std::optional<Error> error;  ///< its message names the frame
  // Of jobs only: what the frame was made from.
  std::vector<float> coarse;  ///< (V_coarse x 3)
  std::vector<ObstacleFrame> obstacles;
};

}  // namespace pleat::client
