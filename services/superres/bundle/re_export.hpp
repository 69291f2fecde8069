// Bundles of the earlier form in today's.
#pragma once

#include <string>

namespace pleat::superres {

/// Writes the bundle of version 1 at `old_path` as one of this version to `path`. What such a network did around its
/// layers is conversion's work now: with residual "mesh" and axes "local" it becomes layout "detail" at the texels, of
/// which the displacements stay (normals and velocities were never used by a mesh); without a residual it becomes
/// layout "published". Throws kInvalidArgument for other networks, which have to be trained again, and for files that
/// are no such bundle; kDataLoss for unreadable ones.
void re_export(const std::string& old_path, const std::string& path);

/// Writes the bundle at `bundle_path` to `path` with the rest positions of its coarse mesh, which is in the file
/// `garment`. Throws kInvalidArgument if it was trained for another mesh; the rest as load_bundle and read_garment.
void add_rest_mesh(const std::string& bundle_path, const std::string& garment, const std::string& path);

}  // namespace pleat::superres
