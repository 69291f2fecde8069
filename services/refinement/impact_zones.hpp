// Interpolation between the refined and the upsampled coarse mesh where a frame is not clean ([MFSR] section 5.2).
// Internal to this room.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat::refinement {

/// Vertices around each vertex, in compressed rows.
struct Neighbourhood {
  std::vector<std::uint32_t> offsets, vertices;
};
Neighbourhood build_neighbourhood(const Faces& faces, Eigen::Index vertex_count);

/// The weights of one frame: a vertex of weight w is at safe + w (wanted - safe). They are 1 at first. Where a vertex
/// is lowered, the weights around it rise smoothly to 1, so that no edge shows; where such hollows overlap, the smaller
/// weight holds. A zone is a connected set of vertices with weights below 1. Keeps its memory.
/// All members that change positions leave them at the weights and name the patches that moved.
class ImpactZones {
 public:
  ImpactZones(const Faces& faces, Eigen::Index vertex_count);

  /// A new frame. safe: the upsampled coarse mesh; wanted: the fine mesh; both must stay until the last call for it.
  /// finder: of the mesh; it knows the patches.
  void begin(const Positions& safe, const Positions& wanted, const SelfIntersectionFinder& finder);

  /// Lowers the weights of the corners of these faces by `step`. Returns false if nothing could be lowered.
  bool lower(std::span<const std::uint32_t> offending_faces, float step, Positions& positions);
  /// One weight for all vertices, and no zones any more.
  void set_all(float weight, Positions& positions);

  /// The patches whose vertices the last of these calls moved.
  std::span<const std::uint32_t> moved_patches() const { return moved_; }

  /// The number of zones.
  std::size_t count();

 private:
  std::span<const std::uint32_t> ring(std::uint32_t v) const {
    return std::span(neighbourhood_.vertices)
        .subspan(neighbourhood_.offsets[v], neighbourhood_.offsets[v + 1] - neighbourhood_.offsets[v]);
  }
  bool collect(std::uint32_t v, std::vector<std::uint32_t>& out);
  void begin_collecting();
  void mark_changed(std::uint32_t v);
  void hollow(std::uint32_t v, float depth);
  void finish_change(Positions& positions);

  Faces faces_;
  Neighbourhood neighbourhood_;
  const Positions* safe_ = nullptr;
  const Positions* wanted_ = nullptr;
  const SelfIntersectionFinder* finder_ = nullptr;
  std::vector<float> blend_;            // per vertex: 1 - weight, the deepest hollow there
  std::vector<std::uint32_t> touched_;  // vertices with a blend
  std::vector<std::uint32_t> changed_, moved_;
  std::vector<std::uint8_t> is_changed_, is_moved_;
  std::vector<std::uint32_t> stamps_;
  std::uint32_t stamp_ = 0;
  std::vector<std::uint32_t> corners_, around_;
  std::vector<float> depths_;  // of corners_
};

}  // namespace pleat::refinement
