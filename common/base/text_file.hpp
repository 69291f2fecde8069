// Text files as editors and exporters really leave them.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace pleat {

inline constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

/// Throws kInvalidArgument, naming `name`, if a file that begins with `head` is no text that we can read: UTF-16 or
/// UTF-32 (the encoding is named), a placeholder of Git LFS or git-annex, or bytes that are no text.
void check_text(std::string_view head, const std::string& name);

/// Throws kInvalidArgument if the file is a placeholder of Git LFS or git-annex, whatever its format should be.
void refuse_placeholder(const std::filesystem::path& path);

/// The content, checked by check_text and without a byte-order mark. Throws kNotFound, kResourceExhausted (longer than
/// `limit` bytes).
std::string read_text_file(const std::filesystem::path& path, std::size_t limit = std::size_t{64} << 20);

}  // namespace pleat
