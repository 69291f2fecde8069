#include "services/dataset/flat_sets.hpp"

#include <cmath>
#include <numbers>

#include "services/dataset/placement.hpp"

namespace pleat::dataset {
namespace {

using Eigen::Vector3d;

constexpr double kTop = 1.5;  // m: the held edge of the sheet
// Amplitude of the bumps that a sheet starts with. A flat one buckles as rounding decides, and nothing in the coarse
// sheet tells how (docs/datasets.md).
constexpr double kBumps = 0.02;
constexpr double kBallRadii[] = {0.10, 0.15, 0.20}, kPoleRadii[] = {0.03, 0.05, 0.08};
constexpr double kPoleHalfLength = 0.9;

constexpr double kCylinderRadius = 0.3, kCylinderHeight = 0.7;
constexpr int kCylinderSides = 48;
constexpr double kHeldRadius = 0.2;           // m about the middle of the disk
constexpr double kOnTop = 6e-3;               // m above the cylinder: more than any repulsion layer
constexpr double kSlowest = 1, kFastest = 8;  // m/s

simulation::Handle held(std::vector<std::uint32_t> vertices) {
  simulation::Handle handle;
  handle.name = "held";
  handle.vertices = std::move(vertices);
  handle.hard = true;
  return handle;
}

// From side to side, `swing` away and back, from start_s until the end.
void go_back_and_forth(simulation::Obstacle& obstacle, const Vector3d& swing, double start_s, double half_period_s,
                       double duration_s) {
  for (int k = 0; start_s + (k - 1) * half_period_s < duration_s; ++k) {
    simulation::KeyFrame key;
    key.time_s = start_s + k * half_period_s;
    key.translation = k % 2 == 0 ? Vector3d(Vector3d::Zero()) : swing;
    obstacle.motion.keys.push_back(key);
  }
}

}  // namespace

Topology cylinder() {
  constexpr auto kSides = static_cast<Eigen::Index>(kCylinderSides);
  Topology mesh;
  mesh.rest_positions.resize(2 * kSides + 2, 3);
  mesh.faces.resize(4 * kSides, 3);
  mesh.rest_positions.row(2 * kSides) << 0, 0, 0;
  mesh.rest_positions.row(2 * kSides + 1) << 0, static_cast<float>(kCylinderHeight), 0;
  const auto bottom = static_cast<std::uint32_t>(2 * kSides), top = bottom + 1;
  for (Eigen::Index k = 0; k < kSides; ++k) {
    const double angle = 2 * std::numbers::pi * static_cast<double>(k) / kCylinderSides;
    const Vector3d rim(kCylinderRadius * std::cos(angle), 0, kCylinderRadius * std::sin(angle));
    mesh.rest_positions.row(k) = rim.cast<float>();
    mesh.rest_positions.row(kSides + k) = (rim + Vector3d(0, kCylinderHeight, 0)).cast<float>();
    const auto low = static_cast<std::uint32_t>(k), next = static_cast<std::uint32_t>((k + 1) % kSides);
    const std::uint32_t high = low + kCylinderSides, high_next = next + kCylinderSides;
    mesh.faces.row(4 * k) << low, high, next;
    mesh.faces.row(4 * k + 1) << next, high, high_next;
    mesh.faces.row(4 * k + 2) << bottom, low, next;
    mesh.faces.row(4 * k + 3) << top, high_next, high;
  }
  return mesh;
}

Topology box(const Eigen::Vector3d& sides) {
  Topology mesh;
  mesh.rest_positions.resize(8, 3);
  for (Eigen::Index v = 0; v < 8; ++v) {
    const Vector3d corner((v & 1) != 0 ? 0.5 : -0.5, (v & 2) != 0 ? 0.5 : -0.5, (v & 4) != 0 ? 0.5 : -0.5);
    mesh.rest_positions.row(v) = corner.cwiseProduct(sides).cast<float>();
  }
  mesh.faces.resize(12, 3);
  mesh.faces << 0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7,
      5;
  return mesh;
}

simulation::Scene sheet_scene(const Topology& cloth, double duration_s, std::size_t index, Random& random) {
  simulation::Scene scene;
  scene.garment = cloth;
  // Every start meets every shape, and every shape all its sizes.
  const bool falls = index % 2 != 0, pole = index / 2 % 2 != 0;
  const std::size_t size = index / 4 % 3;
  // Falling, the far edge starts a little higher than the held one, clear of the obstacle.
  scene.transform.rotation = tilt(falls ? random.uniform(-20, 0) : 90, 0, 0);
  scene.transform.translation.y() = kTop;
  scene.perturbation_m = kBumps;
  const std::vector<std::uint32_t> edge = upper_edge(cloth);
  scene.handles = {held({edge.front(), edge.back()})};

  const double middle =
      0.5 * static_cast<double>(cloth.rest_positions.col(0).minCoeff() + cloth.rest_positions.col(0).maxCoeff());
  simulation::Obstacle obstacle;
  const double radius = pole ? kPoleRadii[size] : kBallRadii[size];
  const double side = random.uniform(-1, 1) < 0 ? -1 : 1;
  const double reach = random.uniform(0.5, 0.9) + radius;
  const Vector3d start(middle + random.uniform(-0.15, 0.15), kTop - random.uniform(0.45, 0.75), side * reach);
  const double speed = random.uniform(0.3, 1);
  const Vector3d swing(0, random.uniform(-0.1, 0.1), -2 * side * reach);
  if (pole) {
    obstacle.name = "pole";
    const double yaw = random.uniform(-15, 15) * kDegree, roll = random.uniform(-15, 15) * kDegree;
    const Vector3d half =
        kPoleHalfLength * Vector3d(std::cos(yaw) * std::cos(roll), std::sin(roll), std::sin(yaw) * std::cos(roll));
    obstacle.capsules = {{start - half, start + half, radius}};
  } else {
    obstacle.name = "ball";
    obstacle.center = start;
    obstacle.radius = radius;
  }
  go_back_and_forth(obstacle, swing, falls ? 0.5 : 1.0, swing.norm() / speed, duration_s);
  scene.obstacles = {obstacle};
  return scene;
}

simulation::Scene disk_scene(const Topology& cloth, std::size_t index, Random& random) {
  simulation::Scene scene;
  scene.garment = cloth;
  scene.transform.rotation = tilt(0, 0, random.uniform(-180, 180));
  scene.transform.translation.y() = kCylinderHeight + kOnTop;
  std::vector<std::uint32_t> middle;
  for (Eigen::Index v = 0; v < cloth.vertex_count(); ++v) {
    if (static_cast<double>(cloth.rest_positions.row(v).norm()) < kHeldRadius) {
      middle.push_back(static_cast<std::uint32_t>(v));
    }
  }
  scene.handles = {held(std::move(middle))};
  simulation::Obstacle table;
  table.name = "table";
  table.mesh = cylinder();
  scene.obstacles = {table};

  // Steps of the golden ratio through the range: neighbours differ, and any first few cover it.
  const double golden = 0.6180339887498949;
  const double place = std::fmod((static_cast<double>(index) + 0.5) * golden, 1.0);
  const double speed = kSlowest + (kFastest - kSlowest) * place;
  const double direction = random.uniform(-std::numbers::pi, std::numbers::pi);
  scene.wind.velocity = speed * Vector3d(std::cos(direction), 0, std::sin(direction));
  return scene;
}

}  // namespace pleat::dataset
