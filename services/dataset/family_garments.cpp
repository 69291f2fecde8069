#include "services/dataset/family_garments.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>

#include "services/dataset/planar_mesh.hpp"

namespace pleat::dataset {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;

constexpr double kShortest = 0.015, kLongest = 0.060;  // m, edges
constexpr double kFewest = 120, kMost = 450;           // vertices
constexpr double kCell = 0.93;                         // edges^2 of cloth for a vertex, between squares and triangles
constexpr int kCurve = 240;                            // pieces of a curve before it is cut
constexpr double kGap = 2;                             // edges, between panels in material space

constexpr const char* kPatterns[] = {"square", "diagonals", "hexagonal", "irregular"};

double log_uniform(Random& random, double low, double high) {
  return low * std::exp(random.uniform(0, 1) * std::log(high / low));
}

/// A closed curve r(t), t from 0 to 1, as `pieces` sides of polylines.
std::vector<Points> curve(const std::function<Vector2d(double)>& r, int pieces = 1) {
  std::vector<Points> sides;
  for (int s = 0; s < pieces; ++s) {
    Points side;
    for (int k = 0; k <= kCurve; ++k) side.push_back(r((s + static_cast<double>(k) / kCurve) / pieces));
    sides.push_back(std::move(side));
  }
  return sides;
}

std::vector<Points> polygon(const Points& corners) {
  std::vector<Points> sides;
  for (std::size_t i = 0; i < corners.size(); ++i) sides.push_back({corners[i], corners[(i + 1) % corners.size()]});
  return sides;
}

Vector2d at_angle(double radius, double angle) { return radius * Vector2d(std::cos(angle), std::sin(angle)); }

/// Of unit size, about: scaled to its area later.
std::vector<Points> outline_of(const std::string& shape, Random& random) {
  if (shape == "ellipse") {
    const double aspect = random.uniform(1, 1.7);
    return curve([=](double t) { return Vector2d(aspect * std::cos(2 * kPi * t), std::sin(2 * kPi * t)); });
  }
  if (shape == "flower") {
    const double waves = 3 + static_cast<double>(random.below(3)), depth = random.uniform(0.1, 0.25);
    return curve([=](double t) { return at_angle(1 + depth * std::cos(waves * 2 * kPi * t), 2 * kPi * t); });
  }
  if (shape == "half disc") {
    std::vector<Points> sides = curve([](double t) { return at_angle(1, kPi * t); });
    sides.push_back({Vector2d(-1, 0), Vector2d(1, 0)});
    return sides;
  }
  if (shape == "polygon") {
    constexpr int kCorners[] = {3, 5, 6, 8};
    const int corners = kCorners[random.below(std::size(kCorners))];
    Points points;
    for (int k = 0; k < corners; ++k) points.push_back(at_angle(1, 2 * kPi * k / corners));
    return polygon(points);
  }
  if (shape == "L") {
    const double x = random.uniform(0.35, 0.6), y = random.uniform(0.35, 0.6), width = random.uniform(1, 1.5);
    return polygon({{0, 0}, {width, 0}, {width, y}, {x, y}, {x, 1}, {0, 1}});
  }
  if (shape == "trapezoid") {
    const double top = random.uniform(0.4, 0.8), shift = random.uniform(-0.2, 0.2), height = random.uniform(0.6, 1.3);
    return polygon({{-0.5, 0}, {0.5, 0}, {top / 2 + shift, height}, {-top / 2 + shift, height}});
  }
  const double length = random.uniform(1, 3);
  return polygon({{0, 0}, {length, 0}, {length, 1}, {0, 1}});
}

double area_of(const std::vector<Points>& sides) {
  double sum = 0;
  for (const Points& side : sides) {
    for (std::size_t i = 1; i < side.size(); ++i) {
      sum += 0.5 * (side[i - 1].x() * side[i].y() - side[i].x() * side[i - 1].y());
    }
  }
  return sum;
}

void scale(std::vector<Points>& sides, double factor) {
  for (Points& side : sides) {
    for (Vector2d& p : side) p *= factor;
  }
}

/// Where the thread runs: radians from the outline's own axes.
double grain(Random& random) {
  const double angle = random.uniform(-kPi, kPi);
  return random.below(3) == 0 ? 0 : angle;
}

void set_positions(const std::vector<Vector3d>& positions, Topology& mesh) {
  mesh.rest_positions.resize(static_cast<Eigen::Index>(positions.size()), 3);
  for (std::size_t v = 0; v < positions.size(); ++v) {
    mesh.rest_positions.row(static_cast<Eigen::Index>(v)) = positions[v].cast<float>();
  }
}

FamilyGarment flat_garment(const std::string& shape, double edge, double vertices, Random& random) {
  std::vector<Points> sides = outline_of(shape, random);
  scale(sides, std::sqrt(vertices * kCell * edge * edge / area_of(sides)));
  const std::size_t pattern = random.below(std::size(kPatterns));
  const Points outline = cut_sides(sides, edge);
  const PlanarMesh plane = mesh_outline(outline, edge, static_cast<Pattern>(pattern), random);
  FamilyGarment garment;
  garment.edge = edge;
  garment.shape = shape + ", " + kPatterns[pattern];
  const auto count = static_cast<Eigen::Index>(plane.points.size());
  garment.mesh.rest_positions.resize(count, 3);
  garment.mesh.uv.resize(count, 2);
  const Eigen::Rotation2Dd turn(grain(random));
  for (Eigen::Index v = 0; v < count; ++v) {
    const Vector2d& p = plane.points[static_cast<std::size_t>(v)];
    garment.mesh.rest_positions.row(v) << static_cast<float>(p.x()), 0.0F, static_cast<float>(-p.y());
    garment.mesh.uv.row(v) = (turn * p).cast<float>().transpose();
  }
  garment.mesh.faces.resize(static_cast<Eigen::Index>(plane.faces.size()), 3);
  for (std::size_t f = 0; f < plane.faces.size(); ++f) {
    const auto& face = plane.faces[f];
    garment.mesh.faces.row(static_cast<Eigen::Index>(f)) << face[0], face[1], face[2];
  }
  garment.mesh.uv_faces = garment.mesh.faces;
  garment.borders.resize(1);
  for (std::uint32_t i = 0; i < outline.size(); ++i) garment.borders[0].push_back(i);
  return garment;
}

/// A ring of equal panels that are sewn together: a tube, or a sector of a disc's ring that becomes a cone.
struct Ring {
  int panels = 1;
  double angle = 0;             ///< of the whole sector; 0: a tube
  double upper = 0, lower = 0;  ///< radii of the sector; of a tube heights, upper = 0
  double around = 0;            ///< circumference of a tube

  /// A panel laid flat, symmetric about u = 0: t from -0.5 to 0.5 across it, s from 0 (lower rim) to 1.
  Vector2d flat(double t, double s) const {
    const double radius = lower + s * (upper - lower);
    if (angle == 0) return {t * around / panels, -radius};
    const double theta = t * angle / panels;
    return {radius * std::sin(theta), -radius * std::cos(theta)};
  }
  /// A point of panel k in space.
  Vector3d worn(const Vector2d& p, int k) const {
    if (angle == 0) {
      const double phi = 2 * kPi * (k + 0.5) / panels + 2 * kPi * p.x() / around, r = around / (2 * kPi);
      return {r * std::sin(phi), p.y(), r * std::cos(phi)};
    }
    const double radius = p.norm(), theta = std::atan2(p.x(), -p.y());
    const double phi = 2 * kPi * (k + 0.5) / panels + theta * 2 * kPi / angle, slope = angle / (2 * kPi);
    const double r = slope * radius;
    return {r * std::sin(phi), -radius * std::sqrt(std::max(0.0, 1 - slope * slope)), r * std::cos(phi)};
  }
  double area() const { return angle == 0 ? around * (lower - upper) : 0.5 * angle * (lower * lower - upper * upper); }
};

FamilyGarment ring_garment(bool skirt, double edge, double vertices, Random& random) {
  Ring ring;
  ring.panels = 1 + static_cast<int>(random.below(4));
  if (skirt) {
    ring.angle = random.uniform(0.4, 1.8) * kPi;
    ring.upper = 1, ring.lower = random.uniform(2, 4);
  } else {
    ring.around = 1, ring.lower = random.uniform(0.4, 1.5);
  }
  const double size = std::sqrt(vertices * kCell * edge * edge / ring.area());
  ring.around *= size, ring.upper *= size, ring.lower *= size;
  // Two edges of a panel's upper rim at least: with one each, two panels would share it.
  const double rim = skirt ? ring.angle * ring.upper : ring.around;
  ring.panels = std::clamp(static_cast<int>(rim / (2 * edge)), 1, ring.panels);
  // The lower rim to the right, up, the upper rim to the left, down.
  const auto side = [&](double t0, double s0, double t1, double s1) {
    Points points;
    for (int k = 0; k <= kCurve; ++k) {
      const double x = static_cast<double>(k) / kCurve;
      points.push_back(ring.flat(t0 + x * (t1 - t0), s0 + x * (s1 - s0)));
    }
    return points;
  };
  const std::vector<Points> sides{side(-0.5, 0, 0.5, 0), side(0.5, 0, 0.5, 1), side(0.5, 1, -0.5, 1),
                                  side(-0.5, 1, -0.5, 0)};
  const Points outline = cut_sides(sides, edge);
  std::array<std::uint32_t, 5> corner{};  // where the sides begin
  for (std::size_t k = 0; k < sides.size(); ++k) {
    corner[k + 1] = corner[k] + static_cast<std::uint32_t>(cut_sides({sides[k]}, edge).size());
  }
  const std::uint32_t height = corner[2] - corner[1], last = corner[4];
  const std::size_t pattern = random.below(std::size(kPatterns));
  const Eigen::Rotation2Dd turn(grain(random));

  FamilyGarment garment;
  garment.ring = true;
  garment.edge = edge;
  garment.shape =
      std::string(skirt ? "skirt" : "tube") + " of " + std::to_string(ring.panels) + ", " + kPatterns[pattern];
  garment.borders.resize(2);
  std::vector<Vector3d> positions;
  std::vector<Vector2d> uv;
  std::vector<std::array<std::uint32_t, 3>> faces, uv_faces;
  std::vector<std::uint32_t> first_left, right;  // vertices of seams, from the lower rim up
  double place = 0;                              // where the next panel begins in material space
  for (int k = 0; k < ring.panels; ++k) {
    const PlanarMesh plane = mesh_outline(outline, edge, static_cast<Pattern>(pattern), random);
    const bool closes = k + 1 == ring.panels;
    std::vector<std::uint32_t> vertex(plane.points.size(), ~0U);
    const auto left_of = [&](std::uint32_t i) { return (last - i) % last; };  // i-th from the lower rim up
    const std::vector<std::uint32_t> before = right;
    right.clear();
    if (k > 0) {
      for (std::uint32_t i = 0; i <= height; ++i) vertex[left_of(i)] = before[i];
    }
    const auto add = [&](std::uint32_t p) {
      if (vertex[p] != ~0U) return;
      vertex[p] = static_cast<std::uint32_t>(positions.size());
      positions.push_back(ring.worn(plane.points[p], k));
    };
    if (k == 0) {
      for (std::uint32_t i = 0; i <= height; ++i) {
        add(left_of(i));
        first_left.push_back(vertex[left_of(i)]);
      }
    }
    for (std::uint32_t i = 0; i <= height; ++i) {
      if (closes) vertex[corner[1] + i] = first_left[i];
      add(corner[1] + i);
      right.push_back(vertex[corner[1] + i]);
    }
    for (std::uint32_t p = 0; p < plane.points.size(); ++p) add(p);
    for (std::uint32_t i = 0; i < corner[1]; ++i) garment.borders[1].push_back(vertex[i]);
    // The upper rim goes the other way in the outline.
    for (std::uint32_t i = corner[3]; i > corner[2]; --i) garment.borders[0].push_back(vertex[i]);

    Points laid;
    for (const Vector2d& p : plane.points) laid.push_back(turn * p);
    double low = laid.front().x(), high = low;
    for (const Vector2d& p : laid) low = std::min(low, p.x()), high = std::max(high, p.x());
    const auto first_uv = static_cast<std::uint32_t>(uv.size());
    for (const Vector2d& p : laid) uv.emplace_back(p.x() - low + place, p.y());
    place += high - low + kGap * edge;
    for (const auto& face : plane.faces) {
      faces.push_back({vertex[face[0]], vertex[face[1]], vertex[face[2]]});
      uv_faces.push_back({first_uv + face[0], first_uv + face[1], first_uv + face[2]});
    }
  }
  Topology& mesh = garment.mesh;
  set_positions(positions, mesh);
  mesh.uv.resize(static_cast<Eigen::Index>(uv.size()), 2);
  for (std::size_t i = 0; i < uv.size(); ++i)
    mesh.uv.row(static_cast<Eigen::Index>(i)) = uv[i].cast<float>().transpose();
  mesh.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  mesh.uv_faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    mesh.faces.row(static_cast<Eigen::Index>(f)) << faces[f][0], faces[f][1], faces[f][2];
    mesh.uv_faces.row(static_cast<Eigen::Index>(f)) << uv_faces[f][0], uv_faces[f][1], uv_faces[f][2];
  }
  return garment;
}

}  // namespace

FamilyGarment family_garment(std::size_t kind, Random& random) {
  constexpr const char* kKinds[kFamilyKinds] = {"rectangle", "skirt", "ellipse", "rectangle", "tube",      "polygon",
                                                "skirt",     "L",     "flower",  "rectangle", "half disc", "trapezoid"};
  const std::string shape = kKinds[kind % kFamilyKinds];
  const double edge = log_uniform(random, kShortest, kLongest), vertices = log_uniform(random, kFewest, kMost);
  if (shape == "skirt" || shape == "tube") return ring_garment(shape == "skirt", edge, vertices, random);
  return flat_garment(shape, edge, vertices, random);
}

}  // namespace pleat::dataset
