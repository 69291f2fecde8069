// What is wrong or unusual with files, before anything is made of them.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace pleat::presentation {

struct CheckOptions {
  std::string rest;  ///< the mesh that the file holds frames of; empty: none
  double scale = 1;  ///< metres per unit of garments and frames
};

/// What was found in one file, a line each: what it holds, what is unusual or would be changed on reading, what keeps
/// it from being used. Notes and faults say what the finding leads to or what mends it.
struct Findings {
  std::vector<std::string> facts, notes, faults;
};

/// `source`: a mesh, a scene (.json), or frames as open_frame_sequence and open_points read them. Whatever the readers
/// throw is a fault.
Findings check_file(const std::string& source, const CheckOptions& options = {});

}  // namespace pleat::presentation
