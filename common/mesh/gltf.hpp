// glTF 2.0 as a mesh with frames.
#pragma once

#include <filesystem>
#include <memory>

#include "common/mesh/animated_mesh.hpp"

namespace pleat {

/// FILE.gltf (buffers beside it or in it) or FILE.glb: triangles of all meshes of the scene, joined; sparse and
/// quantized accessors; the animation of morph weights (LINEAR, STEP, CUBICSPLINE at its keys). Errors as
/// open_animated_mesh; compressed geometry (extensionsRequired) is named and refused.
std::unique_ptr<AnimatedMesh> open_gltf(const std::filesystem::path& path);

}  // namespace pleat
