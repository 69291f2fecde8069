#include "common/frame/messages.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <span>

#ifdef __F16C__
#include <immintrin.h>
#endif

#include "common/base/checks.hpp"
#include "common/base/limits.hpp"

namespace pleat {
namespace {

constexpr std::uint64_t kMaxTensorValues = 16u << 20;  // 64 MiB of float32, the message limit

template <typename Matrix, typename Scalar>
void assign(const Matrix& matrix, google::protobuf::RepeatedField<Scalar>* field) {
  field->Resize(static_cast<int>(matrix.size()), Scalar{});
  std::copy_n(matrix.data(), matrix.size(), field->mutable_data());
}

template <typename Matrix, typename Scalar>
Matrix matrix_of(const google::protobuf::RepeatedField<Scalar>& values, const std::string& field) {
  constexpr int columns = Matrix::ColsAtCompileTime;
  check_rows(static_cast<std::size_t>(values.size()), columns, field);
  Matrix matrix(values.size() / columns, columns);
  std::copy_n(values.data(), values.size(), matrix.data());
  return matrix;
}

template <typename Scalar>
std::span<const Scalar> span_of(const google::protobuf::RepeatedField<Scalar>& values) {
  return {values.data(), static_cast<std::size_t>(values.size())};
}

Eigen::Vector3f vector_of(const google::protobuf::RepeatedField<float>& values, const std::string& field) {
  if (values.size() != 3) throw_invalid_argument(field + ": " + std::to_string(values.size()) + " values, 3 needed");
  check_finite(span_of(values), field);
  return {values[0], values[1], values[2]};
}

/// bfloat16 is the upper half of a float32; rounded to the nearest, ties to even.
std::uint16_t to_bfloat16(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  if ((bits & 0x7fffffffu) > 0x7f800000u) return static_cast<std::uint16_t>((bits >> 16) | 0x40u);
  return static_cast<std::uint16_t>((bits + 0x7fffu + ((bits >> 16) & 1u)) >> 16);
}

/// Eight values at a time where the processor can; Eigen's own takes twenty times as long, with the same result.
void to_halves(std::span<const float> values, Eigen::half* halves) {
  std::size_t i = 0;
#ifdef __F16C__
  for (; i + 8 <= values.size(); i += 8) {
    const __m128i eight = _mm256_cvtps_ph(_mm256_loadu_ps(values.data() + i), _MM_FROUND_TO_NEAREST_INT);
    std::memcpy(static_cast<void*>(halves + i), &eight, sizeof(eight));
  }
#endif
  for (; i < values.size(); ++i) halves[i] = Eigen::half(values[i]);
}

/// values.size() halves, which need not be aligned.
void from_halves(const char* bytes, std::span<float> values) {
  std::size_t i = 0;
#ifdef __F16C__
  for (; i + 8 <= values.size(); i += 8) {
    __m128i eight;
    std::memcpy(&eight, bytes + 2 * i, sizeof(eight));
    _mm256_storeu_ps(values.data() + i, _mm256_cvtph_ps(eight));
  }
#endif
  for (; i < values.size(); ++i) {
    Eigen::half one;
    std::memcpy(static_cast<void*>(&one), bytes + 2 * i, sizeof(one));
    values[i] = static_cast<float>(one);
  }
}

/// Block by block: a string that grows first is filled with zeros first, and that costs as much again.
template <typename Half, typename Convert>
void append_halves(const std::vector<float>& values, const Convert& convert, std::string& data) {
  std::array<Half, 1024> block;
  for (std::size_t begin = 0; begin < values.size(); begin += block.size()) {
    const std::size_t count = std::min(block.size(), values.size() - begin);
    convert(std::span(values).subspan(begin, count), block.data());
    data.append(reinterpret_cast<const char*>(block.data()), 2 * count);
  }
}

std::size_t value_bytes(v1::Tensor::DType dtype) { return dtype == v1::Tensor::DTYPE_FLOAT32 ? 4 : 2; }

/// Throws unless there are as many values as the shape says, in one form.
void check_count(const v1::Tensor& message, std::uint64_t count, const std::string& field) {
  const bool bytes = !message.data().empty();
  if (message.dtype() == v1::Tensor::DTYPE_FLOAT32 && !bytes) {
    if (static_cast<std::uint64_t>(message.values_size()) == count) return;
    throw_invalid_argument(field + ".values: " + std::to_string(message.values_size()) + " values, the shape needs " +
                           std::to_string(count));
  }
  const std::size_t needed = count * value_bytes(message.dtype());
  if (message.data().size() == needed && message.values_size() == 0) return;
  throw_invalid_argument(field + ".data: " + std::to_string(message.data().size()) + " bytes and " +
                         std::to_string(message.values_size()) + " values, the shape needs " + std::to_string(needed) +
                         " bytes");
}

/// Values of any type -> float32. values: as many as the shape says.
void read_values(const v1::Tensor& message, std::vector<float>& values, const std::string& field) {
  const char* bytes = message.data().data();
  switch (message.dtype()) {
    case v1::Tensor::DTYPE_FLOAT32:
      if (message.data().empty()) {
        std::copy(message.values().begin(), message.values().end(), values.begin());
      } else {
        std::memcpy(values.data(), bytes, 4 * values.size());
      }
      return;
    case v1::Tensor::DTYPE_FLOAT16:
      return from_halves(bytes, values);
    case v1::Tensor::DTYPE_BFLOAT16:
      for (std::size_t i = 0; i < values.size(); ++i) {
        std::uint16_t upper = 0;
        std::memcpy(&upper, bytes + 2 * i, 2);
        values[i] = std::bit_cast<float>(std::uint32_t{upper} << 16);
      }
      return;
    default:
      throw_invalid_argument(field + ".dtype: unknown type " + std::to_string(static_cast<int>(message.dtype())));
  }
}

/// The shape, and the number of values.
std::uint64_t read_shape(const v1::Tensor& message, std::vector<std::int64_t>& shape, const std::string& field) {
  if (message.shape_size() == 0 || message.shape_size() > 4) {
    throw_invalid_argument(field + ".shape: " + std::to_string(message.shape_size()) + " extents, 1 to 4 needed");
  }
  shape.clear();
  std::uint64_t count = 1;
  for (const std::uint32_t extent : message.shape()) {
    if (extent == 0) throw_invalid_argument(field + ".shape: an extent is 0");
    if (count > kMaxTensorValues / extent) {
      throw Error(ErrorCode::kResourceExhausted,
                  field + ".shape: more than " + std::to_string(kMaxTensorValues) + " values");
    }
    count *= extent;
    shape.push_back(extent);
  }
  return count;
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
  check_limit(span_of(values).size(), 3 * kMaxVertices, field);
  check_finite(span_of(values), field);
  return matrix_of<Positions>(values, field);
}

Positions positions_from_message(const v1::Frame& frame, Eigen::Index vertices, const std::string& field) {
  return positions_from_message(frame.positions(), vertices, field + ".positions");
}

Topology from_message(const v1::Topology& message, const std::string& field) {
  check_limit(span_of(message.rest_positions()).size(), 3 * kMaxVertices, field + ".rest_positions");
  check_limit(span_of(message.faces()).size(), 3 * kMaxFaces, field + ".faces");
  check_limit(span_of(message.uv()).size(), 2 * 3 * kMaxFaces, field + ".uv");
  check_limit(span_of(message.uv_faces()).size(), 3 * kMaxFaces, field + ".uv_faces");
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
  check_limit(span_of(message.faces()).size(), 3 * kMaxFaces, field + ".faces");
  if (message.capsules() > 0 && message.faces_size() > 0) {
    throw_invalid_argument(field + " '" + message.name() + "': either capsules or faces, not both");
  }
  if (message.capsules() > kMaxCapsules) {
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
    check_limit(span_of(message.capsule_radii()).size(), kMaxCapsules, field + ".capsule_radii");
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
  check_finite(span_of(message.rotation()), field + ".rotation");
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
  Tensor tensor;
  from_payload(message, field, &tensor);
  if (message.channels_size() != 0 && message.channels_size() != tensor.shape[0]) {
    throw_invalid_argument(field + ".channels: " + std::to_string(message.channels_size()) + " names, " +
                           std::to_string(tensor.shape[0]) + " channels");
  }
  tensor.channels.assign(message.channels().begin(), message.channels().end());
  check_finite(tensor.values, field + ".values");
  return tensor;
}

void from_payload(const v1::Tensor& message, const std::string& field, Tensor* tensor) {
  const std::uint64_t count = read_shape(message, tensor->shape, field);
  check_count(message, count, field);
  tensor->channels.clear();
  tensor->values.resize(count);
  read_values(message, tensor->values, field);
}

void to_payload(const Tensor& tensor, v1::Tensor::DType dtype, v1::Tensor* message) {
  message->clear_shape();
  for (const std::int64_t extent : tensor.shape) message->add_shape(static_cast<std::uint32_t>(extent));
  message->set_dtype(dtype);
  message->clear_channels();
  message->clear_values();
  std::string& data = *message->mutable_data();
  data.clear();
  data.reserve(tensor.values.size() * value_bytes(dtype));
  switch (dtype) {
    case v1::Tensor::DTYPE_FLOAT16:
      return append_halves<Eigen::half>(tensor.values, to_halves, data);
    case v1::Tensor::DTYPE_BFLOAT16:
      return append_halves<std::uint16_t>(
          tensor.values,
          [](std::span<const float> values, std::uint16_t* halves) {
            std::transform(values.begin(), values.end(), halves, to_bfloat16);
          },
          data);
    case v1::Tensor::DTYPE_FLOAT32:
      data.append(reinterpret_cast<const char*>(tensor.values.data()), 4 * tensor.values.size());
      return;
    default:
      throw_invalid_argument("tensor: unknown type " + std::to_string(static_cast<int>(dtype)));
  }
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
