#include "services/fold/constraints.hpp"

#include <cmath>
#include <limits>
#include <utility>

#include "common/mesh/connectivity.hpp"

namespace pleat::fold {
namespace {

using Eigen::Vector2d;

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

std::vector<Face> stretch_faces(const Topology& mesh, const simulation::Material& material) {
  const double strain = (std::pow(1 + static_cast<double>(kFullStretch), 2) - 1) / 2;  // Green's
  const simulation::Moduli rest = simulation::StretchingTable::exact(material, 0, 0, 0);
  const simulation::Moduli stretched{
      simulation::StretchingTable::exact(material, strain, 0, 0).c11, rest.c12,
      simulation::StretchingTable::exact(material, 0, strain, 0).c22,
      simulation::StretchingTable::exact(material, strain / 2, strain / 2, strain / 2).c33};
  const Pattern pattern(mesh);
  std::vector<Face> faces;
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    const auto face = static_cast<std::uint32_t>(f);
    const double area = pattern.area(face);
    const std::array<std::uint32_t, 3> v{mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2)};
    const Vector2d e1 = pattern.between(face, v[0], v[1]), e2 = pattern.between(face, v[0], v[2]);
    // A face without area resists nothing.
    const double det = area > 0 ? e1.x() * e2.y() - e1.y() * e2.x() : std::numeric_limits<double>::infinity();
    faces.push_back({v,
                     {static_cast<float>(e2.y() / det), static_cast<float>(-e1.y() / det)},
                     {static_cast<float>(-e2.x() / det), static_cast<float>(e1.x() / det)},
                     static_cast<float>(area),
                     rest,
                     stretched});
  }
  return faces;
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

FacePacks::FacePacks(std::vector<Face> faces, std::uint32_t nowhere)
    : faces_(std::move(faces)), members_(independent_packs(std::span<const Face>(faces_))) {
  for (const auto& members : members_) {
    Pack& pack = packs_.emplace_back();
    for (Lanes& lanes : pack.v) lanes.fill(nowhere);
    for (std::size_t lane = 0; lane < members.size(); ++lane) {
      const Face& face = faces_[members[lane]];
      const auto l = static_cast<int>(lane);
      for (std::size_t k = 0; k < 3; ++k) pack.v[k][lane] = face.v[k];
      for (std::size_t k = 0; k < 2; ++k) {
        pack.du[k][l] = face.du[k];
        pack.dv[k][l] = face.dv[k];
      }
    }
  }
}

void FacePacks::set_step(std::span<const float> inverse_masses, float step_s, float stiffness) {
  for (std::size_t p = 0; p < packs_.size(); ++p) {
    Pack& pack = packs_[p];
    for (std::size_t lane = 0; lane < members_[p].size(); ++lane) {
      const Face& face = faces_[members_[p][lane]];
      const auto l = static_cast<int>(lane);
      const std::array<float, 3> du{-face.du[0] - face.du[1], face.du[0], face.du[1]};
      const std::array<float, 3> dv{-face.dv[0] - face.dv[1], face.dv[0], face.dv[1]};
      float uu = 0, uv = 0, vv = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        const float mobility = inverse_masses[face.v[k]];
        pack.mobility[k][l] = mobility;
        uu += mobility * du[k] * du[k];
        uv += mobility * du[k] * dv[k];
        vv += mobility * dv[k] * dv[k];
      }
      pack.uu[l] = uu;
      pack.uv[l] = uv;
      pack.vv[l] = vv;
      const float scale = stiffness * face.area * step_s * step_s;
      pack.c11[l] = scale * face.rest.c11;
      pack.c12[l] = scale * face.rest.c12;
      pack.c22[l] = scale * face.rest.c22;
      pack.c33[l] = scale * face.rest.c33;
      pack.growth11[l] = scale * (face.stretched.c11 - face.rest.c11) / kFullStretch;
      pack.growth22[l] = scale * (face.stretched.c22 - face.rest.c22) / kFullStretch;
      pack.growth33[l] = scale * (face.stretched.c33 - face.rest.c33) / kFullStretch;
    }
  }
}

// With the strains C, their derivatives J, the inverse masses W and the stiffness K (times step^2), the positions move
// by -W J^T y, (1 + K J W J^T) y = K C: XPBD's step from lambda = 0.
void FacePacks::solve(std::span<Float4> x, bool stretched_only) const {
  const Float8 full = broadcast8(kFullStretch), none{};
  for (const Pack& pack : packs_) {
    Float4 rows1[kLanes], rows2[kLanes];
    for (std::size_t k = 0; k < kLanes; ++k) {
      const Float4 corner = x[pack.v[0][k]];
      rows1[k] = x[pack.v[1][k]] - corner;
      rows2[k] = x[pack.v[2][k]] - corner;
    }
    const Vector8 e1 = from_rows(rows1), e2 = from_rows(rows2);
    const Float8 s11 = dot(e1, e1), s12 = dot(e1, e2), s22 = dot(e2, e2);
    const auto &du = pack.du, &dv = pack.dv;
    // Of x_u and x_v.
    const Float8 p = du[0] * du[0] * s11 + 2 * du[0] * du[1] * s12 + du[1] * du[1] * s22;
    const Float8 q = du[0] * dv[0] * s11 + (du[0] * dv[1] + du[1] * dv[0]) * s12 + du[1] * dv[1] * s22;
    const Float8 r = dv[0] * dv[0] * s11 + 2 * dv[0] * dv[1] * s12 + dv[1] * dv[1] * s22;
    Float8 e00 = 0.5f * (p - 1), e11 = 0.5f * (r - 1), e01 = 0.5f * q;
    if (stretched_only) {  // the strain's positive part
      const Float8 mean = 0.5f * (e00 + e11), half = 0.5f * (e00 - e11);
      const Float8 radius = sqrt(half * half + e01 * e01) + 1e-12f;
      const Float8 most = max(mean + radius, none), least = max(mean - radius, none);
      const Float8 middle = 0.5f * (most + least), spread = 0.5f * (most - least) / radius;
      e00 = middle + spread * half;
      e11 = middle - spread * half;
      e01 = spread * e01;
    }
    const Float8 k11 = pack.c11 + pack.growth11 * min(max(e00, none), full);
    const Float8 k22 = pack.c22 + pack.growth22 * min(max(e11, none), full);
    const Float8 k33 = 2 * (pack.c33 + pack.growth33 * min(abs(e01), full)), k12 = pack.c12;
    // J W J^T.
    const Float8 m00 = pack.uu * p, m01 = pack.uv * q, m11 = pack.vv * r;
    const Float8 m02 = 0.5f * (pack.uu * q + pack.uv * p), m12 = 0.5f * (pack.uv * r + pack.vv * q);
    const Float8 m22 = 0.25f * (pack.uu * r + 2 * pack.uv * q + pack.vv * p);
    // A y = b.
    const Float8 a00 = 1 + k11 * m00 + k12 * m01, a01 = k11 * m01 + k12 * m11, a02 = k11 * m02 + k12 * m12;
    const Float8 a10 = k12 * m00 + k22 * m01, a11 = 1 + k12 * m01 + k22 * m11, a12 = k12 * m02 + k22 * m12;
    const Float8 a20 = k33 * m02, a21 = k33 * m12, a22 = 1 + k33 * m22;
    const Float8 b0 = k11 * e00 + k12 * e11, b1 = k12 * e00 + k22 * e11, b2 = k33 * e01;
    const Float8 c00 = a11 * a22 - a12 * a21, c01 = a12 * a20 - a10 * a22, c02 = a10 * a21 - a11 * a20;
    const Float8 inverse = 1 / (a00 * c00 + a01 * c01 + a02 * c02);
    const Float8 y0 = inverse * (c00 * b0 + (a02 * a21 - a01 * a22) * b1 + (a01 * a12 - a02 * a11) * b2);
    const Float8 y1 = inverse * (c01 * b0 + (a00 * a22 - a02 * a20) * b1 + (a02 * a10 - a00 * a12) * b2);
    const Float8 y2 = inverse * (c02 * b0 + (a01 * a20 - a00 * a21) * b1 + (a00 * a11 - a01 * a10) * b2);
    // J^T y of corners 1 and 2 as combinations of the edges; that of corner 0 is minus their sum.
    Float8 along1[2], along2[2];
    for (std::size_t k = 0; k < 2; ++k) {
      const Float8 of_u = y0 * du[k] + 0.5f * y2 * dv[k], of_v = y1 * dv[k] + 0.5f * y2 * du[k];
      along1[k] = of_u * du[0] + of_v * dv[0];
      along2[k] = of_u * du[1] + of_v * dv[1];
    }
    const Float8 near1 = pack.mobility[0] * (along1[0] + along1[1]), near2 = pack.mobility[0] * (along2[0] + along2[1]);
    for (std::size_t k = 0; k < 2; ++k) {
      along1[k] *= pack.mobility[k + 1];
      along2[k] *= pack.mobility[k + 1];
    }
    for (std::size_t k = 0; k < kLanes; ++k) {
      const auto lane = static_cast<int>(k);
      x[pack.v[0][k]] += near1[lane] * rows1[k] + near2[lane] * rows2[k];
      x[pack.v[1][k]] -= along1[0][lane] * rows1[k] + along2[0][lane] * rows2[k];
      x[pack.v[2][k]] -= along1[1][lane] * rows1[k] + along2[1][lane] * rows2[k];
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
