// Sequences of files, one a frame: one rule, however they are named.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace pleat::presentation {

/// The mesh files of a folder ("frames/"), a glob ("cloth_*.obj") or a printf pattern ("cloth_%04d.obj"), in the order
/// of their frame numbers. The number is the one run of digits in which the names differ; a minus sign before it counts
/// unless a letter or digit is before that. Numbers must follow one another without gaps.
/// Throws kNotFound (nothing there; a frame is missing: it is named), kInvalidArgument (names that differ in more than
/// a number, two files of one number, a pattern without exactly one %d).
std::vector<std::filesystem::path> numbered_files(const std::string& source);

/// The same for files that are named one by one, as a shell does with a pattern.
std::vector<std::filesystem::path> numbered_files(const std::vector<std::string>& files);

}  // namespace pleat::presentation
