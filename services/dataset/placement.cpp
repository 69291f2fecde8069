#include "services/dataset/placement.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::dataset {

bool is_upright(const Topology& cloth) {
  const Eigen::RowVector3f size = cloth.rest_positions.colwise().maxCoeff() - cloth.rest_positions.colwise().minCoeff();
  return size.y() > 0.25f * size.maxCoeff();
}

std::vector<std::uint32_t> upper_edge(const Topology& cloth) {
  const Connectivity connectivity = build_connectivity(cloth.vertex_count(), cloth.faces);
  std::vector<char> boundary(static_cast<std::size_t>(cloth.vertex_count()), 0);
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 == kNone) boundary[edge.v0] = boundary[edge.v1] = 1;
  }
  const bool upright = is_upright(cloth);
  const Eigen::VectorXf depth =
      upright ? Eigen::VectorXf(-cloth.rest_positions.col(1)) : Eigen::VectorXf(cloth.rest_positions.col(2));
  const float size = depth.maxCoeff() - depth.minCoeff();
  std::vector<std::uint32_t> vertices;
  for (const bool on_boundary : {true, false}) {
    float top = std::numeric_limits<float>::max();
    const auto usable = [&](Eigen::Index v) { return !on_boundary || boundary[static_cast<std::size_t>(v)] != 0; };
    for (Eigen::Index v = 0; v < depth.size(); ++v) {
      if (usable(v)) top = std::min(top, depth[v]);
    }
    for (Eigen::Index v = 0; v < depth.size(); ++v) {
      if (usable(v) && depth[v] < top + 0.01f * size) vertices.push_back(static_cast<std::uint32_t>(v));
    }
    if (!vertices.empty()) break;
  }
  std::sort(vertices.begin(), vertices.end(),
            [&](std::uint32_t a, std::uint32_t b) { return cloth.rest_positions(a, 0) < cloth.rest_positions(b, 0); });
  return vertices;
}

void add_next_highest(const Topology& cloth, std::size_t count, std::vector<std::uint32_t>& edge) {
  const int axis = is_upright(cloth) ? 1 : 2;
  const float up = axis == 1 ? 1.0f : -1.0f;
  std::vector<std::uint32_t> others;
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(cloth.vertex_count()); ++v) {
    if (std::find(edge.begin(), edge.end(), v) == edge.end()) others.push_back(v);
  }
  std::stable_sort(others.begin(), others.end(), [&](std::uint32_t a, std::uint32_t b) {
    return up * cloth.rest_positions(a, axis) > up * cloth.rest_positions(b, axis);
  });
  for (const std::uint32_t v : others) {
    if (edge.size() >= count) return;
    edge.push_back(v);
  }
}

std::string fault_of_start(const simulation::Scene& scene) {
  try {
    const simulation::Simulation started(scene, simulation::Mode::kCoarse);
    return "";
  } catch (const Error& error) {
    if (error.code() != ErrorCode::kInvalidArgument) throw;
    return error.what();
  }
}

Eigen::Vector3d tilt(double pitch_deg, double roll_deg, double yaw_deg) {
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(yaw_deg * kDegree, Eigen::Vector3d::UnitY()) *
                                      Eigen::AngleAxisd(roll_deg * kDegree, Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(pitch_deg * kDegree, Eigen::Vector3d::UnitX());
  const Eigen::AngleAxisd axis_angle(rotation);
  return axis_angle.angle() * axis_angle.axis();
}

}  // namespace pleat::dataset
