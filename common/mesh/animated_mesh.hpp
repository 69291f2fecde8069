// Meshes with their frames in one file, as tools exchange them: glTF, FBX, Alembic and USD.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/mesh/polygons.hpp"

namespace pleat {

/// All meshes of one file as one, in metres, Y up. Files are untrusted: every count and range is checked.
class AnimatedMesh {
 public:
  virtual ~AnimatedMesh() = default;
  /// As it is in the first frame.
  virtual const PolygonMesh& mesh() const = 0;
  /// 1 for a file without an animation.
  virtual std::size_t frame_count() const = 0;
  /// Seconds between frames; 0 with one.
  virtual double frame_time_s() const = 0;
  /// (V x 3) metres. Throws kInvalidArgument (no such frame, values that are not finite); the file is named.
  virtual Positions positions(std::size_t frame) const = 0;
};

/// Whether the file's name ends as those that open_animated_mesh reads: .gltf, .glb, .fbx, .abc, .usda, .usd.
bool is_animated_mesh_file(const std::filesystem::path& path);

/// Opens
///   FILE.gltf, FILE.glb   glTF 2.0: triangles, morph targets and the animation of their weights. Its exporters give a
///                         vertex at a seam one place for each side; places that are one in every frame become one
///                         vertex again. `v` of material coordinates goes up, as in OBJ
///   FILE.fbx              the same from FBX, of any number of corners a face
///   FILE.abc              Alembic (Ogawa): PolyMesh objects over time, moving transforms
///   FILE.usda, FILE.usd   USD text: the points of `Mesh` prims over time, primvars:st
/// Frames are the key frames, which must be evenly spaced. Nodes and prims above a mesh place it; what moves as a whole
/// or by a skeleton is refused. Throws kNotFound, kInvalidArgument (not of that format, or more than we read of it; it
/// is named), kDataLoss (truncated), kResourceExhausted (limits as of OBJ).
std::unique_ptr<AnimatedMesh> open_animated_mesh(const std::filesystem::path& path);

/// For each vertex of `rest` the vertex of `mesh` that it is: by the corners of triangles in their order, whatever the
/// numbers of the vertices are, else in the order of the vertices. Throws kInvalidArgument for another number of them.
std::vector<std::uint32_t> match_vertices(const PolygonMesh& mesh, const Topology& rest, const std::string& name);

/// The frames of such a file in the order of the vertices of a mesh that has it (match_vertices).
class MatchedFrames {
 public:
  /// Throws as open_animated_mesh and match_vertices.
  MatchedFrames(const std::filesystem::path& path, const Topology& rest);
  std::size_t frame_count() const { return mesh_->frame_count(); }
  double frame_time_s() const { return mesh_->frame_time_s(); }
  Positions positions(std::size_t frame) const;

 private:
  std::unique_ptr<AnimatedMesh> mesh_;
  std::vector<std::uint32_t> vertices_;
};

namespace detail {

/// Makes points that are one in every frame one vertex: exporters give a point for each side of a seam.
class PointWelder {
 public:
  /// The next point: where it is, what moves it as a whole, a hash of how it moves else. Vertices are in the order of
  /// their first points.
  void add(const float* place, std::uint32_t part, std::uint64_t motion);
  const std::vector<std::uint32_t>& vertex() const { return vertex_; }          ///< of each point
  const std::vector<std::size_t>& first_point() const { return first_point_; }  ///< of each vertex

 private:
  std::map<std::array<std::uint64_t, 3>, std::uint32_t> number_;
  std::vector<std::uint32_t> vertex_;
  std::vector<std::size_t> first_point_;
};

/// Evenly spaced frames for key frames.
struct FrameTimes {
  double first = 0, step = 0;  ///< step 0: one frame
  std::size_t count = 1;
};
/// keys: in any order, with repeats. Gaps of whole frames are frames, too. Throws kInvalidArgument, naming `name`.
FrameTimes even_times(std::vector<double> keys, const std::string& name);

}  // namespace detail

}  // namespace pleat
