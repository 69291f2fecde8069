// A bundle of one mesh, made to serve any.
#pragma once

#include <string>

namespace pleat::superres {

/// Writes the bundle at `old_path`, of layout "detail" in metres, to `path` in units of coarse edges: its ranges are
/// those of the mesh that it was trained on, so that the network computes there what it did before (if its image has
/// the size that is chosen for the mesh by itself), and on other meshes what is alike.
/// mesh_file: the coarse mesh, OBJ or PLY, metres. Throws kInvalidArgument for bundles of another layout, in other
/// units, or of another mesh; what load_bundle, save_bundle and the mesh's reader throw.
void serve_any_mesh(const std::string& old_path, const std::string& mesh_file, const std::string& path);

}  // namespace pleat::superres
