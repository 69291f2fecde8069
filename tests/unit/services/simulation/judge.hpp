// Judges that share no code with what they judge.
#pragma once

#include <algorithm>
#include <cstdint>

#include "common/mesh/mesh.hpp"
#include "common/mesh/triangle_intersection.hpp"

namespace pleat::simulation {

/// Brute force over all pairs of faces.
inline int self_intersections(const Positions& x, const Faces& faces) {
  int count = 0;
  for (std::uint32_t f = 0; f < faces.rows(); ++f) {
    Eigen::RowVector3f low = x.row(faces(f, 0)), high = low;
    for (int k = 1; k < 3; ++k) low = low.cwiseMin(x.row(faces(f, k))), high = high.cwiseMax(x.row(faces(f, k)));
    for (std::uint32_t g = f + 1; g < faces.rows(); ++g) {
      bool apart = false;
      for (int d = 0; d < 3 && !apart; ++d) {
        const float a = x(faces(g, 0), d), b = x(faces(g, 1), d), c = x(faces(g, 2), d);
        apart = std::min({a, b, c}) > high(d) || std::max({a, b, c}) < low(d);
      }
      if (!apart && faces_intersect(x, faces, f, g)) ++count;
    }
  }
  return count;
}

}  // namespace pleat::simulation
