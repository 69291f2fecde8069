// Values <-> messages of pleat.v1. Everything that comes from the wire is checked here: lengths, finiteness, index
// ranges. The errors are kInvalidArgument and begin with the field's name as the caller gives it ("open.coarse").
#pragma once

#include <google/protobuf/repeated_field.h>

#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "pleat/v1/common.pb.h"

namespace pleat {

/// An array of rows: replaces the field's values, keeping its memory.
void to_message(const Positions& values, google::protobuf::RepeatedField<float>* field);

v1::Topology to_message(const Topology& topology);
v1::Frame to_message(const Frame& frame);
v1::ObstacleShape to_message(const ObstacleShape& shape);
v1::ObstacleFrame to_message(const ObstacleFrame& obstacle);
v1::RigidTransform to_message(const RigidTransform& transform);
v1::Tensor to_message(const Tensor& tensor);
/// The same into an existing message, whose memory is reused: for the hot path.
void to_message(const Frame& frame, v1::Frame* message);
void to_message(const Tensor& tensor, v1::Tensor* message);

/// The values alone, as bytes of the type, without names: for the hot path. Keeps the message's memory.
void to_payload(const Tensor& tensor, v1::Tensor::DType dtype, v1::Tensor* message);
/// The same in reverse, into memory that is reused, from either form. Finiteness is for the caller to check.
void from_payload(const v1::Tensor& message, const std::string& field, Tensor* tensor);

/// (V x 3). `vertices`: the count expected; -1 accepts any.
Positions positions_from_message(const google::protobuf::RepeatedField<float>& values, Eigen::Index vertices,
                                 const std::string& field);
/// The positions of a frame alone.
Positions positions_from_message(const v1::Frame& frame, Eigen::Index vertices = -1,
                                 const std::string& field = "frame");

/// Passes validate_topology; a hash that is given must be right. Throws kResourceExhausted beyond the contract's
/// limits.
Topology from_message(const v1::Topology& message, const std::string& field = "topology");
/// Velocities may be empty, or have the positions' size. `vertices`: the count expected; -1 accepts any.
Frame from_message(const v1::Frame& message, Eigen::Index vertices = -1, const std::string& field = "frame");
ObstacleShape from_message(const v1::ObstacleShape& message, const std::string& field = "obstacle");
ObstacleFrame from_message(const v1::ObstacleFrame& message, const std::string& field = "obstacle");
/// The rotation must be one, to 1e-3.
RigidTransform from_message(const v1::RigidTransform& message, const std::string& field = "alignment");
/// The values as float32 whatever the message's type; one channel name per entry of the first extent, or none.
Tensor from_message(const v1::Tensor& message, const std::string& field = "tensor");

/// All obstacles of a frame, which must be the session's, in any order; returned in the session's order.
template <typename Messages>
std::vector<ObstacleFrame> obstacles_from_messages(const Messages& messages, const std::vector<ObstacleShape>& shapes,
                                                   const std::string& field = "obstacles");

/// Throws kInvalidArgument unless the frames are those of the shapes; brings them into the shapes' order.
std::vector<ObstacleFrame> match_obstacles(std::vector<ObstacleFrame> frames, const std::vector<ObstacleShape>& shapes,
                                           const std::string& field);

template <typename Messages>
std::vector<ObstacleFrame> obstacles_from_messages(const Messages& messages, const std::vector<ObstacleShape>& shapes,
                                                   const std::string& field) {
  std::vector<ObstacleFrame> frames;
  for (const auto& message : messages) {
    frames.push_back(from_message(message, field + "[" + std::to_string(frames.size()) + "]"));
  }
  return match_obstacles(std::move(frames), shapes, field);
}

}  // namespace pleat
