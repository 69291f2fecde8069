// Where a cloth meets the obstacles of a frame: vertices that are too near, faces that reach in. Internal to this room.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/frame/obstacle_field.hpp"
#include "common/mesh/mesh.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat::refinement {

struct VertexContact {
  std::uint32_t vertex;
  ObstacleContact contact;  ///< the deepest
};

/// Whether a vertex far from a closed mesh is inside it needs the nearest face, which is far to search. So that is done
/// for one vertex of each part of the cloth only: two faces with a common vertex that do not meet the surface are on
/// the same side of it. All results are the same whatever was looked at before. Keeps its memory.
class ClothContacts {
 public:
  /// pool: may be null.
  ClothContacts(const Faces& faces, Eigen::Index vertex_count, ThreadPool* pool);

  /// Looks at the cloth: for the calls below with the same arguments. finder: updated for the positions.
  void update(const Positions& positions, const ObstacleField& field, const SelfIntersectionFinder& finder);

  /// The vertices inside obstacles or nearer than `reach` to one, ascending.
  void find_contacts(const Positions& positions, const ObstacleField& field, const SelfIntersectionFinder& finder,
                     double reach, std::vector<VertexContact>& out);

  /// The faces that reach into obstacles, ascending (as judge.hpp has it, but that faces nearer than the tolerance to a
  /// mesh's surface may be reported, too).
  void find_penetrations(const Positions& positions, const ObstacleField& field, const SelfIntersectionFinder& finder,
                         std::vector<std::uint32_t>& out);

  /// The same where all but the vertices of some patches are where they were when `faces` was completed, without
  /// update().
  void find_penetrations_again(const Positions& positions, const ObstacleField& field,
                               const SelfIntersectionFinder& finder, std::span<const std::uint32_t> moved_patches,
                               std::vector<std::uint32_t>& faces);

 private:
  // Some patches of the cloth and one mesh obstacle.
  struct MeshScan {
    std::vector<std::uint32_t> patches;   // ascending
    std::vector<std::uint8_t> cut;        // per such patch: a face of it meets the surface
    std::vector<std::uint8_t> crosses;    // per face of these patches: meets the surface
    std::vector<std::uint32_t> vertices;  // of these patches
    std::vector<std::uint32_t> parent;    // per vertex: towards the one that stands for its part of the cloth
    std::vector<std::uint8_t> side;       // per such vertex
    bool any_inside = false;              // of the parts
  };
  void scan(const Positions& positions, const MeshObstacle& mesh, const SelfIntersectionFinder& finder, MeshScan& scan);
  bool is_inside(MeshScan& scan, std::uint32_t vertex) const;
  void append_penetrations(MeshScan& scan, const SelfIntersectionFinder& finder, std::vector<std::uint32_t>& out) const;
  // Empties the list of the vertices that were collected since the last call.
  void begin_collecting();
  void collect(std::uint32_t vertex, std::vector<std::uint32_t>& out);

  // The vertices of a patch, each once, those that belong to it (and not to an earlier patch) first.
  struct PatchVertices {
    std::uint32_t begin, own_end, end;
  };
  void prepare_packs(std::size_t patches);
  void list_patch_vertices(const SelfIntersectionFinder& finder);
  std::span<const std::uint32_t> vertices_of(std::uint32_t patch) const {
    const PatchVertices& list = patch_lists_[patch];
    return std::span(patch_vertices_).subspan(list.begin, list.end - list.begin);
  }
  std::span<const std::uint32_t> own_vertices_of(std::uint32_t patch) const {
    return vertices_of(patch).first(patch_lists_[patch].own_end - patch_lists_[patch].begin);
  }

  Faces faces_;
  ThreadPool* pool_;
  std::vector<PatchVertices> patch_lists_;  // made by the first update
  std::vector<std::uint32_t> patch_vertices_;
  std::vector<MeshScan> scans_;        // per obstacle, of patches that overlap its bounds; of a capsule set empty
  MeshScan again_;                     // of patches that moved since
  std::vector<std::uint32_t> stamps_;  // per vertex: the last collection that has it
  std::uint32_t stamp_ = 0;
  std::vector<Box> boxes_;
  std::vector<std::uint32_t> patches_;             // near obstacles
  std::vector<std::vector<std::uint32_t>> packs_;  // of an obstacle, near a patch; for each range of a loop
  std::vector<ObstacleContact> found_;             // per vertex
  std::vector<std::uint8_t> is_found_;             // per vertex
  std::vector<std::uint8_t> is_moved_;             // per patch
};

}  // namespace pleat::refinement
