// Where fine vertices read what a network answers.
#pragma once

#include <cstdint>
#include <vector>

namespace pleat::conversion {

/// Vertex v gets the sum over offsets[v] <= i < offsets[v + 1] of weights[i] times place places[i] of the answer (the
/// index within a channel, row-major). A vertex that no face uses reads nothing.
struct VertexReads {
  std::vector<std::uint32_t> offsets{0};
  std::vector<std::uint32_t> places;
  std::vector<float> weights;
};

}  // namespace pleat::conversion
