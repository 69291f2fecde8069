// The nine features of each vertex of a frame, and the velocities among them.
#pragma once

#include <span>

#include "common/features/channels.hpp"
#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat {

/// (V x 9): the channels of frame_channel_names().
using FrameFeatures = Eigen::Matrix<float, Eigen::Dynamic, kFrameChannels, Eigen::RowMajor>;

/// Memory that frame_features() reuses.
struct FeatureScratch {
  Positions rotated, normals;
};

/// Features of a mesh in one frame ([MFSR-S] eq. 1-3), x0 the rest positions, (R, t) the alignment:
/// (R x + t) - x0, R n and R v. An empty frame.velocities counts as zero. O(V + F).
/// frame.positions: (V x 3) of `topology`. features is resized.
void frame_features(const Frame& frame, const Topology& topology, const RigidTransform& alignment,
                    FeatureScratch& scratch, FrameFeatures& features);

/// Backward differences, v = (now - before) / time_s, in m/s. An empty `before` stands for the first frame: zero.
/// now, before, velocities: of the same size; time_s > 0.
void backward_velocities(std::span<const float> now, std::span<const float> before, double time_s,
                         std::span<float> velocities);
/// The same for (V x 3) positions in metres. Returns (V x 3).
Positions backward_velocities(const Positions& now, const Positions& before, double time_s);

}  // namespace pleat
