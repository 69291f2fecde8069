#include "services/dataset/normalization.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/error.hpp"
#include "services/conversion/rigid_alignment.hpp"

namespace pleat::dataset {
namespace {

void extend(FeatureRange& range, std::size_t first_channel, const Positions& values) {
  const Eigen::RowVector3f low = values.colwise().minCoeff(), high = values.colwise().maxCoeff();
  for (std::size_t c = 0; c < 3; ++c) {
    const auto column = static_cast<Eigen::Index>(c);
    range.minimum[first_channel + c] = std::min(range.minimum[first_channel + c], low[column]);
    range.maximum[first_channel + c] = std::max(range.maximum[first_channel + c], high[column]);
  }
}

}  // namespace

MeshFeatures mesh_features(const Topology& topology, const RigidTransform& alignment, const Positions& positions,
                           const Positions& previous, double frame_time_s) {
  const Eigen::Matrix3f back = alignment.rotation.transpose();  // rows times R^T are R times columns
  MeshFeatures features;
  features.displacement = (positions * back).rowwise() + alignment.translation.transpose();
  features.displacement -= topology.rest_positions;
  features.normal = vertex_normals(positions, topology.faces) * back;
  features.velocity = (positions - previous) * back / static_cast<float>(frame_time_s);
  return features;
}

FeatureRange measure_range(const DatasetReader& reader, double margin) {
  const MeshPair& meshes = reader.topology();
  const double frame_time = reader.master().frame_time_s;
  const std::vector<SequenceInfo> sequences = reader.sequences();
  const bool has_training =
      std::any_of(sequences.begin(), sequences.end(), [](const auto& s) { return s.split == "train"; });
  FeatureRange range;
  range.minimum.fill(std::numeric_limits<float>::infinity());
  range.maximum.fill(-std::numeric_limits<float>::infinity());
  for (const SequenceInfo& sequence : sequences) {
    if (has_training && sequence.split != "train") continue;
    Positions last_coarse, last_fine;
    for (std::uint64_t k = 0; k < sequence.frames_complete; ++k) {
      Positions coarse = std::move(reader.coarse(sequence.name, k, k + 1).front());
      Positions fine = std::move(reader.fine(sequence.name, k, k + 1).front());
      const RigidTransform alignment = kabsch(coarse, meshes.coarse.rest_positions);
      const auto add = [&](const Topology& topology, const Positions& positions, const Positions& previous) {
        const MeshFeatures features =
            mesh_features(topology, alignment, positions, k == 0 ? positions : previous, frame_time);
        extend(range, 0, features.displacement);
        extend(range, 3, features.normal);
        extend(range, 6, features.velocity);
      };
      add(meshes.coarse, coarse, last_coarse);
      add(meshes.fine, fine, last_fine);
      last_coarse = std::move(coarse);
      last_fine = std::move(fine);
    }
  }
  for (std::size_t c = 0; c < range.minimum.size(); ++c) {
    if (!std::isfinite(range.minimum[c]) || !std::isfinite(range.maximum[c])) {
      throw Error(ErrorCode::kFailedPrecondition, reader.folder().string() + ": no frames to measure");
    }
    const float extra = static_cast<float>(margin) * (range.maximum[c] - range.minimum[c]);
    range.minimum[c] -= extra;
    range.maximum[c] += extra;
  }
  return range;
}

}  // namespace pleat::dataset
