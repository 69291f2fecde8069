// Alembic (Ogawa) as a mesh with frames.
#pragma once

#include <filesystem>
#include <memory>

#include "common/mesh/animated_mesh.hpp"

namespace pleat {

/// The PolyMesh and SubD objects of FILE.abc, joined, hidden ones left out: points over time, faces, the material
/// coordinates `uv` (by corner or vertex), placed by the Xform objects above, which may move. Frames are the samples'
/// times. The format has no unit: what it holds is taken as metres, Y up, as its exporters write. Errors as
/// open_animated_mesh; a file that was not finished is kDataLoss, the older HDF5 form is named and refused.
std::unique_ptr<AnimatedMesh> open_alembic(const std::filesystem::path& path);

}  // namespace pleat
