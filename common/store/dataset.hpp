// Paired data sets on disk: docs/file-formats.md has the layout, which h5py opens without our code.
//
// Crash safety. Every array of a sequence has its final size when the file is made; afterwards a frame only fills
// bytes that were reserved, and the attribute `frames_complete` is raised (and flushed) after them. Therefore a process
// killed at any moment leaves a file that opens, with `frames_complete` whole frames.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "common/features/channel_ranges.hpp"
#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat {

/// Version of all files that this folder writes. Readers accept exactly this one.
inline constexpr int kStoreVersion = 1;

/// Whether a file may come from elsewhere: such a file is examined before it is read (hdf5_probe.hpp).
enum class FileOrigin { kElsewhere, kOwn };

/// The coarse and the fine mesh of one piece of cloth.
struct MeshPair {
  Topology coarse;
  Topology fine;
  std::vector<std::uint32_t> feature_vertices;  ///< (V_coarse) indices into the fine mesh
};

/// What the master file `dataset.h5` holds.
struct DatasetMaster {
  double time_step_s = 0;   ///< step of the simulation
  double frame_time_s = 0;  ///< time between frames
  std::uint64_t seed = 0;
  bool tracked = true;  ///< the fine frames follow the coarse ones; false: free fine simulations
  std::string git_revision;
  std::string material;  ///< the material file's text; empty in older data sets
  MeshPair topology;
  std::optional<ChannelRanges> normalization;  ///< extremes of the nine features over the training split
  std::vector<std::string> sequences;          ///< names; the file of each is sequences/<name>.h5
};

/// Writes (or replaces, in one rename) FOLDER/dataset.h5, and makes the folder if need be. A link to a sequence may
/// point to a file that is not complete yet. Throws kInvalidArgument (a name that is not [A-Za-z0-9._-]+),
/// kResourceExhausted (disk full, the file is named).
void write_dataset_master(const std::filesystem::path& folder, const DatasetMaster& master);

/// One frame of a sequence.
struct SequenceFrame {
  double time_s = 0;
  Positions coarse;                      ///< (V_coarse x 3)
  Positions fine;                        ///< (V_fine x 3)
  std::vector<ObstacleFrame> obstacles;  ///< in the order of SequenceOptions::obstacles
};

struct SequenceOptions {
  std::string name;
  std::string split;         ///< "train" or "test"
  std::string scene;         ///< JSON
  std::uint64_t frames = 0;  ///< planned, at least 1
  Eigen::Index coarse_vertices = 0;
  Eigen::Index fine_vertices = 0;
  std::vector<ObstacleShape> obstacles;         ///< a shape without faces is a sphere
  std::vector<Eigen::Index> obstacle_vertices;  ///< per obstacle; 0 unless a mesh
  std::string topology_hash;                    ///< topology_hash of the fine mesh
  /// The sequence's meshes where they are its own, which its file holds then; null: those of the master file.
  std::shared_ptr<const MeshPair> meshes;
  bool deflate = false;  ///< compress (shuffle + deflate 1) when finished, never while recording
};

/// Records FOLDER/sequences/NAME.h5 through NAME.h5.partial. Not thread-safe; one writer a file.
class SequenceWriter {
 public:
  /// Continues an existing .partial that was made with equal options; replaces one that was not or can't be read.
  SequenceWriter(const std::filesystem::path& folder, const SequenceOptions& options);
  ~SequenceWriter();
  SequenceWriter(SequenceWriter&&) noexcept;
  SequenceWriter& operator=(SequenceWriter&&) noexcept;

  /// Whole frames on disk; the next frame to append has this index.
  std::uint64_t frames_complete() const;

  /// Appends one frame and flushes it. Throws kInvalidArgument (sizes, or more frames than planned),
  /// kResourceExhausted (disk full; the file is named and its earlier frames stay readable).
  void append(const SequenceFrame& frame);

  /// Closes and renames .partial to .h5. Needs all planned frames, else kFailedPrecondition.
  void finish();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// What is known of a sequence without reading its frames.
struct SequenceInfo {
  std::string name;
  std::string split;
  std::string scene;
  std::uint64_t frames_complete = 0;
  std::uint64_t frames = 0;  ///< planned
  bool finished = false;     ///< renamed from .partial
  std::string topology_hash;
  bool own_meshes = false;  ///< its meshes are in its own file: DatasetReader::meshes
  std::vector<ObstacleShape> obstacles;
};

/// Reads a data set. Thread-safe (HDF5 calls are serialised in this folder).
/// Errors of all members: kNotFound (no such file or sequence), kInvalidArgument (not one of our files, other version,
/// range of frames), kDataLoss (truncated or inconsistent), each with the path.
class DatasetReader {
 public:
  /// Opens FOLDER/dataset.h5 and validates both topologies.
  explicit DatasetReader(const std::filesystem::path& folder);
  ~DatasetReader();

  const DatasetMaster& master() const;
  /// The meshes of all sequences that have none of their own.
  const MeshPair& topology() const { return master().topology; }
  /// The meshes of a sequence, validated; what its file has must match its hash. May outlive the reader.
  std::shared_ptr<const MeshPair> meshes(const std::string& sequence) const;
  const std::filesystem::path& folder() const;

  /// Every sequence of the master that has a file, finished or partial, in the master's order.
  std::vector<SequenceInfo> sequences() const;
  /// The same, but a file that can't be read is handed to `damaged` and left out.
  std::vector<SequenceInfo> sequences(const std::function<void(const std::string& name, const Error&)>& damaged) const;

  /// Frames [first, last) of a sequence, last <= frames_complete.
  std::vector<Positions> coarse(const std::string& sequence, std::uint64_t first, std::uint64_t last) const;
  std::vector<Positions> fine(const std::string& sequence, std::uint64_t first, std::uint64_t last) const;
  std::vector<double> times(const std::string& sequence, std::uint64_t first, std::uint64_t last) const;
  /// Per frame, the obstacles in the order of SequenceInfo::obstacles.
  std::vector<std::vector<ObstacleFrame>> obstacles(const std::string& sequence, std::uint64_t first,
                                                    std::uint64_t last) const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace pleat
