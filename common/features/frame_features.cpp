#include "common/features/frame_features.hpp"

#include <algorithm>

namespace pleat {

void frame_features(const Frame& frame, const Topology& topology, const RigidTransform& alignment,
                    FeatureScratch& scratch, FrameFeatures& features) {
  const Eigen::Matrix3f& r = alignment.rotation;
  const Eigen::Index vertices = topology.vertex_count();
  scratch.rotated.resize(vertices, 3);
  for (Eigen::Index v = 0; v < vertices; ++v) {
    scratch.rotated.row(v) = r * Eigen::Vector3f(frame.positions.row(v));
  }
  // Normals of what was rotated, so that those of vertices without area do not depend on the motion, either.
  vertex_normals(scratch.rotated, topology.faces, scratch.normals);
  features.resize(vertices, kFrameChannels);
  const bool moving = frame.velocities.rows() != 0;
  for (Eigen::Index v = 0; v < vertices; ++v) {
    const Eigen::Vector3f rest = topology.rest_positions.row(v);
    features.row(v).segment<3>(kDisplacementChannel) =
        Eigen::Vector3f(scratch.rotated.row(v)) + alignment.translation - rest;
    features.row(v).segment<3>(kNormalChannel) = scratch.normals.row(v);
    Eigen::Vector3f velocity = Eigen::Vector3f::Zero();
    if (moving) velocity = r * Eigen::Vector3f(frame.velocities.row(v));
    features.row(v).segment<3>(kVelocityChannel) = velocity;
  }
}

void backward_velocities(std::span<const float> now, std::span<const float> before, double time_s,
                         std::span<float> velocities) {
  if (before.empty()) {
    std::fill(velocities.begin(), velocities.end(), 0.0F);
    return;
  }
  const auto time = static_cast<float>(time_s);
  for (std::size_t i = 0; i < now.size(); ++i) velocities[i] = (now[i] - before[i]) / time;
}

Positions backward_velocities(const Positions& now, const Positions& before, double time_s) {
  Positions velocities(now.rows(), 3);
  const auto values = [](const Positions& p) {
    return std::span<const float>(p.data(), static_cast<std::size_t>(p.size()));
  };
  backward_velocities(values(now), values(before), time_s,
                      {velocities.data(), static_cast<std::size_t>(velocities.size())});
  return velocities;
}

}  // namespace pleat
