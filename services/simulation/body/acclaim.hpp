// Acclaim's motion capture files: a skeleton (ASF) and its motion (AMC), as mocap.cs.cmu.edu has them.
#pragma once

#include <filesystem>
#include <iosfwd>
#include <string>

#include "services/simulation/body/motion.hpp"

namespace pleat::body {

/// CMU's captures have 120 frames a second; the files do not say.
inline constexpr double kAcclaimFrameTime = 1.0 / 120;

/// A bone that starts where its parent ends. With C the bone's axes (`axis`), its rotation relative to the parent's is
/// C R C^-1, R the turns of the degrees of freedom in their order.
struct AcclaimBone {
  std::string name;
  Eigen::Quaterniond axes = Eigen::Quaterniond::Identity();
  std::vector<std::string> freedoms;  ///< "rx", "ry", "rz", "tx", "ty", "tz", "l", in the order of the motion's values
};

/// A skeleton whose joints are the starts of the bones, with the world's axes at rest.
struct AcclaimSkeleton {
  Skeleton skeleton;               ///< metres: CMU's unit is an inch divided by `length`
  std::vector<AcclaimBone> bones;  ///< same order as the joints; the first is the root
  double metres_per_unit = 1;      ///< of the motion's translations
  bool degrees = true;
};

/// Reads `:units`, `:root`, `:bonedata` and `:hierarchy`; other sections are skipped.
/// Throws kNotFound, kInvalidArgument (syntax, values that are not finite, a bone of zero length or without direction,
/// a parent that does not exist; file and line are named).
AcclaimSkeleton read_asf(const std::filesystem::path& path);
AcclaimSkeleton read_asf(std::istream& stream, const std::string& name);

/// Reads the frames of a motion of that skeleton. A bone that a frame does not mention stays at rest.
/// Throws kNotFound, kInvalidArgument (a bone that the skeleton lacks, another number of values than it has freedoms,
/// values that are not finite; file and line are named).
Motion read_amc(const std::filesystem::path& path, const AcclaimSkeleton& skeleton,
                double frame_time_s = kAcclaimFrameTime);
Motion read_amc(std::istream& stream, const std::string& name, const AcclaimSkeleton& skeleton,
                double frame_time_s = kAcclaimFrameTime);

}  // namespace pleat::body
