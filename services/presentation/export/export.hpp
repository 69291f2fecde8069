// Results as files that other tools open (README.md here describes each format).
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

enum class ExportFormat {
  kObj,   ///< Wavefront OBJ, one file a frame
  kPly,   ///< binary little-endian PLY with normals, one file a frame
  kPc2,   ///< PC2 point cache of all frames, and one OBJ with the topology
  kMdd,   ///< MDD point cache of all frames, and one OBJ with the topology
  kUsda,  ///< USD text: one mesh with time samples
  kGlb,   ///< binary glTF: one mesh with a morph target a frame
};

/// "obj", "ply", "pc2", "mdd", "usda" or "glb". Throws kInvalidArgument that lists them.
ExportFormat parse_export_format(const std::string& name);

/// The frames of one mesh.
struct ExportInput {
  std::string name = "cloth";  ///< stem of the file names, and the prim in USD, the node in glTF
  Topology topology;
  std::size_t frame_count = 0;                        ///< at least 1
  double frame_time_s = 0;                            ///< seconds between two frames, > 0
  std::function<Positions(std::size_t frame)> frame;  ///< (V x 3) metres, Y up
};

/// Called after each frame, for progress; may throw to stop.
using ExportProgress = std::function<void(std::size_t frames_done)>;

/// The mesh of result.h5 (finished or .partial): "enhanced", "coarse" or "fine" (the simulated reference). Frames are
/// read while exporting. Errors as ResultReader; kInvalidArgument for another name, kFailedPrecondition if the result
/// has no reference.
ExportInput read_export_input(const std::filesystem::path& result, const std::string& mesh = "enhanced");

/// Writes into `folder`, which is made if need be, and returns the files in the order in which they were written. Every
/// file is written beside its final name and renamed, so that an interrupted export leaves no half file under a final
/// name. Files of these names that are no earlier exports are refused (kAlreadyExists) before anything is written,
/// unless `overwrite`. Vertex order and count are those of the result in all formats. Throws kInvalidArgument (no
/// frames, a frame of another size or not finite, the folder), kResourceExhausted (disk full; the file is named).
std::vector<std::filesystem::path> export_frames(const ExportInput& input, ExportFormat format,
                                                 const std::filesystem::path& folder,
                                                 const ExportProgress& progress = {}, bool overwrite = false);

}  // namespace pleat::presentation
