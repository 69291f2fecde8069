// Which files of a folder are earlier exports, so that a new one may take their place.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "services/presentation/export/export.hpp"

namespace pleat::presentation {

/// Marks of text formats.
inline constexpr const char* kPlyMark = "comment written by Pleat";
inline constexpr const char* kGltfGenerator = "written by Pleat";
inline constexpr const char* kAlembicMark = "written by Pleat";
inline constexpr const char* kImageMark = "detail written by Pleat";
inline constexpr const char* kUsdMark = "doc = \"written by Pleat\"";

/// Point caches have no room for a mark: the OBJ beside them names their hashes, "# cache NAME HASH". The lines of this
/// kind for `obj`: that of `cache` as it is now, and those that `obj` has already for other caches.
std::string cache_comments(const std::filesystem::path& obj, const std::filesystem::path& cache);

/// Throws kAlreadyExists, naming the file, unless each of `files` is absent or an export of ours.
void require_own_exports(const std::vector<std::filesystem::path>& files);

}  // namespace pleat::presentation
