// Rigid alignment of a deformed mesh with its rest shape ([MFSR-S] eq. 3).
#pragma once

#include "common/frame/frame.hpp"

namespace pleat {

/// The rotation (determinant +1, never a reflection) and translation that minimise sum |R x_i + t - x0_i|^2.
/// Where the clouds do not determine the rotation, the one nearest to the identity is chosen: collinear clouds get the
/// smallest rotation between their lines, coincident points the identity. Deterministic. O(V), double precision inside.
/// positions, rest: (V x 3), V >= 1. Throws kInvalidArgument for different sizes or values that are not finite.
RigidTransform kabsch(const Positions& positions, const Positions& rest);

}  // namespace pleat
