#include "common/client/adapter/adapter.hpp"

#include <algorithm>
#include <iterator>

namespace pleat::client {
namespace {

template <typename Matrix>
std::vector<typename Matrix::Scalar> values_of(const Matrix& matrix) {
  return {matrix.data(), matrix.data() + matrix.size()};
}

template <typename Matrix>
Matrix matrix_of(std::span<const typename Matrix::Scalar> values) {
  constexpr Eigen::Index columns = Matrix::ColsAtCompileTime;
  return Eigen::Map<const Matrix>(values.data(), static_cast<Eigen::Index>(values.size()) / columns, columns);
}

template <typename To, typename From, typename Convert>
std::vector<To> converted(const std::vector<From>& from, Convert&& convert) {
  std::vector<To> to;
  to.reserve(from.size());
  std::transform(from.begin(), from.end(), std::back_inserter(to), convert);
  return to;
}

}  // namespace

Mesh from_topology(const Topology& topology) {
  return {values_of(topology.rest_positions), values_of(topology.faces), values_of(topology.uv),
          values_of(topology.uv_faces)};
}

Topology to_topology(const Mesh& mesh) {
  Topology topology;
  topology.rest_positions = matrix_of<Positions>(mesh.positions);
  topology.faces = matrix_of<Faces>(mesh.faces);
  topology.uv = matrix_of<Uv>(mesh.uv);
  topology.uv_faces = matrix_of<Faces>(mesh.uv_faces);
  return topology;
}

std::vector<float> from_positions(const Positions& positions) { return values_of(positions); }
Positions to_positions(std::span<const float> values) { return matrix_of<Positions>(values); }

std::vector<ObstacleShape> from_shapes(const std::vector<pleat::ObstacleShape>& shapes) {
  return converted<ObstacleShape>(shapes, [](const pleat::ObstacleShape& shape) {
    return ObstacleShape{shape.name, values_of(shape.faces), shape.capsules};
  });
}

std::vector<pleat::ObstacleShape> to_shapes(const std::vector<ObstacleShape>& shapes) {
  return converted<pleat::ObstacleShape>(shapes, [](const ObstacleShape& shape) {
    return pleat::ObstacleShape{shape.name, matrix_of<Faces>(shape.faces), shape.capsules};
  });
}

std::vector<ObstacleFrame> from_obstacles(const std::vector<pleat::ObstacleFrame>& obstacles) {
  return converted<ObstacleFrame>(obstacles, [](const pleat::ObstacleFrame& obstacle) {
    return ObstacleFrame{obstacle.name,
                         {obstacle.center.x(), obstacle.center.y(), obstacle.center.z()},
                         obstacle.radius,
                         values_of(obstacle.positions),
                         values_of(obstacle.capsule_ends),
                         obstacle.capsule_radii};
  });
}

std::vector<pleat::ObstacleFrame> to_obstacles(const std::vector<ObstacleFrame>& obstacles) {
  return converted<pleat::ObstacleFrame>(obstacles, [](const ObstacleFrame& obstacle) {
    return pleat::ObstacleFrame{obstacle.name,
                                Eigen::Map<const Eigen::Vector3f>(obstacle.center.data()),
                                obstacle.radius,
                                matrix_of<Positions>(obstacle.positions),
                                matrix_of<Positions>(obstacle.capsule_ends),
                                obstacle.capsule_radii};
  });
}

}  // namespace pleat::client
