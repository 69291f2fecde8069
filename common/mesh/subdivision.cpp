#include "common/mesh/subdivision.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/loop_rules.hpp"

namespace pleat {
namespace {

// Numbers the midpoints of edges: new elements come after the existing ones, in order of first appearance.
class Midpoints {
 public:
  explicit Midpoints(std::uint32_t first) : next_(first) {}
  std::uint32_t of(std::uint32_t a, std::uint32_t b) {
    const std::uint64_t key = (static_cast<std::uint64_t>(std::min(a, b)) << 32) | std::max(a, b);
    const auto [it, inserted] = index_.try_emplace(key, next_);
    if (inserted) {
      ++next_;
      ends_.push_back({a, b});
    }
    return it->second;
  }
  const std::vector<std::pair<std::uint32_t, std::uint32_t>>& ends() const { return ends_; }

 private:
  std::uint32_t next_;
  std::unordered_map<std::uint64_t, std::uint32_t> index_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> ends_;
};

// Splits the faces 1 -> 4 and appends the midpoints to the rows of `values`.
template <typename Matrix>
Midpoints split(Matrix& values, Faces& faces) {
  Midpoints midpoints(static_cast<std::uint32_t>(values.rows()));
  Faces split_faces(faces.rows() * 4, 3);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const std::uint32_t a = faces(f, 0), b = faces(f, 1), c = faces(f, 2);
    const std::uint32_t ab = midpoints.of(a, b), bc = midpoints.of(b, c), ca = midpoints.of(c, a);
    split_faces.row(4 * f + 0) << a, ab, ca;
    split_faces.row(4 * f + 1) << ab, b, bc;
    split_faces.row(4 * f + 2) << ca, bc, c;
    split_faces.row(4 * f + 3) << ab, bc, ca;
  }
  const Eigen::Index old_rows = values.rows();
  values.conservativeResize(old_rows + static_cast<Eigen::Index>(midpoints.ends().size()), Eigen::NoChange);
  for (std::size_t i = 0; i < midpoints.ends().size(); ++i) {
    const auto [a, b] = midpoints.ends()[i];
    values.row(old_rows + static_cast<Eigen::Index>(i)) = (values.row(a) + values.row(b)) / 2;
  }
  faces = std::move(split_faces);
  return midpoints;
}

using Eigen::Vector3d;

Vector3d point(const Positions& positions, std::uint32_t v) {
  return positions.row(static_cast<Eigen::Index>(v)).cast<double>().transpose();
}

// One round of Loop's rules. `corners`: vertices that stay.
Midpoints split_with_loop(Positions& positions, Faces& faces, const std::vector<char>& corners) {
  const Positions before = positions;
  const Connectivity mesh = build_connectivity(before.rows(), faces);
  const BoundaryNeighbours boundary = boundary_neighbours(before.rows(), mesh);
  Midpoints midpoints = split(positions, faces);

  const auto old_count = static_cast<std::size_t>(before.rows());
  std::vector<Vector3d> ring(old_count, Vector3d::Zero());
  std::vector<int> valence(old_count, 0);
  for (const Edge& edge : mesh.edges) {
    ring[edge.v0] += point(before, edge.v1);
    ring[edge.v1] += point(before, edge.v0);
    ++valence[edge.v0];
    ++valence[edge.v1];
  }
  for (std::uint32_t v = 0; v < old_count; ++v) {
    if (valence[v] == 0 || (v < corners.size() && corners[v])) continue;
    Vector3d moved;
    if (const auto [a, b] = boundary[v]; a != kNone) {
      moved = 0.75 * point(before, v) + 0.125 * (point(before, a) + point(before, b));
    } else {
      const double weight = loop_neighbour_weight(valence[v]);
      moved = (1 - valence[v] * weight) * point(before, v) + weight * ring[v];
    }
    positions.row(static_cast<Eigen::Index>(v)) = moved.cast<float>().transpose();
  }
  std::unordered_map<std::uint64_t, const Edge*> edge_of;
  const auto key = [](std::uint32_t a, std::uint32_t b) {
    return (static_cast<std::uint64_t>(std::min(a, b)) << 32) | std::max(a, b);
  };
  for (const Edge& edge : mesh.edges) edge_of[key(edge.v0, edge.v1)] = &edge;
  for (std::size_t i = 0; i < midpoints.ends().size(); ++i) {
    const Edge& edge = *edge_of.at(key(midpoints.ends()[i].first, midpoints.ends()[i].second));
    if (edge.f1 == kNone) continue;  // a boundary's new vertices are in the middle
    const Vector3d moved = 0.375 * (point(before, edge.v0) + point(before, edge.v1)) +
                           0.125 * (point(before, edge.opposite0) + point(before, edge.opposite1));
    positions.row(static_cast<Eigen::Index>(old_count + i)) = moved.cast<float>().transpose();
  }
  return midpoints;
}

void move_along_normals(Topology& mesh, const Positions& towards) {
  const Positions normals = vertex_normals(mesh.rest_positions, mesh.faces);
  const Eigen::VectorXf moves = (towards - mesh.rest_positions).cwiseProduct(normals).rowwise().sum();
  mesh.rest_positions += moves.asDiagonal() * normals;
}

}  // namespace

Subdivision subdivide(const Topology& coarse, int rounds, SubdivisionRule rule) {
  if (rule == SubdivisionRule::kSmooth) {
    Subdivision s = subdivide(coarse, rounds);
    move_along_normals(s.fine, subdivide(coarse, rounds, SubdivisionRule::kLoop).fine.rest_positions);
    return s;
  }
  if (rounds < 0 || rounds > 5)
    throw_invalid_argument("subdivision rounds must be 0 to 5, not " + std::to_string(rounds));
  Subdivision s;
  s.fine = coarse;
  s.feature_vertices.resize(static_cast<std::size_t>(coarse.vertex_count()));
  std::iota(s.feature_vertices.begin(), s.feature_vertices.end(), 0u);
  for (const std::uint32_t v : s.feature_vertices) s.halved_edges.push_back({v, v});
  s.level_sizes.push_back(static_cast<std::uint32_t>(s.halved_edges.size()));
  std::vector<char> corners;
  if (rule == SubdivisionRule::kLoop) corners = find_corners(coarse.rest_positions, coarse.faces);
  for (int round = 0; round < rounds; ++round) {
    const Midpoints midpoints = rule == SubdivisionRule::kLoop
                                    ? split_with_loop(s.fine.rest_positions, s.fine.faces, corners)
                                    : split(s.fine.rest_positions, s.fine.faces);
    for (const auto& [a, b] : midpoints.ends()) s.halved_edges.push_back({a, b});
    s.level_sizes.push_back(static_cast<std::uint32_t>(s.halved_edges.size()));
    if (s.fine.uv_faces.rows() > 0) split(s.fine.uv, s.fine.uv_faces);
  }

  // Face f of the coarse mesh became the fine faces [f 4^rounds, (f+1) 4^rounds): every fine vertex lies in the coarse
  // face of the first fine face that uses it. Repeating the split on unit weights gives its barycentric coordinates.
  const Eigen::Index vertices = s.fine.vertex_count();
  s.parent_face.assign(static_cast<std::size_t>(vertices), 0);
  s.barycentric.setZero(vertices, 3);
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> corner_weights = Eigen::Matrix3f::Identity();
  Faces pattern(1, 3);
  pattern << 0, 1, 2;
  for (int round = 0; round < rounds; ++round) split(corner_weights, pattern);
  std::vector<bool> seen(static_cast<std::size_t>(vertices), false);
  const Eigen::Index children = pattern.rows();
  for (Eigen::Index f = 0; f < coarse.face_count(); ++f) {
    for (Eigen::Index child = 0; child < children; ++child) {
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t v = s.fine.faces(f * children + child, k);
        if (seen[v]) continue;
        seen[v] = true;
        s.parent_face[v] = static_cast<std::uint32_t>(f);
        s.barycentric.row(v) = corner_weights.row(pattern(child, k));
      }
    }
  }
  // A vertex that no face uses stays itself; it keeps zero weights and upsample() copies it.
  return s;
}

Subdivision subdivide(const Topology& coarse, const SubdivisionSpec& spec) {
  if (spec.rounds < 0 || spec.rounds > kMaxSubdivisionRounds) {
    throw_invalid_argument("subdivision: 0 to " + std::to_string(kMaxSubdivisionRounds) + " rounds, not " +
                           std::to_string(spec.rounds));
  }
  return subdivide(coarse, spec.rounds, spec.rule);
}

std::optional<SubdivisionSpec> find_subdivision(const Topology& coarse, const Topology& fine) {
  Eigen::Index faces = coarse.face_count();
  int rounds = 0;
  for (; rounds < kMaxSubdivisionRounds && faces < fine.face_count(); ++rounds) faces *= 4;
  if (faces != fine.face_count()) return std::nullopt;
  const std::string hash = topology_hash(fine);
  for (const SubdivisionRule rule : {SubdivisionRule::kMidpoint, SubdivisionRule::kSmooth, SubdivisionRule::kLoop}) {
    if (topology_hash(subdivide(coarse, rounds, rule).fine) == hash) return SubdivisionSpec{rounds, rule};
  }
  return std::nullopt;
}

Positions upsample(const Subdivision& s, const Faces& coarse_faces, const Positions& coarse_positions) {
  Positions fine;
  upsample(s, coarse_faces, coarse_positions, fine);
  return fine;
}

void upsample(const Subdivision& s, const Faces& coarse_faces, const Positions& coarse_positions, Positions& fine) {
  const Eigen::Index coarse_count = static_cast<Eigen::Index>(s.feature_vertices.size());
  if (coarse_positions.rows() != coarse_count) {
    throw_invalid_argument("upsample: " + std::to_string(coarse_positions.rows()) + " positions for a coarse mesh of " +
                           std::to_string(coarse_count) + " vertices");
  }
  fine.resize(s.fine.vertex_count(), 3);
  for (Eigen::Index v = 0; v < fine.rows(); ++v) {
    const auto face = coarse_faces.row(s.parent_face[static_cast<std::size_t>(v)]);
    fine.row(v) = s.barycentric(v, 0) * coarse_positions.row(face(0)) +
                  s.barycentric(v, 1) * coarse_positions.row(face(1)) +
                  s.barycentric(v, 2) * coarse_positions.row(face(2));
  }
  for (Eigen::Index v = 0; v < coarse_count; ++v)
    fine.row(s.feature_vertices[static_cast<std::size_t>(v)]) = coarse_positions.row(v);
}

}  // namespace pleat
