#include "services/refinement/obstacle_push.hpp"

#include <algorithm>
#include <cmath>

namespace pleat {
namespace {

// Weight of standing still against bending: displacements fade over about three edges.
constexpr double kStandStill = 1e-3;
// Moves below this share of the clearance are projected: no wrinkle suffers from them.
constexpr double kProjectedShare = 0.1;
constexpr int kProjections = 5;
constexpr int kFaceSweeps = 12;

struct Violation {
  std::uint32_t vertex;
  Eigen::Vector3d move;  // to the clearance
};

std::vector<std::uint32_t> faces_near(const ObstacleField& field, const SelfIntersectionFinder& finder, double margin) {
  std::vector<std::uint32_t> faces;
  for (const Box& box : field.bounds(margin)) {
    finder.query(box, [&](std::uint32_t f) { faces.push_back(f); });
  }
  std::sort(faces.begin(), faces.end());
  faces.erase(std::unique(faces.begin(), faces.end()), faces.end());
  return faces;
}

std::vector<std::uint32_t> vertices_of(const Faces& faces, const std::vector<std::uint32_t>& some) {
  std::vector<std::uint32_t> vertices;
  for (const std::uint32_t f : some) {
    for (int k = 0; k < 3; ++k) vertices.push_back(faces(f, k));
  }
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  return vertices;
}

std::vector<Violation> find_violations(const Positions& positions, const std::vector<std::uint32_t>& vertices,
                                       const ObstacleField& field, double clearance) {
  std::vector<Violation> violations;
  for (const std::uint32_t v : vertices) {
    const auto contact = field.contact(positions.row(v).cast<double>(), clearance);
    // Float positions may miss the clearance by a rounding.
    if (!contact || contact->distance >= clearance - kPenetrationTolerance) continue;
    violations.push_back({v, (clearance - contact->distance) * contact->normal});
  }
  return violations;
}

}  // namespace

ObstaclePush::ObstaclePush(Faces faces, Eigen::Index vertex_count, int rounds)
    : faces_(std::move(faces)), vertex_count_(vertex_count), rounds_(rounds) {}

const SparseCholesky& ObstaclePush::factor() {
  if (factor_ != nullptr) return *factor_;
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index f = 0; f < faces_.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const auto a = static_cast<int>(faces_(f, k)), b = static_cast<int>(faces_(f, (k + 1) % 3));
      entries.emplace_back(a, b, 1);
      entries.emplace_back(b, a, 1);
    }
  }
  Eigen::SparseMatrix<double> laplacian(vertex_count_, vertex_count_);
  // An edge of two faces counts once.
  laplacian.setFromTriplets(entries.begin(), entries.end(), [](double, double) { return 1.0; });
  const Eigen::VectorXd degree = laplacian * Eigen::VectorXd::Ones(vertex_count_);
  laplacian = degree.cwiseMax(1).cwiseInverse().asDiagonal() * laplacian;
  Eigen::SparseMatrix<double> identity(vertex_count_, vertex_count_);
  identity.setIdentity();
  laplacian = identity - laplacian;
  const Eigen::SparseMatrix<double> bending = laplacian.transpose() * laplacian;
  factor_ = std::make_unique<SparseCholesky>(bending + kStandStill * identity);
  return *factor_;
}

bool ObstaclePush::apply(Positions& positions, const ObstacleField& field, SelfIntersectionFinder& finder,
                         double clearance) {
  if (field.empty()) return false;
  std::vector<std::uint32_t> near = faces_near(field, finder, clearance);
  if (near.empty()) return false;
  std::vector<std::uint32_t> vertices = vertices_of(faces_, near);
  std::vector<Violation> violations = find_violations(positions, vertices, field, clearance);
  bool moved = false;
  const auto worth_a_solve = [&](const Violation& violation) {
    return violation.move.squaredNorm() > std::pow(kProjectedShare * clearance, 2);
  };
  for (int round = 0; round < rounds_ && std::any_of(violations.begin(), violations.end(), worth_a_solve); ++round) {
    Eigen::MatrixXd load = Eigen::MatrixXd::Zero(vertex_count_, 3);
    for (const Violation& violation : violations) load.row(violation.vertex) = violation.move;
    const Eigen::MatrixXd u = factor().solve(load);
    // The length of the step that comes nearest to all required moves.
    double along = 0, squared = 0;
    for (const Violation& violation : violations) {
      along += u.row(violation.vertex).dot(violation.move);
      squared += u.row(violation.vertex).squaredNorm();
    }
    if (!(along > 0 && squared > 0)) break;
    positions += ((along / squared) * u).cast<float>();
    moved = true;
    finder.update(positions);
    near = faces_near(field, finder, clearance);
    vertices = vertices_of(faces_, near);
    violations = find_violations(positions, vertices, field, clearance);
  }
  for (int i = 0; i < kProjections && !violations.empty(); ++i) {
    std::vector<std::uint32_t> projected;
    for (const Violation& violation : violations) {
      positions.row(violation.vertex) += violation.move.cast<float>().transpose();
      projected.push_back(violation.vertex);
    }
    moved = true;
    violations = find_violations(positions, projected, field, clearance);
  }
  if (moved) finder.update(positions);
  for (int sweep = 0; sweep < kFaceSweeps; ++sweep) {
    bool pushed = false;
    for (const std::uint32_t f : find_penetrations(positions, field, finder)) {
      pushed = field.push_face_out(positions, faces_, f, clearance) || pushed;
    }
    if (!pushed) break;
    moved = true;
    finder.update(positions);
  }
  return moved;
}

std::vector<std::uint32_t> find_penetrations(const Positions& positions, const ObstacleField& field,
                                             const SelfIntersectionFinder& finder) {
  std::vector<std::uint32_t> faces = field.empty() ? std::vector<std::uint32_t>{} : faces_near(field, finder, 0);
  std::erase_if(faces, [&](std::uint32_t f) { return !field.penetrates(positions, finder.faces(), f); });
  return faces;
}

}  // namespace pleat
