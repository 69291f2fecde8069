#include "common/mesh/subdivision.hpp"

#include <algorithm>
#include <numeric>
#include <unordered_map>

#include "common/base/error.hpp"

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

}  // namespace

Subdivision subdivide(const Topology& coarse, int rounds) {
  if (rounds < 0 || rounds > 5)
    throw_invalid_argument("subdivision rounds must be 0 to 5, not " + std::to_string(rounds));
  Subdivision s;
  s.fine = coarse;
  s.feature_vertices.resize(static_cast<std::size_t>(coarse.vertex_count()));
  std::iota(s.feature_vertices.begin(), s.feature_vertices.end(), 0u);
  for (int round = 0; round < rounds; ++round) {
    split(s.fine.rest_positions, s.fine.faces);
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
