#include "services/presentation/report/capsule_surface.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <vector>

namespace pleat::presentation {
namespace {

constexpr int kAround = 16;
constexpr int kRingsOfACap = 4;  // the last one is where the side begins
constexpr int kRings = 2 * kRingsOfACap;
constexpr int kVertices = kAround * kRings + 2;  // and the two poles
constexpr int kFaces = 2 * kAround * kRings;

}  // namespace

Faces capsule_surface_faces(std::uint32_t capsules) {
  Faces faces(static_cast<Eigen::Index>(capsules) * kFaces, 3);
  Eigen::Index row = 0;
  for (std::uint32_t c = 0; c < capsules; ++c) {
    const std::uint32_t first = c * kVertices, south = first + kAround * kRings, north = south + 1;
    const auto vertex = [&](int ring, int i) {
      return first + static_cast<std::uint32_t>(ring * kAround + i % kAround);
    };
    for (int i = 0; i < kAround; ++i) {
      faces.row(row++) << south, vertex(0, i), vertex(0, i + 1);
      faces.row(row++) << north, vertex(kRings - 1, i + 1), vertex(kRings - 1, i);
      for (int ring = 0; ring + 1 < kRings; ++ring) {
        faces.row(row++) << vertex(ring, i), vertex(ring + 1, i), vertex(ring, i + 1);
        faces.row(row++) << vertex(ring, i + 1), vertex(ring + 1, i), vertex(ring + 1, i + 1);
      }
    }
  }
  return faces;
}

Positions capsule_surface(const ObstacleFrame& capsules) {
  using Eigen::Vector3f;
  const auto count = static_cast<Eigen::Index>(capsules.capsule_radii.size());
  Positions positions(count * kVertices, 3);
  for (Eigen::Index c = 0; c < count; ++c) {
    const float radius = capsules.capsule_radii[static_cast<std::size_t>(c)];
    const Vector3f a = capsules.capsule_ends.row(2 * c).transpose(),
                   b = capsules.capsule_ends.row(2 * c + 1).transpose();
    const Vector3f axis = (b - a).norm() > 0 ? Vector3f((b - a).normalized()) : Vector3f(Vector3f::UnitY());
    const Vector3f side = axis.unitOrthogonal(), other = axis.cross(side);
    Eigen::Index row = c * kVertices;
    for (int ring = 0; ring < kRings; ++ring) {
      const bool upper = ring >= kRingsOfACap;
      // From the south pole, -90 degrees, over the side, 0 twice, to the north pole.
      const int step = upper ? ring - kRingsOfACap : ring + 1 - kRingsOfACap;
      const float latitude = std::numbers::pi_v<float> / 2 * static_cast<float>(step) / kRingsOfACap;
      for (int i = 0; i < kAround; ++i) {
        const float longitude = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / kAround;
        const Vector3f out =
            std::cos(latitude) * (std::cos(longitude) * side - std::sin(longitude) * other) + std::sin(latitude) * axis;
        positions.row(row++) = ((upper ? b : a) + radius * out).transpose();
      }
    }
    positions.row(row++) = (a - radius * axis).transpose();
    positions.row(row) = (b + radius * axis).transpose();
  }
  return positions;
}

}  // namespace pleat::presentation
