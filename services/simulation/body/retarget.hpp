// A motion of one skeleton for another one with other proportions and another rest pose.
#pragma once

#include <string>
#include <vector>

#include "services/simulation/body/motion.hpp"

namespace pleat::body {

struct Retargeted {
  Motion motion;                   ///< of the target skeleton
  std::vector<std::string> notes;  ///< for people, one line each: joints without a partner, the change of size
};

/// Joints belong together where canonical_name is the same. With R(t), R0 the world rotations of a source joint in the
/// motion and at rest, and T0 that of its partner at rest, the partner turns to R(t) R0^-1 A T0: A turns the target's
/// bone into the direction of the source's at rest, so that a body in A pose follows a skeleton in T pose. A comes from
/// the bone to the one partnered child; the trunk (hips, spine, neck, shoulders), whose bones have conventions rather
/// than directions, and joints with several children or none take that of their parent. Joints without a partner keep
/// their rest pose relative to their parent. The root goes where the source's is, times the ratio of the lengths of
/// legs (root to the lowest partnered joint, along the bones), so units don't matter; y = 0 is the floor of both.
///
/// Throws kInvalidArgument, naming them, if the root or more than half of the joints that the motion turns have no
/// partner, or if partnered joints are all in one place.
Retargeted retarget(const Motion& source, const Skeleton& target, const std::string& source_name,
                    const std::string& target_name);

}  // namespace pleat::body
