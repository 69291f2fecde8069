// The range of the nine features over a training split.
#pragma once

#include "common/store/dataset.hpp"

namespace pleat::dataset {

/// Extremes per feature (frame_features()) over all frames of the split "train", coarse and fine, widened by `margin`
/// times the range on both sides. Velocities are backward differences, 0 in the first frame. A data set without
/// training sequences takes all of its sequences. Throws kFailedPrecondition if there are no frames.
ChannelRanges measure_range(const DatasetReader& reader, double margin);

}  // namespace pleat::dataset
