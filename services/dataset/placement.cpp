#include "services/dataset/placement.hpp"

#include <Eigen/Geometry>
#include <algorithm>

#include "common/mesh/connectivity.hpp"

namespace pleat::dataset {

std::vector<std::uint32_t> upper_edge(const Topology& cloth) {
  const Connectivity connectivity = build_connectivity(cloth.vertex_count(), cloth.faces);
  std::vector<char> boundary(static_cast<std::size_t>(cloth.vertex_count()), 0);
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 == kNone) boundary[edge.v0] = boundary[edge.v1] = 1;
  }
  const float top = cloth.rest_positions.col(2).minCoeff();
  const float size = cloth.rest_positions.col(2).maxCoeff() - top;
  std::vector<std::uint32_t> vertices;
  for (Eigen::Index v = 0; v < cloth.vertex_count(); ++v) {
    if (boundary[static_cast<std::size_t>(v)] != 0 && cloth.rest_positions(v, 2) < top + 0.01f * size) {
      vertices.push_back(static_cast<std::uint32_t>(v));
    }
  }
  std::sort(vertices.begin(), vertices.end(),
            [&](std::uint32_t a, std::uint32_t b) { return cloth.rest_positions(a, 0) < cloth.rest_positions(b, 0); });
  return vertices;
}

Eigen::Vector3d tilt(double pitch_deg, double roll_deg, double yaw_deg) {
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(yaw_deg * kDegree, Eigen::Vector3d::UnitY()) *
                                      Eigen::AngleAxisd(roll_deg * kDegree, Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(pitch_deg * kDegree, Eigen::Vector3d::UnitX());
  const Eigen::AngleAxisd axis_angle(rotation);
  return axis_angle.angle() * axis_angle.axis();
}

}  // namespace pleat::dataset
