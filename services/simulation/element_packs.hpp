// The elements of elements.hpp, eight at a time: what the solver runs. The scalar ones are its oracle.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "common/base/simd.hpp"
#include "services/simulation/elements.hpp"
#include "services/simulation/material.hpp"

namespace pleat::simulation {

inline constexpr std::size_t kPack = 8;

struct FacePack {
  std::array<std::array<std::uint32_t, kPack>, 3> v{};
  Float8 du1{}, du2{}, dv1{}, dv2{}, area{};

  void set(std::size_t lane, const std::array<std::uint32_t, 3>& vertices, const TriangleRest<float>& rest);
};

/// One face's results: the stiffness blocks of corners (0,1), (1,2), (2,0), nine floats each, by columns; then the
/// forces on corners 0, 1, 2. Four floats may be read from any of the 36.
inline constexpr std::size_t kFaceRecord = 40;
inline constexpr std::size_t kFaceForces = 27;

struct HingePack {
  std::array<std::array<std::uint32_t, kPack>, 4> v{};
  Float8 shape{}, curvature_per_radian{};
  std::array<Float8, 5> stiffness{};

  void set(std::size_t lane, const std::array<std::uint32_t, 4>& vertices, const HingeRest<float>& rest);
};

/// One hinge's results: per vertex the gradient of the angle times the root r of the stiffness, three floats and one
/// more: the first's is the moment m, so that the force on corner k is m times its gradient, and the stiffness of
/// corners a, b is g_a g_b^T.
inline constexpr std::size_t kHingeRecord = 16;

/// The air around a cloth within a step: pressure along a face's normal, and tangential drag. It never reverses the
/// motion through the air within the step.
struct Air {
  const Double4* velocities;  ///< per vertex, m/s
  Eigen::Vector3f wind;       ///< m/s
  float density;              ///< kg/m^3
  float drag;                 ///< N s/m^3
  float largest;              ///< kg/(m^2 s): mass per area and step
};

/// positions: one per vertex, the fourth lane unused. air: may be null. records: kPack * kFaceRecord floats.
void stretching_pack(const FacePack& pack, const Double4* positions, const StretchingTable& table, const Air* air,
                     float* records);

/// reference_angles: kPack of them, the angles of the last step, replaced by the new ones: a hinge may fold past pi.
/// records: kPack * kHingeRecord floats.
void bending_pack(const HingePack& pack, const Double4* positions, float* reference_angles, float* records);

}  // namespace pleat::simulation
