#include "services/dataset/normalization.hpp"

#include <algorithm>
#include <memory>
#include <utility>

#include "common/base/error.hpp"
#include "common/features/frame_features.hpp"
#include "common/frame/rigid_alignment.hpp"

namespace pleat::dataset {

ChannelRanges measure_range(const DatasetReader& reader, double margin) {
  const double frame_time = reader.master().frame_time_s;
  const std::vector<SequenceInfo> sequences = reader.sequences();
  const bool has_training =
      std::any_of(sequences.begin(), sequences.end(), [](const auto& s) { return s.split == "train"; });
  RangeMeasure measure(kFrameChannels);
  FeatureScratch scratch;
  FrameFeatures features;
  for (const SequenceInfo& sequence : sequences) {
    if (has_training && sequence.split != "train") continue;
    const std::shared_ptr<const MeshPair> meshes = reader.meshes(sequence.name);
    Positions last_coarse, last_fine;
    for (std::uint64_t k = 0; k < sequence.frames_complete; ++k) {
      Frame coarse, fine;
      coarse.positions = std::move(reader.coarse(sequence.name, k, k + 1).front());
      fine.positions = std::move(reader.fine(sequence.name, k, k + 1).front());
      coarse.velocities = backward_velocities(coarse.positions, last_coarse, frame_time);
      fine.velocities = backward_velocities(fine.positions, last_fine, frame_time);
      const RigidTransform alignment = kabsch(coarse.positions, meshes->coarse.rest_positions);
      frame_features(coarse, meshes->coarse, alignment, scratch, features);
      measure.add(features);
      frame_features(fine, meshes->fine, alignment, scratch, features);
      measure.add(features);
      last_coarse = std::move(coarse.positions);
      last_fine = std::move(fine.positions);
    }
  }
  if (measure.count() == 0) {
    throw Error(ErrorCode::kFailedPrecondition, reader.folder().string() + ": no frames to measure");
  }
  return measure.extremes(margin);
}

}  // namespace pleat::dataset
