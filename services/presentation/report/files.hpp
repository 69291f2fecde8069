// Writing whole files.
#pragma once

#include <filesystem>
#include <string_view>

namespace pleat::presentation {

/// Writes `content` to PATH.tmp and renames it, so that a reader never sees half a file; makes the folder if need be.
/// Throws kResourceExhausted (disk full), kInvalidArgument (the folder or file can't be made); the path is named.
void write_file_atomically(const std::filesystem::path& path, std::string_view content);

}  // namespace pleat::presentation
