#include "common/frame/messages.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "common/base/error.hpp"

namespace pleat {
namespace {

constexpr int kMaxVertices = 4'000'000;
constexpr int kMaxFaces = 8'000'000;
constexpr int kMaxCapsules = 10'000;
constexpr std::uint64_t kMaxTensorValues = 16u << 20;  // 64 MiB of float32, the message limit

template <typename Matrix, typename Scalar>
void assign(const Matrix& matrix, google::protobuf::RepeatedField<Scalar>* field) {
  field->Resize(static_cast<int>(matrix.size()), Scalar{});
  std::copy_n(matrix.data(), matrix.size(), field->mutable_data());
}

void check_finite(const float* values, std::size_t count, const std::string& field) {
  // One pass without branches first: a sum of zeros is zero, a NaN or an infinity times zero is a NaN.
  float sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += values[i] * 0.0f;
  if (sum == 0.0f) return;
  for (std::size_t i = 0; i < count; ++i) {
    if (!std::isfinite(values[i])) throw_invalid_argument(field + ": value " + std::to_string(i) + " is not finite");
  }
}

template <typename Matrix, typename Scalar>
Matrix matrix_of(const google::protobuf::RepeatedField<Scalar>& values, const std::string& field) {
  constexpr int columns = Matrix::ColsAtCompileTime;
  if (values.size() % columns != 0) {
    throw_invalid_argument(field + ": " + std::to_string(values.size()) + " values, not a multiple of " +
                           std::to_string(columns));
  }
  Matrix matrix(values.size() / columns, columns);
  std::copy_n(values.data(), values.size(), matrix.data());
  return matrix;
}

template <typename Scalar>
void check_limit(const google::protobuf::RepeatedField<Scalar>& values, int limit, const std::string& field) {
  if (values.size() > limit) {
    throw Error(ErrorCode::kResourceExhausted,
                field + ": " + std::to_string(values.size()) + " values, at most " + std::to_string(limit));
  }
}

Eigen::Vector3f vector_of(const google::protobuf::RepeatedField<float>& values, const std::string& field) {
  if (values.size() != 3) throw_invalid_argument(field + ": " + std::to_string(values.size()) + " values, 3 needed");
  check_finite(values.data(), 3, field);
  return {values[0], values[1], values[2]};
}

float half_to_float(std::uint16_t half) {
  const std::uint32_t sign = (half & 0x8000u) << 16, exponent = (half >> 10) & 0x1fu, mantissa = half & 0x3ffu;
  if (exponent == 0x1f) return std::bit_cast<float>(sign | 0x7f800000u | (mantissa << 13));
  if (exponent == 0) {
    const float value = std::ldexp(static_cast<float>(mantissa), -24);
    return sign != 0 ? -value : value;
  }
  return std::bit_cast<float>(sign | ((exponent + 112) << 23) | (mantissa << 13));
}

}  // namespace

void to_message(const Positions& values, google::protobuf::RepeatedField<float>* field) { assign(values, field); }

v1::Topology to_message(const Topology& topology) {
  v1::Topology message;
  assign(topology.rest_positions, message.mutable_rest_positions());
  assign(topology.faces, message.mutable_faces());
  assign(topology.uv, message.mutable_uv());
  assign(topology.uv_faces, message.mutable_uv_faces());
  message.set_hash(topology_hash(topology));
  return message;
}

void to_message(const Frame& frame, v1::Frame* message) {
  message->set_index(frame.index);
  message->set_time_s(frame.time_s);
  assign(frame.positions, message->mutable_positions());
  assign(frame.velocities, message->mutable_velocities());
}

v1::Frame to_message(const Frame& frame) {
  v1::Frame message;
  to_message(frame, &message);
  return message;
}

v1::ObstacleShape to_message(const ObstacleShape& shape) {
  v1::ObstacleShape message;
  message.set_name(shape.name);
  assign(shape.faces, message.mutable_faces());
  message.set_capsules(shape.capsules);
  return message;
}

v1::ObstacleFrame to_message(const ObstacleFrame& obstacle) {
  v1::ObstacleFrame message;
  message.set_name(obstacle.name);
  if (obstacle.radius > 0) {
    assign(obstacle.center, message.mutable_center());
    message.set_radius(obstacle.radius);
  } else if (!obstacle.capsule_radii.empty()) {
    assign(obstacle.capsule_ends, message.mutable_capsule_ends());
    message.mutable_capsule_radii()->Add(obstacle.capsule_radii.begin(), obstacle.capsule_radii.end());
  } else {
    assign(obstacle.positions, message.mutable_positions());
  }
  return message;
}

v1::RigidTransform to_message(const RigidTransform& transform) {
  v1::RigidTransform message;
  const Eigen::Matrix<float, 3, 3, Eigen::RowMajor> rotation = transform.rotation;
  assign(rotation, message.mutable_rotation());
  assign(transform.translation, message.mutable_translation());
  return message;
}

void to_message(const Tensor& tensor, v1::Tensor* message) {
  message->clear_shape();
  for (const std::int64_t extent : tensor.shape) message->add_shape(static_cast<std::uint32_t>(extent));
  message->set_dtype(v1::Tensor::DTYPE_FLOAT32);
  message->clear_channels();
  for (const std::string& channel : tensor.channels) message->add_channels(channel);
  auto* values = message->mutable_values();
  values->Resize(static_cast<int>(tensor.values.size()), 0);
  std::copy(tensor.values.begin(), tensor.values.end(), values->mutable_data());
  message->clear_data();
}

v1::Tensor to_message(const Tensor& tensor) {
  v1::Tensor message;
  to_message(tensor, &message);
  return message;
}

Positions positions_from_message(const google::protobuf::RepeatedField<float>& values, Eigen::Index vertices,
                                 const std::string& field) {
  if (vertices >= 0 && values.size() != 3 * vertices) {
    throw_invalid_argument(field + ": " + std::to_string(values.size()) + " values, " + std::to_string(3 * vertices) +
                           " needed for " + std::to_string(vertices) + " vertices");
  }
  check_limit(values, 3 * kMaxVertices, field);
  check_finite(values.data(), static_cast<std::size_t>(values.size()), field);
  return matrix_of<Positions>(values, field);
}

Positions positions_from_message(const v1::Frame& frame, Eigen::Index vertices, const std::string& field) {
  return positions_from_message(frame.positions(), vertices, field + ".positions");
}

Topology from_message(const v1::Topology& message, const std::string& field) {
  check_limit(message.rest_positions(), 3 * kMaxVertices, field + ".rest_positions");
  check_limit(message.faces(), 3 * kMaxFaces, field + ".faces");
  check_limit(message.uv(), 2 * 3 * kMaxFaces, field + ".uv");
  check_limit(message.uv_faces(), 3 * kMaxFaces, field + ".uv_faces");
  Topology topology;
  topology.rest_positions = matrix_of<Positions>(message.rest_positions(), field + ".rest_positions");
  topology.faces = matrix_of<Faces>(message.faces(), field + ".faces");
  topology.uv = matrix_of<Uv>(message.uv(), field + ".uv");
  topology.uv_faces = matrix_of<Faces>(message.uv_faces(), field + ".uv_faces");
  if (topology.vertex_count() == 0) throw_invalid_argument(field + ".rest_positions: empty");
  if (topology.face_count() == 0) throw_invalid_argument(field + ".faces: empty");
  validate_topology(topology, field);
  if (!message.hash().empty() && message.hash() != topology_hash(topology)) {
    throw_invalid_argument(field + ".hash: " + message.hash() + " given, the mesh has " + topology_hash(topology));
  }
  return topology;
}

Frame from_message(const v1::Frame& message, Eigen::Index vertices, const std::string& field) {
  Frame frame;
  frame.index = message.index();
  frame.time_s = message.time_s();
  if (!std::isfinite(frame.time_s)) throw_invalid_argument(field + ".time_s: not finite");
  frame.positions = positions_from_message(message.positions(), vertices, field + ".positions");
  if (message.velocities_size() > 0) {
    frame.velocities = positions_from_message(message.velocities(), frame.positions.rows(), field + ".velocities");
  }
  return frame;
}

ObstacleShape from_message(const v1::ObstacleShape& message, const std::string& field) {
  if (message.name().empty()) throw_invalid_argument(field + ".name: empty");
  check_limit(message.faces(), 3 * kMaxFaces, field + ".faces");
  if (message.capsules() > 0 && message.faces_size() > 0) {
    throw_invalid_argument(field + " '" + message.name() + "': either capsules or faces, not both");
  }
  if (message.capsules() > static_cast<std::uint32_t>(kMaxCapsules)) {
    throw Error(ErrorCode::kResourceExhausted, field + ".capsules: " + std::to_string(message.capsules()) +
                                                   ", at most " + std::to_string(kMaxCapsules));
  }
  return {message.name(), matrix_of<Faces>(message.faces(), field + ".faces"), message.capsules()};
}

ObstacleFrame from_message(const v1::ObstacleFrame& message, const std::string& field) {
  ObstacleFrame obstacle;
  obstacle.name = message.name();
  if (obstacle.name.empty()) throw_invalid_argument(field + ".name: empty");
  const bool sphere = message.center_size() > 0 || message.radius() != 0;
  const bool capsules = message.capsule_ends_size() > 0 || message.capsule_radii_size() > 0;
  if (int{sphere} + int{capsules} + int{message.positions_size() > 0} != 1) {
    throw_invalid_argument(field + " '" + obstacle.name + "': either a sphere, capsules or positions are needed");
  }
  if (sphere) {
    obstacle.center = vector_of(message.center(), field + ".center");
    obstacle.radius = message.radius();
    if (!(obstacle.radius > 0) || !std::isfinite(obstacle.radius)) {
      throw_invalid_argument(field + ".radius: not greater than 0");
    }
  } else if (capsules) {
    check_limit(message.capsule_radii(), kMaxCapsules, field + ".capsule_radii");
    obstacle.capsule_ends =
        positions_from_message(message.capsule_ends(), 2 * message.capsule_radii_size(), field + ".capsule_ends");
    obstacle.capsule_radii.assign(message.capsule_radii().begin(), message.capsule_radii().end());
    for (const float radius : obstacle.capsule_radii) {
      if (!(radius > 0) || !std::isfinite(radius)) {
        throw_invalid_argument(field + ".capsule_radii: not all greater than 0");
      }
    }
  } else {
    obstacle.positions = positions_from_message(message.positions(), -1, field + ".positions");
  }
  return obstacle;
}

RigidTransform from_message(const v1::RigidTransform& message, const std::string& field) {
  if (message.rotation_size() != 9) {
    throw_invalid_argument(field + ".rotation: " + std::to_string(message.rotation_size()) + " values, 9 needed");
  }
  check_finite(message.rotation().data(), 9, field + ".rotation");
  RigidTransform transform;
  transform.rotation = Eigen::Map<const Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(message.rotation().data());
  transform.translation = vector_of(message.translation(), field + ".translation");
  const Eigen::Matrix3f square = transform.rotation * transform.rotation.transpose();
  if (!square.isIdentity(1e-3f) || transform.rotation.determinant() < 0) {
    throw_invalid_argument(field + ".rotation: not a rotation");
  }
  return transform;
}

Tensor from_message(const v1::Tensor& message, const std::string& field) {
  if (message.shape_size() == 0 || message.shape_size() > 4) {
    throw_invalid_argument(field + ".shape: " + std::to_string(message.shape_size()) + " extents, 1 to 4 needed");
  }
  Tensor tensor;
  std::uint64_t count = 1;
  for (const std::uint32_t extent : message.shape()) {
    if (extent == 0) throw_invalid_argument(field + ".shape: an extent is 0");
    if (count > kMaxTensorValues / extent) {
      throw Error(ErrorCode::kResourceExhausted,
                  field + ".shape: more than " + std::to_string(kMaxTensorValues) + " values");
    }
    count *= extent;
    tensor.shape.push_back(extent);
  }
  if (message.channels_size() != 0 && message.channels_size() != tensor.shape[0]) {
    throw_invalid_argument(field + ".channels: " + std::to_string(message.channels_size()) + " names, " +
                           std::to_string(tensor.shape[0]) + " channels");
  }
  tensor.channels.assign(message.channels().begin(), message.channels().end());
  if (message.dtype() == v1::Tensor::DTYPE_FLOAT32) {
    if (static_cast<std::uint64_t>(message.values_size()) != count || !message.data().empty()) {
      throw_invalid_argument(field + ".values: " + std::to_string(message.values_size()) + " values, the shape needs " +
                             std::to_string(count));
    }
    tensor.values.assign(message.values().begin(), message.values().end());
  } else if (message.dtype() == v1::Tensor::DTYPE_FLOAT16 || message.dtype() == v1::Tensor::DTYPE_BFLOAT16) {
    if (message.data().size() != 2 * count || message.values_size() != 0) {
      throw_invalid_argument(field + ".data: " + std::to_string(message.data().size()) + " bytes, the shape needs " +
                             std::to_string(2 * count));
    }
    tensor.values.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
      const auto low = static_cast<unsigned char>(message.data()[2 * i]);
      const auto high = static_cast<unsigned char>(message.data()[2 * i + 1]);
      const auto bits = static_cast<std::uint16_t>(low | (high << 8));
      tensor.values[i] = message.dtype() == v1::Tensor::DTYPE_FLOAT16 ? half_to_float(bits)
                                                                      : std::bit_cast<float>(std::uint32_t{bits} << 16);
    }
  } else {
    throw_invalid_argument(field + ".dtype: unknown type " + std::to_string(static_cast<int>(message.dtype())));
  }
  check_finite(tensor.values.data(), tensor.values.size(), field + ".values");
  return tensor;
}

std::vector<ObstacleFrame> match_obstacles(std::vector<ObstacleFrame> frames, const std::vector<ObstacleShape>& shapes,
                                           const std::string& field) {
  if (frames.size() != shapes.size()) {
    throw_invalid_argument(field + ": " + std::to_string(frames.size()) + " given, the session has " +
                           std::to_string(shapes.size()));
  }
  std::vector<ObstacleFrame> ordered;
  for (const ObstacleShape& shape : shapes) {
    const auto found = std::find_if(frames.begin(), frames.end(), [&](const auto& f) { return f.name == shape.name; });
    if (found == frames.end()) throw_invalid_argument(field + ": '" + shape.name + "' is missing");
    const char* kind = shape.faces.rows() > 0 ? "mesh" : shape.capsules > 0 ? "capsule set" : "sphere";
    if ((shape.faces.rows() > 0) != (found->positions.rows() > 0) ||
        (shape.capsules > 0) == found->capsule_radii.empty()) {
      throw_invalid_argument(field + ": '" + shape.name + "' is a " + kind + " in this session");
    }
    if (found->capsule_radii.size() != shape.capsules) {
      throw_invalid_argument(field + ": '" + shape.name + "' has " + std::to_string(found->capsule_radii.size()) +
                             " capsules instead of " + std::to_string(shape.capsules));
    }
    if (shape.faces.rows() > 0 && shape.faces.maxCoeff() >= static_cast<std::uint64_t>(found->positions.rows())) {
      throw_invalid_argument(field + ": '" + shape.name + "' has too few positions for its faces");
    }
    ordered.push_back(*found);
  }
  return ordered;
}

}  // namespace pleat
