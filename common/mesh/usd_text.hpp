// USD in its text form as a mesh with frames.
#pragma once

#include <filesystem>
#include <memory>

#include "common/mesh/animated_mesh.hpp"

namespace pleat {

/// The `Mesh` prims of FILE.usda, joined, invisible ones and prims of classes left out: points (with time samples),
/// faces, `primvars:st` or another primvar of type texCoord2f (faceVarying or vertex), placed by the transforms of the
/// prims above, in the stage's `metersPerUnit` (0.01 where it says nothing, as USD has it) and `upAxis`. References and
/// variants are not followed. Errors as open_animated_mesh; binary USD (crate) is named and refused.
std::unique_ptr<AnimatedMesh> open_usd_text(const std::filesystem::path& path);

}  // namespace pleat
