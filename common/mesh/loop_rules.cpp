#include "common/mesh/loop_rules.hpp"

#include <cmath>
#include <numbers>
#include <utility>

namespace pleat {
namespace {

using Eigen::Vector3d;

Vector3d point(const Positions& positions, std::uint32_t v) {
  return positions.row(static_cast<Eigen::Index>(v)).cast<double>().transpose();
}

}  // namespace

BoundaryNeighbours boundary_neighbours(Eigen::Index vertices, const Connectivity& mesh) {
  BoundaryNeighbours neighbours(static_cast<std::size_t>(vertices), {kNone, kNone});
  std::vector<int> count(neighbours.size(), 0);
  for (const Edge& edge : mesh.edges) {
    if (edge.f1 != kNone) continue;
    for (const auto& [v, other] : {std::pair(edge.v0, edge.v1), std::pair(edge.v1, edge.v0)}) {
      if (count[v] < 2) neighbours[v][static_cast<std::size_t>(count[v])] = other;
      ++count[v];
    }
  }
  for (std::size_t v = 0; v < count.size(); ++v) {
    if (count[v] != 2) neighbours[v] = {kNone, kNone};
  }
  return neighbours;
}

std::vector<char> find_corners(const Positions& positions, const Faces& faces) {
  constexpr double kCosine = 0.70710678;
  const Connectivity mesh = build_connectivity(positions.rows(), faces);
  const BoundaryNeighbours neighbours = boundary_neighbours(positions.rows(), mesh);
  std::vector<char> corners(neighbours.size(), 0);
  for (const Edge& edge : mesh.edges) {
    // Where several boundaries meet, nothing says which way to smooth.
    if (edge.f1 == kNone) corners[edge.v0] = corners[edge.v1] = 1;
  }
  for (std::uint32_t v = 0; v < corners.size(); ++v) {
    const auto [a, b] = neighbours[v];
    if (a == kNone) continue;
    const Vector3d before = point(positions, v) - point(positions, a),
                   after = point(positions, b) - point(positions, v);
    corners[v] = !(before.dot(after) >= kCosine * before.norm() * after.norm());
  }
  return corners;
}

double loop_neighbour_weight(int valence) {
  const double center = 0.375 + 0.25 * std::cos(2 * std::numbers::pi / valence);
  return (0.625 - center * center) / valence;
}

}  // namespace pleat
