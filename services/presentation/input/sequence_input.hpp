// Coarse frames made elsewhere: sequences of meshes, point caches, arrays, and our own HDF5 files, behind one
// interface.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

/// Frames of one mesh, read one by one. Files are untrusted: every count is checked against the file's size before
/// memory is taken, every value is checked to be finite.
class FrameSequence {
 public:
  virtual ~FrameSequence() = default;
  virtual std::size_t frame_count() const = 0;
  /// (V x 3) metres. Throws kInvalidArgument, kDataLoss or kNotFound; the file is named.
  virtual Positions positions(std::size_t frame) const = 0;
  /// Obstacles stored with the frames; none unless the format has them.
  virtual std::vector<ObstacleShape> obstacle_shapes() const { return {}; }
  virtual std::vector<ObstacleFrame> obstacles(std::size_t) const { return {}; }
  /// Seconds between frames; 0 if the format does not say.
  virtual double frame_time_s() const { return 0; }
  /// What is odd about the file, in one line; empty if nothing is.
  virtual std::string warning() const { return {}; }
};

/// Opens `source`, of the topology of `rest`:
///   a folder, a glob, a printf pattern   mesh files, one a frame (numbered_files)
///   FILE.obj, FILE.ply                   one frame
///   FILE.glb, .gltf, .fbx, .abc, .usda   a mesh with its frames, of any order of vertices (MatchedFrames)
///   FILE.pc2, .mdd, .npy, .h5:/array     points in the order of the rest mesh's vertices (open_points)
///   FILE.h5, .h5.partial                 a result (its coarse frames), a sequence of a data set
///                                        (DATASET/sequences/NAME.h5), else the array `positions`
/// A mesh frame must have the faces of `rest`; the other formats its vertex count.
/// Throws kNotFound (nothing there), kInvalidArgument (not of that format, another topology), kDataLoss (truncated).
std::unique_ptr<FrameSequence> open_frame_sequence(const std::string& source, const Topology& rest);
/// The same; several are mesh files, a frame each (numbered_files).
std::unique_ptr<FrameSequence> open_frame_sequence(const std::vector<std::string>& sources, const Topology& rest);

/// The garment that such frames are of, and what it is called in messages.
struct RestMesh {
  std::string name;
  Topology mesh;
};

/// That of the frames themselves, for frames that nobody named a garment for: meshes with frames and mesh files are
/// their own, results and data sets have it, beside points (FILE.pc2) lies FILE.obj. scale, notes: as read_garment.
/// Throws as it does, and kInvalidArgument where there is none.
RestMesh rest_of_frames(const std::vector<std::string>& sources, double scale, std::vector<std::string>& notes);

}  // namespace pleat::presentation
