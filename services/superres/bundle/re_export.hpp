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

}  // namespace pleat::superres
