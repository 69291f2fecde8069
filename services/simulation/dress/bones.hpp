// The bones of a body as segments, and how a garment lies around them.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/mesh/bvh.hpp"
#include "common/mesh/mesh.hpp"
#include "services/simulation/body/skinned_mesh.hpp"

namespace pleat::dress {

/// A segment inside the body, from a joint to one that turns with it.
struct Bone {
  int joint = 0;
  Eigen::Vector3d from = Eigen::Vector3d::Zero(), to = Eigen::Vector3d::Zero();  ///< metres, at rest
};

/// Of every joint that skin follows: a bone to each of its children, and to the skin farthest from it where it has
/// none. Joints that no skin follows (a root on the floor) have no bones. O(V + joints).
std::vector<Bone> bones_of(const body::SkinnedMesh& body);

/// The body with every vertex moved along the way to its bones: the weighted mean of the points of its joints' bones
/// that are nearest to it. fullness 1: the body; 0: its bones. O(V bones).
class Shrunk {
 public:
  explicit Shrunk(const body::SkinnedMesh& body);
  Positions at(double fullness) const;

 private:
  Positions full_, bones_;
};

/// The openings of a garment (neck, cuffs, hem): its boundary as loops of vertices. O(F log F).
std::vector<std::vector<std::uint32_t>> openings(const Faces& faces);

/// How a garment at a place lies around the bones.
struct Enclosure {
  std::size_t crossed = 0;    ///< bones that go through the cloth
  std::vector<char> pierced;  ///< per opening: whether a bone goes through it (through the fan about its mean)
  std::size_t pierced_count = 0;
};

/// Asks where a garment would be worn.
class Placement {
 public:
  /// positions: of the garment's vertices, metres.
  Placement(const Positions& positions, const Faces& faces, std::vector<Bone> bones);

  /// Translations are of the garment, metres.
  std::size_t opening_count() const { return openings_.size(); }
  Enclosure enclosure(const Eigen::Vector3d& translation) const;
  /// A small translation on a grid of `spacing`, at most `reach` long, at which no bone crosses the cloth and as many
  /// openings as possible are pierced, two at least (of a garment with one that one); among these one with room between
  /// cloth and bones. Nothing if there is none.
  std::optional<Eigen::Vector3d> nearest_worn(double reach, double spacing) const;
  /// Metres from the bones to the nearest vertex or middle of a face.
  double clearance(const Eigen::Vector3d& translation) const;
  /// Share of the cloth's area that looks away from the nearest bone. At a worn place it is near 1; inside out near 0.
  double outward_share(const Eigen::Vector3d& translation) const;

 private:
  Positions positions_;
  Faces faces_;
  std::vector<Bone> bones_;
  Bvh tree_;  // of the faces
  std::vector<std::vector<std::uint32_t>> openings_;
  std::vector<Eigen::Vector3d> centers_;  // of the openings
};

}  // namespace pleat::dress
