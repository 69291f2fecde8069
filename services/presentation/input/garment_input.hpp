// The garments of a scene as one mesh.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "pleat/v1/scene.pb.h"

namespace pleat::presentation {

/// Reads `garment_file` and `further_garment_files` (read_garment; paths from `folder`) and puts them into the scene as
/// one mesh, several as its layers. Throws as it does, kNotFound, and as require_rest_lengths; `name` goes before
/// messages.
void inline_garments(v1::Scene& scene, const std::filesystem::path& folder, const std::string& name, double scale,
                     std::vector<std::string>& notes);

}  // namespace pleat::presentation
