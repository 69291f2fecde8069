#include "services/fold/layers.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/mesh/closest_points.hpp"
#include "common/mesh/closest_points8.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/fold/lanes.hpp"

namespace pleat::fold {
namespace {

using Eigen::Vector3d;

// The cosine of the angle between a way to another layer and the layer's normal, at least: what lies beside a vertex on
// its own layer is no other one.
constexpr double kAcross = 0.7;
constexpr int kMostSteps = 16;      // of a walk
constexpr float kRounding = 1e-5f;  // m: of float32, and more; nothing that is as near is left out by it

Vector3d row(const Positions& positions, std::uint32_t vertex) {
  return positions.row(vertex).cast<double>().transpose();
}

Vector3d to_vector(Float4 v) {
  return {static_cast<double>(v[0]), static_cast<double>(v[1]), static_cast<double>(v[2])};
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
  shapes_.resize(faces);
  slots_.resize(vertices_of_.size());
  blocks_begin_.assign(1, 0);
  for (std::uint32_t face = 0; face < faces; ++face) {
    const std::span<const std::uint32_t> members = vertices_of(face);
    const std::uint32_t first = blocks_begin_.back() * static_cast<std::uint32_t>(kLanes);
    for (std::uint32_t i = 0; i < members.size(); ++i) slots_[members[i]] = first + i;
    blocks_begin_.push_back(blocks_begin_.back() + static_cast<std::uint32_t>((members.size() + kLanes - 1) / kLanes));
  }
  blocks_.resize(blocks_begin_.back());
  nearest_.resize(blocks_.size() * kLanes);
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

void LayerFinder::place_vertices(std::span<const Float4> upsampled) {
  for (std::uint32_t face = 0; face < shapes_.size(); ++face) {
    const std::span<const std::uint32_t> members = vertices_of(face);
    for (std::size_t i = 0; i < members.size(); ++i) {
      Block& block = blocks_[blocks_begin_[face] + i / kLanes];
      const auto lane = static_cast<int>(i % kLanes);
      block.x[lane] = upsampled[members[i]][0];
      block.y[lane] = upsampled[members[i]][1];
      block.z[lane] = upsampled[members[i]][2];
    }
  }
}

void LayerFinder::measure_faces(const Positions& coarse, float reach) {
  for (std::size_t f = 0; f < shapes_.size(); ++f) {
    FaceShape& shape = shapes_[f];
    boxes_[f] = Box{};
    shape.center = Float4{};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t corner = coarse_faces_(static_cast<Eigen::Index>(f), static_cast<Eigen::Index>(k));
      boxes_[f].extend(row(coarse, corner), static_cast<double>(reach) / 2);
      shape.corners[k] = to_float4(coarse.row(corner).transpose());
      shape.center += shape.corners[k] / 3;
    }
    shape.normal = cross(shape.corners[1] - shape.corners[0], shape.corners[2] - shape.corners[0]);
    const float area = std::sqrt(dot(shape.normal, shape.normal));
    if (area > 0) shape.normal /= area;
    shape.radius = 0;
    for (const Float4& corner : shape.corners) {
      const Float4 offset = corner - shape.center;
      shape.radius = std::max(shape.radius, std::sqrt(dot(offset, offset)));
    }
  }
}

Vector3d LayerFinder::point_of(std::uint32_t slot) const {
  const Block& block = blocks_[slot / kLanes];
  const auto lane = static_cast<int>(slot % kLanes);
  return {static_cast<double>(block.x[lane]), static_cast<double>(block.y[lane]), static_cast<double>(block.z[lane])};
}

// The vertex of a slot and the nearest point of a face.
void LayerFinder::meet(std::uint32_t slot, std::size_t side, std::uint32_t face) {
  Block& block = blocks_[slot / kLanes];
  const auto lane = static_cast<int>(slot % kLanes);
  const Vector3d point = point_of(slot);
  const FaceShape& shape = shapes_[face];
  const Vector3d a = to_vector(shape.corners[0]), b = to_vector(shape.corners[1]), c = to_vector(shape.corners[2]);
  const Vector3d weights = closest_on_triangle(point, a, b, c);
  const double distance = (point - weights[0] * a - weights[1] * b - weights[2] * c).squaredNorm();
  const double plane = to_vector(shape.normal).dot(point - a);
  Nearest& nearest = nearest_[slot][side];
  // Among equally near faces the first: the order in which they come depends on the frame that a stream began with.
  const bool nearer =
      distance < nearest.squared_distance || (distance == nearest.squared_distance && face < nearest.face);
  if (!nearer || plane * plane <= kAcross * kAcross * distance) return;
  nearest = {distance, face};
  block.bound[side][lane] = static_cast<float>(std::sqrt(distance)) + kRounding;
}

// The vertices of one coarse face and the points of another one.
void LayerFinder::meet_all(std::uint32_t own, std::uint32_t face, float reach) {
  const FaceShape &from = shapes_[own], &to = shapes_[face];
  // All on one side of the face's plane, and farther than the reach: most pairs whose boxes overlap.
  float least = 1e30f, most = -1e30f;
  for (const Float4& corner : from.corners) {
    const float height = dot(to.normal, corner - to.corners[0]);
    least = std::min(least, height);
    most = std::max(most, height);
  }
  if (least >= reach || most <= -reach) return;
  // All beside the face rather than across, as for a vertex below: faces around on the same layer.
  constexpr auto kSlope = static_cast<float>(kAcross);
  const Float4 offset = from.center - to.center;
  const float apart = std::sqrt(dot(offset, offset)) - from.radius - to.radius;
  if (apart > 0 && std::max(std::abs(least), std::abs(most)) <= kSlope * apart) return;
  const float facing = dot(from.normal, to.normal);
  std::array<Points8, 3> corners;
  for (std::size_t k = 0; k < 3; ++k) {
    corners[k] = {broadcast8(to.corners[k][0]), broadcast8(to.corners[k][1]), broadcast8(to.corners[k][2])};
  }
  for (std::uint32_t at = blocks_begin_[own]; at < blocks_begin_[own + 1]; ++at) {
    const Block& block = blocks_[at];
    const Float8 plane = to.normal[0] * (block.x - to.corners[0][0]) + to.normal[1] * (block.y - to.corners[0][1]) +
                         to.normal[2] * (block.z - to.corners[0][2]);
    const Int8 below = facing * plane > 0;  // the other layer is, of the vertex's own
    const Float8 height = abs(plane);
    // In the face's plane the way to the face is at least that to the circle about it.
    const Float8 x = block.x - to.center[0], y = block.y - to.center[1], z = block.z - to.center[2];
    const Float8 beside = max(sqrt(max(x * x + y * y + z * z - height * height, Float8{})) - to.radius, Float8{});
    const Float8 bound = select(below, block.bound[1], block.bound[0]), squared = height * height + beside * beside;
    const Int8 near = (squared <= bound * abs(bound)) & (height * height > kSlope * kSlope * squared);
    if (bits(near) == 0) continue;
    const Points8 points{block.x, block.y, block.z};
    const Float8 error =
        max(rounding(points), max(rounding(corners[0]), max(rounding(corners[1]), rounding(corners[2]))));
    const Float8 away = at_least(squared_vertex_face_distance(points, corners[0], corners[1], corners[2]), error);
    const Int8 nearest = near & (away <= bound) & (height + 4 * error > kSlope * away);
    const std::uint32_t is_below = bits(below);
    for (std::uint32_t lanes = bits(nearest); lanes != 0; lanes &= lanes - 1) {
      const auto lane = static_cast<std::uint32_t>(__builtin_ctz(lanes));
      meet(at * static_cast<std::uint32_t>(kLanes) + lane, (is_below >> lane) & 1, face);
    }
  }
}

std::span<const LayerContact> LayerFinder::find(const Positions& coarse, std::span<const Float4> upsampled,
                                                std::span<const Float4> fine, float reach, float thickness) {
  measure_faces(coarse, reach);
  place_vertices(upsampled);
  if (tree_.empty()) {
    tree_ = Bvh(boxes_);
  } else {
    tree_.refit(boxes_);
  }
  const double squared_reach = static_cast<double>(reach) * static_cast<double>(reach);
  for (auto& sides : nearest_) sides.fill({squared_reach, kNone});
  for (std::uint32_t face = 0; face < shapes_.size(); ++face) {
    const std::size_t members = vertices_of(face).size();
    for (std::size_t i = 0; i < (members + kLanes - 1) / kLanes * kLanes; ++i) {
      for (Float8& bound : blocks_[blocks_begin_[face] + i / kLanes].bound) {
        bound[static_cast<int>(i % kLanes)] = i < members ? reach : -1;
      }
    }
  }
  for (std::uint32_t f = 0; f < shapes_.size(); ++f) {
    const std::array<std::uint32_t, 3> v{coarse_faces_(f, 0), coarse_faces_(f, 1), coarse_faces_(f, 2)};
    tree_.query(boxes_[f], [&](std::uint32_t g) {
      if (g <= f) return;
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t w = coarse_faces_(g, k);
        if (w == v[0] || w == v[1] || w == v[2]) return;
      }
      meet_all(f, g, reach);
      meet_all(g, f, reach);
    });
  }
  contacts_.clear();
  for (std::uint32_t k = 0; k < 2 * slots_.size(); ++k) {
    const std::uint32_t v = k / 2;
    const Nearest& nearest = nearest_[slots_[v]][k % 2];
    if (nearest.face == kNone || nearest.squared_distance <= 0) continue;
    LayerContact contact{};
    contact.vertex = v;
    const FaceShape& shape = shapes_[nearest.face];
    const Vector3d weights_there = closest_on_triangle(point_of(slots_[v]), to_vector(shape.corners[0]),
                                                       to_vector(shape.corners[1]), to_vector(shape.corners[2]));
    contact.weights = {static_cast<float>(weights_there[0]), static_cast<float>(weights_there[1]),
                       static_cast<float>(weights_there[2])};
    contact.normal = dot(shape.normal, upsampled[v] - shape.corners[0]) > 0 ? shape.normal : -shape.normal;
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
