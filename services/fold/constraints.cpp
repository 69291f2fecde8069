#include "services/fold/constraints.hpp"

#include <cmath>
#include <utility>

#include "common/mesh/connectivity.hpp"

namespace pleat::fold {
namespace {

using Eigen::Vector2d;

constexpr float kLeastStiffness = 1e-6f;  // N/m
constexpr double kBendingCurvature = 10;  // 1/m, of an open fold

class Pattern {
 public:
  explicit Pattern(const Topology& mesh) : mesh_(mesh) {
    for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
      const Vector2d e1 = uv(f, 1) - uv(f, 0), e2 = uv(f, 2) - uv(f, 0);
      areas_.push_back(std::abs(e1.x() * e2.y() - e1.y() * e2.x()) / 2);
    }
  }

  double area(std::size_t face) const { return areas_[face]; }

  /// From vertex a to vertex b of a face.
  Vector2d between(std::uint32_t face, std::uint32_t a, std::uint32_t b) const {
    Vector2d from = Vector2d::Zero(), to = from;
    for (int k = 0; k < 3; ++k) {
      if (mesh_.faces(face, k) == a) from = uv(face, k);
      if (mesh_.faces(face, k) == b) to = uv(face, k);
    }
    return to - from;
  }

 private:
  Vector2d uv(Eigen::Index face, int corner) const { return mesh_.uv.row(mesh_.uv_faces(face, corner)).cast<double>(); }

  const Topology& mesh_;
  std::vector<double> areas_;
};

}  // namespace

std::vector<float> lumped_masses(const Topology& mesh, double density) {
  const Pattern pattern(mesh);
  std::vector<double> masses(static_cast<std::size_t>(mesh.vertex_count()), 0);
  double sum = 0;
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    const double mass = density * pattern.area(static_cast<std::size_t>(f));
    for (int k = 0; k < 3; ++k) masses[mesh.faces(f, k)] += mass / 3;
    sum += mass;
  }
  // A vertex without faces has the average mass.
  std::vector<float> result;
  result.reserve(masses.size());
  for (const double mass : masses) {
    result.push_back(static_cast<float>(mass > 0 ? mass : sum / static_cast<double>(masses.size())));
  }
  return result;
}

std::vector<Spring> edge_springs(const Topology& mesh, const simulation::Material& material) {
  const Pattern pattern(mesh);
  const double strain = (std::pow(1 + static_cast<double>(kFullStretch), 2) - 1) / 2;  // Green's
  const simulation::Moduli rest = simulation::StretchingTable::exact(material, 0, 0, 0),
                           warp = simulation::StretchingTable::exact(material, strain, 0, 0),
                           weft = simulation::StretchingTable::exact(material, 0, strain, 0);
  std::vector<Spring> springs;
  for (const Edge& edge : build_connectivity(mesh.vertex_count(), mesh.faces).edges) {
    const Vector2d side0 = pattern.between(edge.f0, edge.v0, edge.v1);
    const Vector2d side1 = edge.f1 == kNone ? side0 : pattern.between(edge.f1, edge.v0, edge.v1);
    const double length = (side0.norm() + side1.norm()) / 2;
    const double area = pattern.area(edge.f0) + (edge.f1 == kNone ? 0 : pattern.area(edge.f1));
    const double along_u = side0.x() * side0.x() / side0.squaredNorm();
    const auto stiffness = [&](float u, float v) {
      const double modulus = along_u * static_cast<double>(u) + (1 - along_u) * static_cast<double>(v);
      return static_cast<float>(modulus * area / (length * length));
    };
    springs.push_back(
        {{edge.v0, edge.v1}, static_cast<float>(length), stiffness(rest.c11, rest.c22), stiffness(warp.c11, weft.c22)});
  }
  return springs;
}

std::vector<Hinge> edge_hinges(const Topology& mesh, const simulation::Material& material) {
  const Pattern pattern(mesh);
  std::vector<Hinge> hinges;
  for (const Edge& edge : build_connectivity(mesh.vertex_count(), mesh.faces).edges) {
    if (edge.f1 == kNone) continue;
    const Vector2d side0 = pattern.between(edge.f0, edge.v0, edge.v1);
    const Vector2d side1 = pattern.between(edge.f1, edge.v0, edge.v1);
    const double length = (side0.norm() + side1.norm()) / 2;
    const double area0 = pattern.area(edge.f0), area1 = pattern.area(edge.f1);
    // Where the heights of the wings stand on the edge, from v0 to v1, and one over the heights.
    const double foot0 = pattern.between(edge.f0, edge.v0, edge.opposite0).dot(side0) / side0.squaredNorm();
    const double foot1 = pattern.between(edge.f1, edge.v0, edge.opposite1).dot(side1) / side1.squaredNorm();
    const double slope0 = length / (2 * area0), slope1 = length / (2 * area1);
    const double ke = std::min(simulation::bending_stiffness(material, side0.x(), side0.y(), kBendingCurvature),
                               simulation::bending_stiffness(material, side1.x(), side1.y(), kBendingCurvature));
    Hinge hinge;
    hinge.v = {edge.v0, edge.v1, edge.opposite0, edge.opposite1};
    hinge.weights = {static_cast<float>(-(1 - foot0) * slope0 - (1 - foot1) * slope1),
                     static_cast<float>(-foot0 * slope0 - foot1 * slope1), static_cast<float>(slope0),
                     static_cast<float>(slope1)};
    hinge.stiffness = static_cast<float>(ke * length * length / (4 * (area0 + area1)));
    hinges.push_back(hinge);
  }
  return hinges;
}

SpringPacks::SpringPacks(std::vector<Spring> springs, std::uint32_t nowhere)
    : springs_(std::move(springs)), members_(independent_packs(std::span<const Spring>(springs_))) {
  for (const auto& members : members_) {
    Pack& pack = packs_.emplace_back();
    for (Lanes& lanes : pack.v) lanes.fill(nowhere);
    for (std::size_t lane = 0; lane < members.size(); ++lane) {
      for (std::size_t k = 0; k < 2; ++k) pack.v[k][lane] = springs_[members[lane]].v[k];
      pack.rest[static_cast<int>(lane)] = springs_[members[lane]].rest;
    }
  }
}

void SpringPacks::set_step(std::span<const float> inverse_masses, float step_s) {
  const float squared = step_s * step_s;
  for (std::size_t p = 0; p < packs_.size(); ++p) {
    for (std::size_t lane = 0; lane < members_[p].size(); ++lane) {
      const auto l = static_cast<int>(lane);
      const Spring& spring = springs_[members_[p][lane]];
      packs_[p].mobility0[l] = inverse_masses[spring.v[0]];
      packs_[p].mobility1[l] = inverse_masses[spring.v[1]];
      packs_[p].stiffness[l] = squared * std::max(spring.stiffness, kLeastStiffness);
      packs_[p].growth[l] = squared * (spring.stretched - spring.stiffness) / kFullStretch;
    }
  }
}

void SpringPacks::solve(std::span<Float4> x, bool stretched_only) const {
  const Float8 least = broadcast8(stretched_only ? 0.0f : -1e9f), full = broadcast8(kFullStretch);
  for (const Pack& pack : packs_) {
    Float4 rows[kLanes];
    for (std::size_t k = 0; k < kLanes; ++k) rows[k] = x[pack.v[1][k]] - x[pack.v[0][k]];
    const Vector8 d = from_rows(rows);
    const Float8 error = max(1 - pack.rest / max(sqrt(dot(d, d)), broadcast8(1e-9f)), least);
    const Float8 stiffness = pack.stiffness + pack.growth * min(max(error, Float8{}), full);
    const Float8 move = error * stiffness / (stiffness * (pack.mobility0 + pack.mobility1) + 1);
    const Float8 move0 = move * pack.mobility0, move1 = move * pack.mobility1;
    for (std::size_t k = 0; k < kLanes; ++k) {
      const auto lane = static_cast<int>(k);
      x[pack.v[0][k]] += move0[lane] * rows[k];
      x[pack.v[1][k]] -= move1[lane] * rows[k];
    }
  }
}

HingePacks::HingePacks(std::vector<Hinge> hinges, std::uint32_t nowhere)
    : hinges_(std::move(hinges)), members_(independent_packs(std::span<const Hinge>(hinges_))) {
  for (const auto& members : members_) {
    Pack& pack = packs_.emplace_back();
    for (Lanes& lanes : pack.v) lanes.fill(nowhere);
    for (std::size_t lane = 0; lane < members.size(); ++lane) {
      const Hinge& hinge = hinges_[members[lane]];
      for (std::size_t k = 0; k < 4; ++k) {
        pack.v[k][lane] = hinge.v[k];
        pack.weights[k][static_cast<int>(lane)] = hinge.weights[k];
      }
    }
  }
}

void HingePacks::set_step(std::span<const float> inverse_masses, float step_s) {
  for (std::size_t p = 0; p < packs_.size(); ++p) {
    for (std::size_t lane = 0; lane < members_[p].size(); ++lane) {
      const Hinge& hinge = hinges_[members_[p][lane]];
      float sum = 0;
      for (std::size_t k = 0; k < 4; ++k) sum += inverse_masses[hinge.v[k]] * hinge.weights[k] * hinge.weights[k];
      const float share = sum > 0 ? 1 / (sum + 1 / (hinge.stiffness * step_s * step_s)) : 0;
      for (std::size_t k = 0; k < 4; ++k) {
        packs_[p].shares[k][static_cast<int>(lane)] = share * inverse_masses[hinge.v[k]] * hinge.weights[k];
      }
    }
  }
}

void HingePacks::solve(std::span<Float4> x) const {
  for (const Pack& pack : packs_) {
    for (std::size_t k = 0; k < kLanes; ++k) {
      const auto lane = static_cast<int>(k);
      Float4 &a = x[pack.v[0][k]], &b = x[pack.v[1][k]], &c = x[pack.v[2][k]], &d = x[pack.v[3][k]];
      const Float4 bend =
          pack.weights[0][lane] * a + pack.weights[1][lane] * b + pack.weights[2][lane] * c + pack.weights[3][lane] * d;
      a -= pack.shares[0][lane] * bend;
      b -= pack.shares[1][lane] * bend;
      c -= pack.shares[2][lane] * bend;
      d -= pack.shares[3][lane] * bend;
    }
  }
}

}  // namespace pleat::fold
