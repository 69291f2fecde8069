// Which files of a folder are earlier exports, so that a new one may take their place.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "services/presentation/export/export.hpp"

namespace pleat::presentation {

/// Marks of text formats.
inline constexpr const char* kPlyMark = "comment written by Pleat";
inline constexpr const char* kUsdMark = "doc = \"written by Pleat\"";

/// Point caches have no room for a mark: the OBJ beside one names its hash, "# cache NAME HASH".
std::string cache_comment(const std::filesystem::path& cache, const std::string& hash);

/// The lines of that kind in `obj` that name other caches than `cache`: they stay when the OBJ is written again.
std::string other_cache_comments(const std::filesystem::path& obj, const std::filesystem::path& cache);

/// Throws kAlreadyExists, naming the file, unless each of `files` is absent or an export of ours.
void require_own_exports(const std::vector<std::filesystem::path>& files);

}  // namespace pleat::presentation
