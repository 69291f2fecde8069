// Garments and wrinkled frames for the tests of this room.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "common/mesh/obj.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::test {

struct Garment {
  Topology coarse;
  Subdivision subdivision;
  const Topology& fine() const { return subdivision.fine; }
};

inline Garment load_garment(const std::string& name) {
  Garment garment;
  garment.coarse = read_obj("deploy/garments/" + name + ".obj");
  garment.subdivision = subdivide(garment.coarse, 2);
  return garment;
}

/// A smooth deformation of space with folds of 7 to 30 cm and up to 2 cm height, the same for coarse and fine meshes.
inline Eigen::Vector3f wrinkle(const Eigen::Vector3f& p, float phase) {
  const Eigen::Vector3f q(p.x(), p.y() + 0.03f * std::sin(9 * p.x() + 4 * p.z() + phase), p.z());
  const float fold = 0.02f * std::sin(43 * p.x() + 21 * p.y() + 12 * p.z() + 2 * phase) +
                     0.01f * std::sin(70 * p.z() + 50 * p.y() - 31 * p.x() - phase);
  return q + fold * Eigen::Vector3f(0.2f, 1.0f, 0.3f);
}

inline RigidTransform some_motion() {
  RigidTransform motion;
  motion.rotation = Eigen::AngleAxisf(1.1f, Eigen::Vector3f(0.3f, -0.5f, 0.8f).normalized()).toRotationMatrix();
  motion.translation = {0.4f, 1.3f, -0.7f};
  return motion;
}

inline Positions moved(const Positions& positions, const RigidTransform& motion) {
  return (positions * motion.rotation.transpose()).rowwise() + motion.translation.transpose();
}

/// A wrinkled frame of a mesh; velocities are those of a phase that grows by 1 per second.
inline Frame wrinkled_frame(const Topology& topology, float phase) {
  Frame frame;
  frame.positions.resize(topology.vertex_count(), 3);
  frame.velocities.resize(topology.vertex_count(), 3);
  for (Eigen::Index v = 0; v < topology.vertex_count(); ++v) {
    const Eigen::Vector3f p = topology.rest_positions.row(v);
    frame.positions.row(v) = wrinkle(p, phase);
    frame.velocities.row(v) = (wrinkle(p, phase) - wrinkle(p, phase - 0.04f)) / 0.04f;
  }
  return frame;
}

inline double rms(const Positions& a, const Positions& b) {
  return std::sqrt(static_cast<double>((a - b).squaredNorm()) / static_cast<double>(a.rows()));
}

inline double largest(const Positions& a, const Positions& b) {
  return static_cast<double>((a - b).rowwise().norm().maxCoeff());
}

}  // namespace pleat::test
