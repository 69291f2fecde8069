#include "tests/bench/rivals/rival_cloth.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/simulation/dynamics.hpp"
#include "tests/bench/rivals/lanes.hpp"

namespace pleat::bench {

using Eigen::Vector2d;
using Eigen::Vector3d;
using simulation::Points;

namespace {

Double4 to_double4(const Vector3d& v) { return Double4{v.x(), v.y(), v.z(), 0}; }
Vector3d to_vector(Double4 v) { return {v[0], v[1], v[2]}; }

Points rest_points(const Topology& mesh) {
  Points points(static_cast<std::size_t>(mesh.vertex_count()));
  for (std::size_t v = 0; v < points.size(); ++v) {
    points[v] = mesh.rest_positions.row(static_cast<Eigen::Index>(v)).cast<double>().transpose();
  }
  return points;
}

void check_scope(const simulation::Scene& scene) {
  const auto require = [](bool fine, const char* what) {
    if (!fine) throw_invalid_argument(std::string("the rivals measure a cloth alone: ") + what);
  };
  require(scene.obstacles.empty(), "no obstacles");
  require(scene.damping_s == 0 && !scene.strain_limits.limits(), "no damping, no strain limits");
  require(scene.wind.velocity.isZero() && scene.wind.drag == 0, "no wind, no drag");
  for (const simulation::Handle& handle : scene.handles) {
    require(!handle.hard && handle.motion.keys.empty() && handle.start_s == 0 && handle.end_s > 1e3,
            "soft handles at rest");
  }
}

}  // namespace

RivalCloth::RivalCloth(const simulation::Scene& scene, const Topology& garment, const Positions& start)
    : scene_(scene),
      table_(scene.material, scene.stretching_multiplier),
      garment_(garment),
      face_density_(scene.material.density * scene.density_multiplier) {
  check_scope(scene);
  const auto uv = [&](Eigen::Index f, int k) -> Vector2d {
    return garment.uv.row(garment.uv_faces(f, k)).cast<double>();
  };
  const auto vertices = static_cast<std::size_t>(garment.vertex_count());
  masses_.assign(vertices + 1, 0);
  std::vector<double> areas(vertices, 0), face_areas;
  for (Eigen::Index f = 0; f < garment.face_count(); ++f) {
    const Vector2d e1 = uv(f, 1) - uv(f, 0), e2 = uv(f, 2) - uv(f, 0);
    const double determinant = e1.x() * e2.y() - e1.y() * e2.x();
    const Vector2d g1 = Vector2d(e2.y(), -e2.x()) / determinant, g2 = Vector2d(-e1.y(), e1.x()) / determinant;
    const Eigen::Vector2f g0 = (-g1 - g2).cast<float>(), h1 = g1.cast<float>(), h2 = g2.cast<float>();
    face_areas.push_back(determinant / 2);
    faces_.push_back({{garment.faces(f, 0), garment.faces(f, 1), garment.faces(f, 2)},
                      {{g0.x(), h1.x(), h2.x()}, {g0.y(), h1.y(), h2.y()}, static_cast<float>(determinant / 2)}});
    for (const std::uint32_t v : faces_.back().v) areas[v] += determinant / 6;
  }
  const Connectivity connectivity = build_connectivity(garment.vertex_count(), garment.faces);
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 == kNone) continue;
    // A seam has other material coordinates on its other side; the smaller stiffness counts.
    const auto edge_in = [&](std::uint32_t face) {
      Vector2d a = Vector2d::Zero(), b = a;
      for (int k = 0; k < 3; ++k) {
        if (garment.faces(face, k) == edge.v0) a = uv(face, k);
        if (garment.faces(face, k) == edge.v1) b = uv(face, k);
      }
      return Vector2d(b - a);
    };
    const Vector2d d0 = edge_in(edge.f0), d1 = edge_in(edge.f1);
    const double length = (d0.norm() + d1.norm()) / 2, area = face_areas[edge.f0] + face_areas[edge.f1];
    RivalHinge hinge{{edge.v0, edge.v1, edge.opposite0, edge.opposite1}, {}};
    hinge.rest.shape = static_cast<float>(length * length / (2 * area));
    hinge.rest.curvature_per_radian = static_cast<float>(length / area);
    for (std::size_t j = 0; j < 5; ++j) {
      const double kappa = 10.0 * static_cast<double>(j);
      hinge.rest.stiffness[j] = static_cast<float>(
          scene.bending_multiplier * std::min(simulation::bending_stiffness(scene.material, d0.x(), d0.y(), kappa),
                                              simulation::bending_stiffness(scene.material, d1.x(), d1.y(), kappa)));
    }
    hinges_.push_back(hinge);
  }

  inverse_masses_.assign(vertices + 1, 0);
  x_.assign(vertices + 1, Double4{});
  v_.assign(vertices + 1, Double4{});
  for (std::size_t v = 0; v < vertices; ++v) {
    masses_double_.push_back(face_density_ * areas[v]);
    inverse_masses_double_.push_back(1 / masses_double_[v]);
    masses_[v] = static_cast<float>(masses_double_[v]);
    inverse_masses_[v] = 1 / masses_[v];
    x_[v] = to_double4(start.row(static_cast<Eigen::Index>(v)).cast<double>().transpose());
    v_[v] = to_double4(scene.velocity);
  }
  for (const simulation::Handle& handle : scene.handles) {
    for (const std::uint32_t v : handle.vertices) pins_.push_back({v, x_[v], static_cast<float>(handle.stiffness)});
  }
  if (scene.contact.self_collision) contact_.emplace(garment, rest_points(garment), areas, scene);
}

void RivalCloth::frame(int steps) {
  const double step_s = scene_.frame_time_s / steps;
  const std::size_t vertices = x_.size() - 1;
  for (int s = 0; s < steps; ++s) {
    if (!contact_) {
      advance(step_s, {});
      continue;
    }
    Points start(vertices), velocities(vertices), end(vertices);
    for (std::size_t v = 0; v < vertices; ++v) {
      start[v] = to_vector(x_[v]);
      velocities[v] = to_vector(v_[v]);
    }
    advance(step_s, contact_->repulsion(start, velocities, masses_double_, 0, step_s, pool_));
    for (std::size_t v = 0; v < vertices; ++v) end[v] = to_vector(x_[v]);
    const simulation::Resolution resolution = contact_->resolve(start, end, inverse_masses_double_, {}, pool_);
    if (resolution.impacts == 0) continue;
    for (std::size_t v = 0; v < vertices; ++v) {
      const Double4 moved = to_double4(end[v]);
      v_[v] += (moved - x_[v]) / step_s;
      x_[v] = moved;
    }
  }
}

Positions RivalCloth::positions() const {
  Positions positions(static_cast<Eigen::Index>(x_.size() - 1), 3);
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    positions.row(v) = to_vector(x_[static_cast<std::size_t>(v)]).cast<float>().transpose();
  }
  return positions;
}

void RivalCloth::find_accelerations(double step_s, std::vector<Double4>& accelerations) const {
  accelerations.assign(x_.size(), to_double4(scene_.gravity));
  if (scene_.wind.density <= 0) return;
  // The air does not reverse a face's motion within the step.
  const double largest = face_density_ / step_s;
  for (const RivalFace& face : faces_) {
    const Double4 &x0 = x_[face.v[0]], e1 = x_[face.v[1]] - x0, e2 = x_[face.v[2]] - x0;
    const Double4 velocity = (v_[face.v[0]] + v_[face.v[1]] + v_[face.v[2]]) / 3;
    const Double4 normal{e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0],
                         0};
    const double size2 = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
    const double along = -(velocity[0] * normal[0] + velocity[1] * normal[1] + velocity[2] * normal[2]);
    if (size2 <= 0) continue;
    const double speed = std::abs(along) / std::sqrt(size2);
    const double pressure = static_cast<double>(face.rest.area) * std::min(scene_.wind.density * speed, largest);
    const Double4 third = normal * (pressure * along / size2 / 3);
    for (const std::uint32_t v : face.v) accelerations[v] += third * static_cast<double>(inverse_masses_[v]);
  }
}

double RivalCloth::force_mismatch() const {
  const std::size_t vertices = x_.size() - 1;
  const auto nowhere = static_cast<std::uint32_t>(vertices);
  std::vector<Double4> x = x_;
  Points points(vertices);
  for (std::size_t v = 0; v < vertices; ++v) {
    // Strains up to a tenth and folds, the same for every run.
    const auto i = static_cast<double>(v);
    x[v] += 2e-3 * Double4{std::sin(12.9 * i), std::sin(78.2 * i), std::sin(37.7 * i), 0};
    points[v] = to_vector(x[v]);
  }
  const Points expected = simulation::Dynamics(garment_, scene_).internal_forces(points);
  std::vector<Double4> forces(x.size(), Double4{});
  for (const RivalFace& face : faces_) {
    Face8 lanes(nowhere);
    lanes.set(0, face.v, face.rest);
    const Strain8 s(lanes, x, table_);
    const Float8 s00 = s.moduli.c11 * s.g00 + s.moduli.c12 * s.g11, s11 = s.moduli.c12 * s.g00 + s.moduli.c22 * s.g11,
                 s01 = s.moduli.c33 * s.g01;
    for (std::size_t k = 0; k < 3; ++k) {
      const Vector8 f = (-lanes.area * lanes.du[k]) * (s00 * s.xu + s01 * s.xv) +
                        (-lanes.area * lanes.dv[k]) * (s01 * s.xu + s11 * s.xv);
      forces[face.v[k]] += Double4{f.x[0], f.y[0], f.z[0], 0};
    }
  }
  for (const RivalHinge& hinge : hinges_) {
    Hinge8 lanes(nowhere);
    lanes.set(0, hinge.v, hinge.rest);
    const Angle8 angle(lanes, x);
    for (std::size_t k = 0; k < 4; ++k) {
      const Vector8 f = (-angle.stiffness * angle.theta) * angle.gradient[k];
      forces[hinge.v[k]] += Double4{f.x[0], f.y[0], f.z[0], 0};
    }
  }
  double largest = 0, mismatch = 0;
  for (std::size_t v = 0; v < vertices; ++v) {
    largest = std::max(largest, expected[v].norm());
    mismatch = std::max(mismatch, (expected[v] - to_vector(forces[v])).norm());
  }
  return mismatch / largest;
}

}  // namespace pleat::bench
