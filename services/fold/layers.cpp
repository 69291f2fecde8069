#include "services/fold/layers.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/mesh/closest_points.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/fold/lanes.hpp"

namespace pleat::fold {
namespace {

using Eigen::Vector3d;

// The cosine of the angle between a way to another layer and the layer's normal, at least: what lies beside a vertex on
// its own layer is no other one.
constexpr double kAcross = 0.7;
constexpr int kMostSteps = 16;  // of a walk

Vector3d row(const Positions& positions, std::uint32_t vertex) {
  return positions.row(vertex).cast<double>().transpose();
}

}  // namespace

LayerFinder::LayerFinder(const Topology& coarse, const Subdivision& subdivision)
    : coarse_faces_(coarse.faces),
      fine_faces_(subdivision.fine.faces),
      rounds_(static_cast<int>(subdivision.level_sizes.size()) - 1) {
  const auto faces = static_cast<std::size_t>(coarse_faces_.rows());
  vertices_of_begin_.assign(faces + 1, 0);
  for (const std::uint32_t face : subdivision.parent_face) ++vertices_of_begin_[face + 1];
  std::partial_sum(vertices_of_begin_.begin(), vertices_of_begin_.end(), vertices_of_begin_.begin());
  vertices_of_.resize(subdivision.parent_face.size());
  std::vector<std::uint32_t> next(vertices_of_begin_.begin(), vertices_of_begin_.end() - 1);
  for (std::uint32_t v = 0; v < subdivision.parent_face.size(); ++v) {
    vertices_of_[next[subdivision.parent_face[v]]++] = v;
  }
  fine_neighbours_.assign(static_cast<std::size_t>(fine_faces_.rows()), {kNone, kNone, kNone});
  for (const Edge& edge : build_connectivity(subdivision.fine.vertex_count(), fine_faces_).edges) {
    if (edge.f1 == kNone) continue;
    for (int k = 0; k < 3; ++k) {
      const auto corner = static_cast<std::size_t>(k);
      if (fine_faces_(edge.f0, k) == edge.v0) fine_neighbours_[edge.f0][corner] = edge.f1;
      if (fine_faces_(edge.f1, k) == edge.v1) fine_neighbours_[edge.f1][corner] = edge.f0;
    }
  }
  boxes_.resize(faces);
  normals_.resize(faces);
  centers_.resize(faces);
  radii_.resize(faces);
  nearest_.resize(2 * subdivision.parent_face.size());
}

// The fine face at barycentric coordinates of a coarse one, which become those in the fine face. Children of a face are
// its three corners and the middle (subdivide()).
std::uint32_t LayerFinder::descend(std::uint32_t face, std::array<float, 3>& weights) const {
  Eigen::Index at = face;
  auto& [a, b, c] = weights;
  for (int round = 0; round < rounds_; ++round) {
    at *= 4;
    if (a >= 0.5f) {
      weights = {2 * a - 1, 2 * b, 2 * c};
    } else if (b >= 0.5f) {
      at += 1;
      weights = {2 * a, 2 * b - 1, 2 * c};
    } else if (c >= 0.5f) {
      at += 2;
      weights = {2 * a, 2 * b, 2 * c - 1};
    } else {
      at += 3;
      weights = {1 - 2 * c, 1 - 2 * a, 1 - 2 * b};
    }
  }
  return static_cast<std::uint32_t>(at);
}

// From face to face, towards where the contact's vertex stands before the fine layer along its normal. Returns whether
// it came to a face there.
bool LayerFinder::walk(const LayerContact& contact, std::span<const Float4> fine, std::uint32_t& face,
                       std::array<float, 3>& weights) const {
  for (int steps = 0; steps < kMostSteps; ++steps) {
    const auto row = static_cast<Eigen::Index>(face);
    const Float4 a = fine[fine_faces_(row, 0)], e1 = fine[fine_faces_(row, 1)] - a, e2 = fine[fine_faces_(row, 2)] - a;
    const Float4 way = fine[contact.vertex] - a;
    const float area = dot(contact.normal, cross(e1, e2));
    if (std::abs(area) < 1e-12f) return false;
    const float b = dot(contact.normal, cross(way, e2)) / area, c = dot(contact.normal, cross(e1, way)) / area;
    weights = {1 - b - c, b, c};
    const std::size_t least =
        weights[0] <= weights[1] ? (weights[0] <= weights[2] ? 0 : 2) : (weights[1] <= weights[2] ? 1 : 2);
    if (weights[least] >= 0) return true;
    face = fine_neighbours_[face][(least + 1) % 3];  // the edge opposite of the corner
    if (face == kNone) return false;
  }
  return false;
}

void LayerFinder::meet(std::uint32_t vertex, std::uint32_t own, std::uint32_t face, const Vector3d& point,
                       const Positions& coarse) {
  const Vector3d a = row(coarse, coarse_faces_(face, 0)), b = row(coarse, coarse_faces_(face, 1)),
                 c = row(coarse, coarse_faces_(face, 2));
  const double plane = normals_[face].dot(point - a);
  const bool below = plane * normals_[own].dot(normals_[face]) > 0;  // the other layer is, of the vertex's own
  Nearest& nearest = nearest_[2 * vertex + (below ? 1 : 0)];
  if (plane * plane > nearest.squared_distance) return;
  // Beside the face the distance is at least that to the circle about it.
  const double beside = (point - centers_[face]).norm() - radii_[face];
  if (beside > 0 && plane * plane <= kAcross * kAcross * beside * beside) return;
  const Vector3d weights = closest_on_triangle(point, a, b, c);
  const double distance = (point - weights[0] * a - weights[1] * b - weights[2] * c).squaredNorm();
  // Among equally near faces the first: the order in which they come depends on the frame that a stream began with.
  const bool nearer =
      distance < nearest.squared_distance || (distance == nearest.squared_distance && face < nearest.face);
  if (nearer && plane * plane > kAcross * kAcross * distance) {
    nearest = {distance, face, weights};
  }
}

std::span<const LayerContact> LayerFinder::find(const Positions& coarse, std::span<const Float4> upsampled,
                                                std::span<const Float4> fine, float reach, float thickness) {
  for (std::size_t f = 0; f < boxes_.size(); ++f) {
    const auto face = static_cast<Eigen::Index>(f);
    const Vector3d a = row(coarse, coarse_faces_(face, 0)), b = row(coarse, coarse_faces_(face, 1)),
                   c = row(coarse, coarse_faces_(face, 2));
    boxes_[f] = Box{};
    for (const Vector3d& corner : {a, b, c}) boxes_[f].extend(corner, static_cast<double>(reach) / 2);
    normals_[f] = (b - a).cross(c - a).stableNormalized();
    centers_[f] = (a + b + c) / 3;
    radii_[f] = std::sqrt(
        std::max({(a - centers_[f]).squaredNorm(), (b - centers_[f]).squaredNorm(), (c - centers_[f]).squaredNorm()}));
  }
  if (tree_.empty()) {
    tree_ = Bvh(boxes_);
  } else {
    tree_.refit(boxes_);
  }
  const double squared_reach = static_cast<double>(reach) * static_cast<double>(reach);
  for (Nearest& nearest : nearest_) nearest = {squared_reach, kNone, Vector3d::Zero()};
  const auto meet_all = [&](std::uint32_t of, std::uint32_t face) {
    // All on one side of the face's plane, and farther than the reach: most pairs whose boxes overlap.
    const Vector3d corner = row(coarse, coarse_faces_(face, 0));
    double least = 1e300, most = -1e300;
    for (int k = 0; k < 3; ++k) {
      const double height = normals_[face].dot(row(coarse, coarse_faces_(of, k)) - corner);
      least = std::min(least, height);
      most = std::max(most, height);
    }
    if (least >= static_cast<double>(reach) || most <= -static_cast<double>(reach)) return;
    // All beside the face rather than across, as meet() has it for a vertex: faces around on the same layer.
    const double beside = (centers_[of] - centers_[face]).norm() - radii_[of] - radii_[face];
    const double across = std::max(std::abs(least), std::abs(most));
    if (beside > 0 && across <= kAcross * beside) return;
    for (const std::uint32_t v : vertices_of(of)) {
      const Float4 p = upsampled[v];
      meet(v, of, face, {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])}, coarse);
    }
  };
  tree_.visit_self_pairs([&](std::uint32_t f, std::uint32_t g) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        if (coarse_faces_(f, i) == coarse_faces_(g, j)) return true;
      }
    }
    meet_all(f, g);
    meet_all(g, f);
    return true;
  });
  contacts_.clear();
  for (std::uint32_t k = 0; k < nearest_.size(); ++k) {
    const Nearest& nearest = nearest_[k];
    const std::uint32_t v = k / 2;
    if (nearest.face == kNone || nearest.squared_distance <= 0) continue;
    LayerContact contact{};
    contact.vertex = v;
    contact.weights = {static_cast<float>(nearest.weights[0]), static_cast<float>(nearest.weights[1]),
                       static_cast<float>(nearest.weights[2])};
    const Float4 p = upsampled[v];
    const Vector3d point(static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2]));
    const bool above = normals_[nearest.face].dot(point - row(coarse, coarse_faces_(nearest.face, 0))) > 0;
    contact.normal = to_float4(above ? normals_[nearest.face] : Vector3d(-normals_[nearest.face]));
    contact.gap = std::min(thickness, static_cast<float>(std::sqrt(nearest.squared_distance)));
    std::uint32_t face = descend(nearest.face, contact.weights), walked = face;
    std::array<float, 3> weights = contact.weights;
    if (walk(contact, fine, walked, weights)) {
      face = walked;
      contact.weights = weights;
    }
    for (int c = 0; c < 3; ++c) contact.face[static_cast<std::size_t>(c)] = fine_faces_(face, c);
    contacts_.push_back(contact);
  }
  return contacts_;
}

}  // namespace pleat::fold
