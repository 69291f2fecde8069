// Poses that cloth can't be worn in, and cloth that is no longer worn: what a sequence is dropped for. Internal.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/simulation/body/motion.hpp"
#include "services/simulation/body/skinned_mesh.hpp"

namespace pleat::dataset {

/// Judges motions of a body by its bones: a bone is a capsule about the segment to the next joint, so thick that a
/// fifth of its joint's skin is inside. Bones of neighbouring joints, and those that overlap at rest, don't count.
class PoseJudge {
 public:
  static constexpr double kMostOverlap = 0.06;                  ///< metres: what is deeper is through a limb
  static constexpr double kNear = 0.2;                          ///< metres from a garment within which bones matter
  static constexpr body::SpeedLimits kMostSpeed = {10, 2'400};  ///< faster joints are errors of a capture

  /// garment: (V x 3) metres, worn by the body at rest. O(V (bones + garment)).
  PoseJudge(const body::SkinnedMesh& body, const Positions& garment);

  /// Per frame why cloth can't be worn in it, in a few words: a joint is faster than kMostSpeed on the way to the next
  /// frame, or a bone inside another by more than kMostOverlap, one of them under or near the garment. Empty: it can.
  /// O(frames x bones^2).
  std::vector<std::string> faults(const body::Motion& motion) const;

 private:
  struct Bone {
    std::size_t joint;
    Eigen::Vector3d from, to;  ///< in the joint's axes
    double radius;
    bool near;
  };
  const body::Skeleton& skeleton_;
  std::vector<Bone> bones_;
  std::vector<std::pair<std::size_t, std::size_t>> pairs_;  // of bones, that must keep apart
};

/// Watches a worn garment frame by frame.
class WornJudge {
 public:
  static constexpr double kMostLag = 0.1;    ///< metres that the body may be behind its motion for cloth it pinches
  static constexpr double kMostSlip = 0.25;  ///< metres that the garment may be from where it was worn, on average

  /// garment: (V x 3), body: (B x 3), metres, of the first frame. O(V B).
  WornJudge(const Positions& garment, const Positions& body);

  /// Why the frame makes its sequence useless; empty: it does not. lag_m: how far the body is behind its motion.
  /// cut_steps of its `steps` had to be cut: cloth of which all are has no room between parts of the body. The slip is
  /// between the mean of the garment and that of the body's vertices that were nearest to it at first.
  std::string why_not(const Positions& garment, const Positions& body, double lag_m, std::uint64_t cut_steps,
                      int steps) const;

 private:
  Eigen::Vector3d slip(const Positions& garment, const Positions& body) const;
  std::vector<Eigen::Index> nearest_;  // per vertex of the garment
  Eigen::Vector3d at_first_;
};

}  // namespace pleat::dataset
