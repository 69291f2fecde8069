// The range of the nine features over a training split.
#pragma once

#include "common/store/dataset.hpp"

namespace pleat::dataset {

/// Features of a mesh in one frame, (V x 3) each, after the rigid alignment ([MFSR-S] eq. 1-3): displacement from the
/// rest positions, vertex normal, velocity.
struct MeshFeatures {
  Positions displacement, normal, velocity;
};
MeshFeatures mesh_features(const Topology& topology, const RigidTransform& alignment, const Positions& positions,
                           const Positions& previous, double frame_time_s);

/// Minimum and maximum per feature over all frames of the split "train", coarse and fine, widened by `margin` times the
/// range on both sides. Velocities are backward differences, 0 in the first frame. A data set without training
/// sequences takes all of its sequences. Throws kFailedPrecondition if there are no frames.
FeatureRange measure_range(const DatasetReader& reader, double margin);

}  // namespace pleat::dataset
