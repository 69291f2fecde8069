// What a stream's next frame needs of the last one. It travels with the frame as opaque bytes, so that replicas stay
// stateless and a replay has the same bits.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "services/conversion/vertex_features/rotation_labels.hpp"

namespace pleat::conversion {

struct StreamState {
  float heading = 0;
  std::vector<Float4> labels;  ///< (V_coarse) of the last frame; empty before the first one
};

/// Little-endian: "PVF1", u32 channels per rotation (3 or 4), u32 vertices, f32 heading, f32 labels by vertices.
std::string to_bytes(const StreamState& state, RotationCode code);

/// No bytes: the state before the first frame. Throws kInvalidArgument for bytes of another kind, another code or
/// vertex count, and for numbers that are not finite.
StreamState stream_state_from_bytes(std::string_view bytes, RotationCode code, std::size_t vertex_count);

}  // namespace pleat::conversion
