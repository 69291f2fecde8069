// The constants of networks that need the mesh.
#pragma once

#include "common/store/dataset.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "services/superres/mesh_base.hpp"

namespace pleat::superres {

/// pair.fine: pair.coarse with every edge split in four. Throws kInvalidArgument if the coarse image is too small to
/// hold the coarse mesh.
MeshBase make_mesh_base(const MeshPair& pair, ImageSpec spec);

}  // namespace pleat::superres
