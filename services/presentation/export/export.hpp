// Results as files that other tools open (README.md here describes each format).
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
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
  kUsdz,  ///< the same in a package
  kGlb,   ///< binary glTF: one mesh with a morph target a frame
  kAbc,   ///< Alembic (Ogawa): one mesh with a sample a frame
  kMaps,  ///< the coarse mesh with its point cache, and what the mesh has more as images a frame (detail_maps.hpp)
};

/// "obj", "ply", "pc2", "mdd", "usda", "usdz", "glb", "abc" or "maps". Throws kInvalidArgument that lists them.
ExportFormat parse_export_format(const std::string& name);

/// The frames of one mesh.
struct ExportInput {
  std::string name = "cloth";  ///< stem of the file names, and the prim in USD, the node in glTF
  Topology topology;
  std::size_t frame_count = 0;                        ///< at least 1
  double frame_time_s = 0;                            ///< seconds between two frames, > 0
  std::function<Positions(std::size_t frame)> frame;  ///< (V x 3) metres, Y up, unless the following says otherwise
  double metres_per_unit = 1;
  bool z_up = false;
  /// The coarse mesh of the same frames, which maps are for; null: there is none.
  std::shared_ptr<const ExportInput> coarse;
};

/// How files should differ from the result.
struct ExportChanges {
  double metres_per_unit = 1;  ///< 0.01: centimetres
  bool z_up = false;           ///< (x, y, z) becomes (x, -z, y)
  std::size_t start = 0;       ///< frames [start, end) of the result
  std::size_t end = std::numeric_limits<std::size_t>::max();
  double fps = 0;  ///< frames a second of the files, linear between those of the result; 0: the result's
};

/// The input with its changes, frame by frame when it is read. Throws kInvalidArgument where no frame is left.
ExportInput changed(ExportInput input, const ExportChanges& changes);

/// Called after each frame, for progress; may throw to stop.
using ExportProgress = std::function<void(std::size_t frames_done)>;

inline constexpr int kDefaultMapSize = 1024, kMaxMapSize = 8192;

struct ExportOptions {
  bool overwrite = false;          ///< also files that are no earlier exports
  int map_size = kDefaultMapSize;  ///< texels on each side of kMaps' images, 16 to kMaxMapSize
};

/// The mesh of result.h5 (finished or .partial): "enhanced", "coarse" or "fine" (the simulated reference). Frames are
/// read while exporting. Errors as ResultReader; kInvalidArgument for another name, kFailedPrecondition if the result
/// has no reference.
ExportInput read_export_input(const std::filesystem::path& result, const std::string& mesh = "enhanced");

/// Writes into `folder`, which is made if need be, and returns the files in the order in which they were written. Every
/// file is written beside its final name and renamed, so that an interrupted export leaves no half file under a final
/// name. Files of these names that are no earlier exports are refused (kAlreadyExists) before anything is written,
/// unless told to. Vertex order and count are those of the result in all formats but glTF, which has vertices on seams
/// once for each side. Throws kInvalidArgument (no frames, a frame of another size or not finite, the folder; glTF in
/// another unit or axis than its own; maps without coarse mesh or material coordinates), kResourceExhausted (disk full;
/// the file is named).
std::vector<std::filesystem::path> export_frames(const ExportInput& input, ExportFormat format,
                                                 const std::filesystem::path& folder,
                                                 const ExportProgress& progress = {},
                                                 const ExportOptions& options = {});

}  // namespace pleat::presentation
