// Capsule sets as meshes, for the viewer, which draws spheres and meshes.
#pragma once

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

/// Faces of the closed surfaces of so many capsules, outward; the same in every frame.
Faces capsule_surface_faces(std::uint32_t capsules);

/// (V x 3): their vertices in a frame, all of them on the surfaces.
Positions capsule_surface(const ObstacleFrame& capsules);

}  // namespace pleat::presentation
