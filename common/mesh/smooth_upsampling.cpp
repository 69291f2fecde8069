#include "common/mesh/smooth_upsampling.hpp"

#include <algorithm>
#include <unordered_map>

#include "common/base/error.hpp"
#include "common/mesh/loop_rules.hpp"

namespace pleat {
namespace {

using Weights = Eigen::SparseMatrix<float, Eigen::RowMajor>;

std::uint64_t key(std::uint32_t a, std::uint32_t b) {
  return (static_cast<std::uint64_t>(std::min(a, b)) << 32) | std::max(a, b);
}

/// The faces that were split into `faces`: each into four, whose corners subdivide() numbers like this.
Faces parents_of(const Faces& faces) {
  Faces parents(faces.rows() / 4, 3);
  for (Eigen::Index f = 0; f < parents.rows(); ++f) {
    parents.row(f) << faces(4 * f, 0), faces(4 * f + 1, 1), faces(4 * f + 2, 2);
  }
  return parents;
}

/// One round: (V_after x V_before). `corners`: vertices that stay.
Weights loop_round(const Faces& faces, std::uint32_t before, std::uint32_t after, const Subdivision& subdivision,
                   const std::vector<char>& corners) {
  std::vector<Eigen::Triplet<float>> entries;
  const auto add = [&entries](std::uint32_t row, std::uint32_t column, double weight) {
    entries.emplace_back(static_cast<int>(row), static_cast<int>(column), static_cast<float>(weight));
  };
  const Connectivity mesh = build_connectivity(static_cast<Eigen::Index>(before), faces);
  const BoundaryNeighbours boundary = boundary_neighbours(static_cast<Eigen::Index>(before), mesh);
  std::vector<int> valence(before, 0);
  std::unordered_map<std::uint64_t, const Edge*> edge_of;
  for (const Edge& edge : mesh.edges) {
    ++valence[edge.v0];
    ++valence[edge.v1];
    edge_of[key(edge.v0, edge.v1)] = &edge;
  }
  const auto stays = [&](std::uint32_t v) { return valence[v] == 0 || (v < corners.size() && corners[v] != 0); };
  for (std::uint32_t v = 0; v < before; ++v) {
    if (stays(v)) {
      add(v, v, 1);
    } else if (const auto [a, b] = boundary[v]; a != kNone) {
      add(v, v, 0.75);
      add(v, a, 0.125);
      add(v, b, 0.125);
    } else {
      add(v, v, 1 - valence[v] * loop_neighbour_weight(valence[v]));
    }
  }
  for (const Edge& edge : mesh.edges) {
    for (const auto& [v, other] : {std::pair(edge.v0, edge.v1), std::pair(edge.v1, edge.v0)}) {
      if (!stays(v) && boundary[v][0] == kNone) add(v, other, loop_neighbour_weight(valence[v]));
    }
  }
  for (std::uint32_t v = before; v < after; ++v) {
    const auto [a, b] = subdivision.halved_edges[v];
    const Edge& edge = *edge_of.at(key(a, b));
    const bool inside = edge.f1 != kNone;
    add(v, a, inside ? 0.375 : 0.5);
    add(v, b, inside ? 0.375 : 0.5);
    if (!inside) continue;
    add(v, edge.opposite0, 0.125);
    add(v, edge.opposite1, 0.125);
  }
  Weights weights(after, before);
  weights.setFromTriplets(entries.begin(), entries.end());
  return weights;
}

}  // namespace

SmoothUpsampling::SmoothUpsampling(const Topology& coarse, const Subdivision& subdivision)
    : fine_faces_(subdivision.fine.faces) {
  const std::vector<std::uint32_t>& sizes = subdivision.level_sizes;
  std::vector<Faces> levels{fine_faces_};
  while (levels.size() < sizes.size()) levels.push_back(parents_of(levels.back()));
  std::reverse(levels.begin(), levels.end());

  const std::vector<char> corners = find_corners(coarse.rest_positions, coarse.faces);
  loop_.resize(coarse.vertex_count(), coarse.vertex_count());
  loop_.setIdentity();
  for (std::size_t round = 0; round + 1 < sizes.size(); ++round) {
    loop_ = loop_round(levels[round], sizes[round], sizes[round + 1], subdivision, corners) * loop_;
  }

  std::vector<Eigen::Triplet<float>> entries;
  for (Eigen::Index v = 0; v < subdivision.fine.vertex_count(); ++v) {
    const int row = static_cast<int>(v);
    if (v < coarse.vertex_count()) {
      entries.emplace_back(row, row, 1.0F);
      continue;
    }
    const auto face = coarse.faces.row(subdivision.parent_face[static_cast<std::size_t>(v)]);
    for (Eigen::Index corner = 0; corner < 3; ++corner) {
      entries.emplace_back(row, static_cast<int>(face(corner)), subdivision.barycentric(v, corner));
    }
  }
  linear_.resize(subdivision.fine.vertex_count(), coarse.vertex_count());
  linear_.setFromTriplets(entries.begin(), entries.end());
}

Positions SmoothUpsampling::operator()(const Positions& coarse) const {
  if (coarse.rows() != linear_.cols()) {
    throw_invalid_argument("upsampling: " + std::to_string(coarse.rows()) + " positions for a coarse mesh of " +
                           std::to_string(linear_.cols()) + " vertices");
  }
  Positions fine = linear_ * coarse;
  const Positions normals = vertex_normals(fine, fine_faces_);
  const Eigen::VectorXf heights = (loop_ * coarse - fine).cwiseProduct(normals).rowwise().sum();
  fine += heights.asDiagonal() * normals;
  return fine;
}

}  // namespace pleat
