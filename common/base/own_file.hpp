// What a program may write over: nothing that it can't prove to be of its own making.
#pragma once

#include <filesystem>
#include <span>
#include <string_view>

namespace pleat {

/// Texts one of which stands in the first kMarkBytes of every file of a kind, by its format.
using FileMarks = std::span<const std::string_view>;
inline constexpr std::size_t kMarkBytes = std::size_t{64} << 10;

/// Whether `path` is a regular file (a link is none) with one of `marks` in it.
bool has_mark(const std::filesystem::path& path, FileMarks marks);

/// Throws kAlreadyExists, naming the file, unless nothing lies at `path` or has_mark(path, marks).
void require_replaceable(const std::filesystem::path& path, FileMarks marks);

/// The same where the caller knows: `own` tells whether what lies at `path` is ours.
void require_absent_or(bool own, const std::filesystem::path& path);

/// Gives what lies at `path`, if anything, the first free name of `path`.aside-1, -2, ...: for files that are in the
/// way and may be somebody's. Throws kResourceExhausted, naming it, if that can't be.
void set_aside(const std::filesystem::path& path);

/// Gives the file the mode of any file that this process makes: for one that comes from a folder of private files.
void take_over(const std::filesystem::path& file);

/// Makes the folder. Throws kInvalidArgument, naming it, if that can't be, something else lies there, it can't be
/// written, or it is the root of the file system.
void make_writable_folder(const std::filesystem::path& folder);

}  // namespace pleat
