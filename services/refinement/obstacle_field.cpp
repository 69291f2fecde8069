#include "services/refinement/obstacle_field.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/triangle_intersection.hpp"

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3d;

Vec3 point(const Positions& positions, std::uint32_t v) { return positions.row(v).cast<double>(); }

Triangle3f corners(const Positions& positions, const Faces& faces, std::uint32_t f) {
  return {positions.row(faces(f, 0)), positions.row(faces(f, 1)), positions.row(faces(f, 2))};
}

Box box_of(const Triangle3f& t) {
  Box box;
  for (const Eigen::Vector3f& p : t) box.extend(Vec3(p.cast<double>()));
  return box;
}

double squared_distance(const Box& box, const Vec3& p) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) {
    const double outside =
        std::max({static_cast<double>(box.lower[k]) - p[k], p[k] - static_cast<double>(box.upper[k]), 0.0});
    sum += outside * outside;
  }
  return sum;
}

// Adds `move` to the point with barycentric coordinates b of a face by moving its corners as little as possible.
void move_point(Positions& positions, const Faces& faces, std::uint32_t face, const Vec3& b, const Vec3& move) {
  const Vec3 scaled = move / b.squaredNorm();
  for (int k = 0; k < 3; ++k) positions.row(faces(face, k)) += (b[k] * scaled).cast<float>().transpose();
}

}  // namespace

MeshObstacle::MeshObstacle(const Faces& faces, Eigen::Index vertex_count, const std::string& name) : faces_(faces) {
  Topology topology;
  topology.rest_positions = Positions::Zero(vertex_count, 3);
  topology.faces = faces;
  validate_topology(topology, "obstacle " + name);
  Connectivity connectivity = build_connectivity(vertex_count, faces);
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 == kNone) {
      throw_invalid_argument("obstacle " + name + ": the mesh is not closed at edge " + std::to_string(edge.v0) + "-" +
                             std::to_string(edge.v1));
    }
  }
  face_edges_ = std::move(connectivity.face_edges);
  edge_count_ = connectivity.edges.size();
  boxes_.resize(static_cast<std::size_t>(faces.rows()));
  face_normals_.resize(boxes_.size());
}

void MeshObstacle::update(const Positions& positions) {
  positions_ = positions;
  vertex_normals_.assign(static_cast<std::size_t>(positions.rows()), Vec3::Zero());
  edge_normals_.assign(edge_count_, Vec3::Zero());
  for (std::uint32_t f = 0; f < boxes_.size(); ++f) {
    boxes_[f] = box_of(corners(positions, faces_, f));
    std::array<Vec3, 3> x;
    for (int k = 0; k < 3; ++k) x[static_cast<std::size_t>(k)] = point(positions, faces_(f, k));
    Vec3 normal = (x[1] - x[0]).cross(x[2] - x[0]);
    const double length = normal.norm();
    normal = length > 0 ? Vec3(normal / length) : Vec3(Vec3::Zero());
    face_normals_[f] = normal;
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec3 u = x[(k + 1) % 3] - x[k], v = x[(k + 2) % 3] - x[k];
      vertex_normals_[faces_(f, static_cast<Eigen::Index>(k))] += std::atan2(u.cross(v).norm(), u.dot(v)) * normal;
      edge_normals_[face_edges_[f][k]] += normal;
    }
  }
  for (Vec3& n : vertex_normals_) n.normalize();
  for (Vec3& n : edge_normals_) n.normalize();
  if (tree_.empty()) {
    tree_ = Bvh(boxes_);
  } else {
    tree_.refit(boxes_);
  }
}

std::optional<ObstacleContact> MeshObstacle::contact(const Vec3& p, double reach) const {
  if (squared_distance(bounds(), p) > reach * reach) return std::nullopt;
  double best = std::numeric_limits<double>::max();
  std::uint32_t best_face = 0;
  Vec3 best_weights = Vec3::Zero();
  double diagonal = 0;
  for (int k = 0; k < 3; ++k)
    diagonal += static_cast<double>(bounds().upper[k]) - static_cast<double>(bounds().lower[k]);
  // Growing boxes around p: the nearest face is found once it is nearer than the box is wide.
  for (double radius = std::max(reach, 1e-3 * diagonal);; radius *= 2) {
    Box box;
    box.extend(p, radius);
    tree_.query(box, [&](std::uint32_t f) {
      if (squared_distance(boxes_[f], p) >= best) return;
      const Vec3 a = point(positions_, faces_(f, 0)), b = point(positions_, faces_(f, 1)),
                 c = point(positions_, faces_(f, 2));
      const Vec3 weights = closest_on_triangle(p, a, b, c);
      const double squared = (p - weights[0] * a - weights[1] * b - weights[2] * c).squaredNorm();
      if (squared < best) {
        best = squared;
        best_face = f;
        best_weights = weights;
      }
    });
    if (best <= radius * radius || radius > 2 * diagonal + reach) break;
  }
  if (best == std::numeric_limits<double>::max()) return std::nullopt;

  Vec3 closest = Vec3::Zero();
  for (int k = 0; k < 3; ++k) closest += best_weights[k] * point(positions_, faces_(best_face, k));
  Vec3 normal = face_normals_[best_face];
  constexpr double kOnBoundary = 1e-9;
  for (int k = 0; k < 3; ++k) {
    if (best_weights[k] > 1 - kOnBoundary) {
      normal = vertex_normals_[faces_(best_face, k)];
    } else if (best_weights[k] < kOnBoundary && best_weights.maxCoeff() <= 1 - kOnBoundary) {
      normal = edge_normals_[face_edges_[best_face][static_cast<std::size_t>((k + 1) % 3)]];
    }
  }
  const Vec3 offset = p - closest;
  const double length = std::sqrt(best);
  const bool inside = offset.dot(normal) < 0;
  const double distance = inside ? -length : length;
  if (distance > reach) return std::nullopt;
  return ObstacleContact{distance, length > 1e-9 ? Vec3(offset / distance) : normal};
}

template <typename Visit>
void MeshObstacle::visit_intersecting(const Triangle3f& triangle, const Visit& visit) const {
  const Box box = box_of(triangle);
  if (!bounds().overlaps(box)) return;
  tree_.query(box, [&](std::uint32_t f) {
    if (triangles_intersect(triangle, corners(positions_, faces_, f))) visit(f);
  });
}

bool MeshObstacle::intersects(const Triangle3f& triangle) const {
  bool found = false;
  visit_intersecting(triangle, [&](std::uint32_t) { found = true; });
  return found;
}

std::vector<std::uint32_t> MeshObstacle::intersecting_vertices(const Triangle3f& triangle) const {
  std::vector<std::uint32_t> vertices;
  visit_intersecting(triangle, [&](std::uint32_t f) {
    for (int k = 0; k < 3; ++k) vertices.push_back(faces_(f, k));
  });
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  return vertices;
}

struct ObstacleField::Part {
  std::string name;
  Faces faces;                         // of a mesh
  std::unique_ptr<MeshObstacle> mesh;  // made by the first frame, which tells the vertex count
  Vec3 center = Vec3::Zero();          // sphere
  double radius = 0;                   // sphere
  bool present = false;                // in this frame

  bool sphere_contains(const Vec3& closest) const { return (closest - center).norm() < radius - kPenetrationTolerance; }
  // Barycentric coordinates of the face's point nearest to the sphere's centre, and that point.
  std::pair<Vec3, Vec3> nearest_to_center(const Positions& positions, const Faces& cloth, std::uint32_t face) const {
    const Vec3 a = point(positions, cloth(face, 0)), b = point(positions, cloth(face, 1)),
               c = point(positions, cloth(face, 2));
    const Vec3 weights = closest_on_triangle(center, a, b, c);
    return {weights, weights[0] * a + weights[1] * b + weights[2] * c};
  }
};

ObstacleField::ObstacleField(std::span<const ObstacleShape> shapes) {
  for (const ObstacleShape& shape : shapes) {
    if (shape.name.empty()) throw_invalid_argument("an obstacle has no name");
    for (const Part& part : parts_) {
      if (part.name == shape.name) throw_invalid_argument("obstacle " + shape.name + " is there twice");
    }
    Part part;
    part.name = shape.name;
    part.faces = shape.faces;
    parts_.push_back(std::move(part));
  }
}

ObstacleField::~ObstacleField() = default;
ObstacleField::ObstacleField(ObstacleField&&) noexcept = default;
ObstacleField& ObstacleField::operator=(ObstacleField&&) noexcept = default;

void ObstacleField::update(std::span<const ObstacleFrame> frames) {
  for (Part& part : parts_) part.present = false;
  for (const ObstacleFrame& frame : frames) {
    auto part = std::find_if(parts_.begin(), parts_.end(), [&](const Part& p) { return p.name == frame.name; });
    if (part == parts_.end()) {
      if (frame.positions.rows() != 0) throw_invalid_argument("obstacle " + frame.name + ": a mesh without its faces");
      Part sphere;
      sphere.name = frame.name;
      parts_.push_back(std::move(sphere));
      part = parts_.end() - 1;
    }
    if (part->present) throw_invalid_argument("obstacle " + frame.name + " is twice in one frame");
    part->present = true;
    if (part->faces.rows() == 0) {
      if (!frame.center.allFinite() || !std::isfinite(frame.radius) || frame.radius <= 0 ||
          frame.positions.rows() != 0) {
        throw_invalid_argument("obstacle " + frame.name + ": a sphere needs a finite centre and a radius above 0");
      }
      part->center = frame.center.cast<double>();
      part->radius = static_cast<double>(frame.radius);
      continue;
    }
    if (frame.positions.rows() == 0 || !frame.positions.allFinite()) {
      throw_invalid_argument("obstacle " + frame.name + ": positions are absent or not finite");
    }
    if (part->mesh == nullptr) {
      part->mesh = std::make_unique<MeshObstacle>(part->faces, frame.positions.rows(), part->name);
    } else if (frame.positions.rows() != part->mesh->positions().rows()) {
      throw_invalid_argument("obstacle " + frame.name + ": " + std::to_string(frame.positions.rows()) +
                             " positions, earlier " + std::to_string(part->mesh->positions().rows()));
    }
    part->mesh->update(frame.positions);
  }
  for (const Part& part : parts_) {
    if (!part.present && part.faces.rows() != 0)
      throw_invalid_argument("obstacle " + part.name + " is not in the frame");
  }
}

bool ObstacleField::empty() const {
  return std::none_of(parts_.begin(), parts_.end(), [](const Part& part) { return part.present; });
}

std::vector<Box> ObstacleField::bounds(double margin) const {
  std::vector<Box> boxes;
  for (const Part& part : parts_) {
    if (!part.present) continue;
    Box box;
    if (part.mesh == nullptr) {
      box.extend(part.center, part.radius + margin);
    } else {
      for (const auto& corner : {part.mesh->bounds().lower, part.mesh->bounds().upper}) {
        box.extend(Vec3(static_cast<double>(corner[0]), static_cast<double>(corner[1]), static_cast<double>(corner[2])),
                   margin);
      }
    }
    boxes.push_back(box);
  }
  return boxes;
}

std::optional<ObstacleContact> ObstacleField::contact(const Vec3& p, double reach) const {
  std::optional<ObstacleContact> deepest;
  for (const Part& part : parts_) {
    if (!part.present) continue;
    std::optional<ObstacleContact> found;
    if (part.mesh != nullptr) {
      found = part.mesh->contact(p, reach);
    } else {
      const Vec3 offset = p - part.center;
      const double length = offset.norm();
      if (length - part.radius > reach) continue;
      found = ObstacleContact{length - part.radius, length > 1e-9 ? Vec3(offset / length) : Vec3(Vec3::UnitY())};
    }
    if (found && (!deepest || found->distance < deepest->distance)) deepest = found;
  }
  return deepest;
}

bool ObstacleField::penetrates(const Positions& positions, const Faces& faces, std::uint32_t face) const {
  for (const Part& part : parts_) {
    if (!part.present) continue;
    if (part.mesh == nullptr) {
      if (part.sphere_contains(part.nearest_to_center(positions, faces, face).second)) return true;
      continue;
    }
    const Triangle3f triangle = corners(positions, faces, face);
    if (!part.mesh->bounds().overlaps(box_of(triangle))) continue;
    if (part.mesh->intersects(triangle)) return true;
    // Not crossing the surface, the face is inside as a whole or not at all.
    const auto contact = part.mesh->contact(triangle[0].cast<double>(), 0);
    if (contact && contact->distance < -kPenetrationTolerance) return true;
  }
  return false;
}

std::vector<std::uint32_t> ObstacleField::find(const Positions& positions, const Faces& faces) const {
  std::vector<std::uint32_t> found;
  if (empty()) return found;
  for (std::uint32_t f = 0; f < static_cast<std::uint32_t>(faces.rows()); ++f) {
    if (penetrates(positions, faces, f)) found.push_back(f);
  }
  return found;
}

bool ObstacleField::push_face_out(Positions& positions, const Faces& faces, std::uint32_t face,
                                  double clearance) const {
  bool moved = false;
  for (const Part& part : parts_) {
    if (!part.present) continue;
    if (part.mesh == nullptr) {
      const auto [weights, nearest] = part.nearest_to_center(positions, faces, face);
      if (!part.sphere_contains(nearest)) continue;
      const Vec3 offset = nearest - part.center;
      const double length = offset.norm();
      const Vec3 normal = length > 1e-9 ? Vec3(offset / length) : Vec3(Vec3::UnitY());
      move_point(positions, faces, face, weights, (part.radius + 0.5 * clearance - length) * normal);
      moved = true;
      continue;
    }
    // Corners of the obstacle that stick through the face push it along their normals.
    for (const std::uint32_t v : part.mesh->intersecting_vertices(corners(positions, faces, face))) {
      const Vec3 q = point(part.mesh->positions(), v), normal = part.mesh->vertex_normal(v);
      const Vec3 a = point(positions, faces(face, 0)), b = point(positions, faces(face, 1)),
                 c = point(positions, faces(face, 2));
      const Vec3 weights = closest_on_triangle(q, a, b, c);
      const double depth = (q - weights[0] * a - weights[1] * b - weights[2] * c).dot(normal);
      if (depth <= 0) continue;
      move_point(positions, faces, face, weights, (depth + 0.5 * clearance) * normal);
      moved = true;
    }
  }
  return moved;
}

}  // namespace pleat
