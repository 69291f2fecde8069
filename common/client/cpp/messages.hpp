// The client's values <-> messages of pleat.v1. What comes from the wire is checked: lengths, finiteness, index ranges.
// Errors are kInvalidArgument or kResourceExhausted and begin with the field's name.
#pragma once

#include <string>

#include "common/client/cpp/values.hpp"
#include "pleat/v1/coordinator.pb.h"

namespace pleat::client {

void to_message(const Mesh& mesh, v1::Topology* message);
void to_message(const ObstacleShape& shape, v1::ObstacleShape* message);
/// Replaces what is in the message, and keeps its memory.
void to_message(const CoarseFrame& frame, v1::EnhanceFrame* message);

Mesh from_message(const v1::Topology& message, const std::string& field);
ObstacleShape from_message(const v1::ObstacleShape& message);
/// `vertices`: those of the fine mesh.
EnhancedFrame from_message(const v1::EnhancedFrame& message, std::size_t vertices);
/// A failed frame; `message` becomes "frame INDEX: ...".
EnhancedFrame from_message(const v1::FrameError& message);

}  // namespace pleat::client
