// Strain limits: a projection of positions that keeps the stretch of every face inside a range.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

/// The gradients of a face's shape functions in its material coordinates, 1/m, one column per corner; they sum to 0.
/// The deformation gradient is [x0 x1 x2] times their transpose.
using ShapeGradients = Eigen::Matrix<double, 2, 3>;
ShapeGradients shape_gradients(const Topology& mesh, Eigen::Index face);

/// The principal stretches of a face: the singular values of its deformation gradient, the larger first.
struct PrincipalStretches {
  std::array<double, 2> stretch;
  Eigen::Matrix2d directions;  ///< in material coordinates, one unit column per stretch
};
PrincipalStretches principal_stretches(const ShapeGradients& gradients, const Eigen::Matrix3d& corners);

/// Moves positions to ones nearby, in the metric of the masses, whose faces respect the range: what ARCSim's strain
/// limiting does. Face by face along the gradients of the singular values (projected Gauss-Seidel), which keeps the
/// momentum, and the angular momentum of small moves.
class StrainLimits {
 public:
  /// mesh: with material coordinates.
  StrainLimits(const Topology& mesh, const StretchRange& range);

  /// inverse_masses: per vertex, 0 for prescribed ones. Sweeps over the faces until all are within a thousandth of the
  /// range, or 40 times: what is prescribed may leave no solution. Returns whether anything moved; without limits
  /// nothing does. O(F) a sweep.
  bool project(std::span<Eigen::Vector3d> positions, std::span<const double> inverse_masses) const;

 private:
  struct Face {
    std::array<std::uint32_t, 3> v;
    ShapeGradients gradients;
  };
  double project_face(const Face& face, std::span<Eigen::Vector3d> x, std::span<const double> inverse_masses) const;

  StretchRange range_;
  std::vector<Face> faces_;  // none without limits
};

}  // namespace pleat::simulation
