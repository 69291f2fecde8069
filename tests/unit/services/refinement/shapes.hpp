// Cloths and obstacles for the tests of this room.
#pragma once

#include <cmath>
#include <numbers>
#include <random>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "common/mesh/obj.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::test {

struct Cloth {
  Topology coarse;
  Subdivision subdivision;
  const Topology& fine() const { return subdivision.fine; }
};

inline Cloth load_cloth(const std::string& name) {
  Cloth cloth;
  cloth.coarse = read_obj("deploy/garments/" + name + ".obj");
  cloth.subdivision = subdivide(cloth.coarse, 2);
  return cloth;
}

/// A square sheet of n x n quads in the plane y = 0, corner at the origin.
inline Topology square_sheet(int n, float size) {
  Topology t;
  t.rest_positions.resize((n + 1) * (n + 1), 3);
  t.faces.resize(2 * n * n, 3);
  for (int i = 0; i <= n; ++i) {
    for (int j = 0; j <= n; ++j) {
      t.rest_positions.row(i * (n + 1) + j) << size * static_cast<float>(j) / static_cast<float>(n), 0,
          -size * static_cast<float>(i) / static_cast<float>(n);
    }
  }
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const auto a = static_cast<std::uint32_t>(i * (n + 1) + j), b = a + 1, c = a + static_cast<std::uint32_t>(n) + 1;
      t.faces.row(2 * (i * n + j)) << a, b, c + 1;
      t.faces.row(2 * (i * n + j) + 1) << a, c + 1, c;
    }
  }
  t.uv = Uv(t.rest_positions.rows(), 2);
  t.uv.col(0) = t.rest_positions.col(0);
  t.uv.col(1) = -t.rest_positions.col(2);
  t.uv_faces = t.faces;
  return t;
}

/// A coarse sheet that lies smoothly in waves, without self-intersection.
inline Positions wavy(const Positions& rest) {
  Positions x = rest;
  for (Eigen::Index v = 0; v < x.rows(); ++v) {
    x(v, 1) += 0.08f * std::sin(6 * rest(v, 0) + 1) * std::cos(5 * rest(v, 2));
  }
  return x;
}

inline Positions noise(Eigen::Index count, float sigma, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0, sigma);
  return Positions::NullaryExpr(count, 3, [&](Eigen::Index, Eigen::Index) { return normal(random); });
}

/// A closed, outwards oriented mesh of a torus around the y axis.
struct ClosedMesh {
  Positions positions;
  Faces faces;
};
inline ClosedMesh torus(float major, float minor, int around = 32, int across = 16) {
  ClosedMesh mesh;
  mesh.positions.resize(around * across, 3);
  mesh.faces.resize(2 * around * across, 3);
  const auto angle = [](int i, int n) {
    return 2 * std::numbers::pi_v<float> * static_cast<float>(i) / static_cast<float>(n);
  };
  for (int i = 0; i < around; ++i) {
    for (int j = 0; j < across; ++j) {
      const float a = angle(i, around), b = angle(j, across), r = major + minor * std::cos(b);
      mesh.positions.row(i * across + j) << r * std::cos(a), minor * std::sin(b), -r * std::sin(a);
      const auto at = [&](int p, int q) { return static_cast<std::uint32_t>((p % around) * across + q % across); };
      mesh.faces.row(2 * (i * across + j)) << at(i, j), at(i + 1, j), at(i + 1, j + 1);
      mesh.faces.row(2 * (i * across + j) + 1) << at(i, j), at(i + 1, j + 1), at(i, j + 1);
    }
  }
  return mesh;
}

/// A cube from -half to half.
inline ClosedMesh cube(float half) {
  ClosedMesh mesh;
  mesh.positions.resize(8, 3);
  for (int i = 0; i < 8; ++i) {
    mesh.positions.row(i) << ((i & 1) != 0 ? half : -half), ((i & 2) != 0 ? half : -half),
        ((i & 4) != 0 ? half : -half);
  }
  mesh.faces.resize(12, 3);
  mesh.faces << 0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7,
      5;
  return mesh;
}

inline ObstacleFrame sphere(const std::string& name, const Eigen::Vector3f& center, float radius) {
  ObstacleFrame frame;
  frame.name = name;
  frame.center = center;
  frame.radius = radius;
  return frame;
}

}  // namespace pleat::test
