// The folder of model bundles. Free of LibTorch: link pleat_superres, include this.
#pragma once

#include <string>
#include <vector>

#include "services/superres/bundle/metadata.hpp"

namespace pleat::superres {

/// Lists the bundles of a folder: names without ".pt", sorted. kNotFound if the folder does not exist.
std::vector<std::string> list_bundles(const std::string& folder);

/// The file of bundle `name` ("draping" or "draping.pt") in `folder`. kInvalidArgument for a name with a path in it or
/// "..", or a link that leads outside; kNotFound if there is no such file.
std::string bundle_path(const std::string& folder, const std::string& name);

/// Whether the file is an archive with a pleat.json in it: a check-point, or what can't be read, is none.
bool is_bundle(const std::string& path);

/// Reads the metadata of the bundle at `path`. Errors as the other read_metadata().
Metadata read_metadata(const std::string& path);

/// Reads the metadata only: one record of the archive, no code and no weights. Errors as metadata_from_json; kDataLoss
/// for a truncated or unreadable archive, kInvalidArgument for a TorchScript file without pleat.json.
Metadata read_metadata(const std::string& folder, const std::string& name);

}  // namespace pleat::superres
