// Pleat's own meshes and frames <-> the client's plain arrays, for programs of ours. Copies; nothing is checked, since
// both sides were.
#pragma once

#include <span>
#include <vector>

#include "common/client/cpp/values.hpp"
#include "common/frame/frame.hpp"

namespace pleat::client {

Mesh from_topology(const Topology& topology);
Topology to_topology(const Mesh& mesh);

/// Row-major values of (V x 3) positions.
std::vector<float> from_positions(const Positions& positions);
Positions to_positions(std::span<const float> values);

std::vector<ObstacleShape> from_shapes(const std::vector<pleat::ObstacleShape>& shapes);
std::vector<pleat::ObstacleShape> to_shapes(const std::vector<ObstacleShape>& shapes);
std::vector<ObstacleFrame> from_obstacles(const std::vector<pleat::ObstacleFrame>& obstacles);
std::vector<pleat::ObstacleFrame> to_obstacles(const std::vector<ObstacleFrame>& obstacles);

}  // namespace pleat::client
