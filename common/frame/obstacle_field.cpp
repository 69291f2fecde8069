#include "common/frame/obstacle_field.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <string>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"
#include "common/mesh/triangle_intersection.hpp"

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3d;
using Vec3f = Eigen::Vector3f;

// Nearer to the surface or to an axis than this, the direction to it says nothing.
constexpr double kNoDirection = 1e-9;

Vec3 point(const Positions& positions, std::uint32_t v) { return positions.row(v).cast<double>(); }

Triangle3f corners(const Positions& positions, const Faces& faces, std::uint32_t f) {
  return {positions.row(faces(f, 0)), positions.row(faces(f, 1)), positions.row(faces(f, 2))};
}

Box box_of(const Triangle3f& t) {
  Box box;
  for (std::size_t k = 0; k < 3; ++k) {
    const auto axis = static_cast<Eigen::Index>(k);
    box.lower[k] = std::min({t[0][axis], t[1][axis], t[2][axis]});
    box.upper[k] = std::max({t[0][axis], t[1][axis], t[2][axis]});
  }
  return box;
}

// Adds `move` to the point with barycentric coordinates b of a face by moving its corners as little as possible.
void move_point(Positions& positions, const Faces& faces, std::uint32_t face, const Vec3& b, const Vec3& move) {
  const Vec3 scaled = move / b.squaredNorm();
  for (int k = 0; k < 3; ++k) positions.row(faces(face, k)) += (b[k] * scaled).cast<float>().transpose();
}

// A direction in which to leave a capsule from its axis.
Vec3 away_from_axis(const Capsule& capsule) {
  const Vec3 axis = capsule.b - capsule.a;
  if (axis.squaredNorm() == 0) return Vec3::UnitY();
  const Vec3 up = Vec3::UnitY() - axis * (axis.y() / axis.squaredNorm());
  return up.norm() > 0.1 ? Vec3(up.normalized()) : Vec3(axis.unitOrthogonal());
}

ObstacleContact contact_along(const Capsule& capsule, const Vec3& offset) {
  const double length = offset.norm();
  return {length - capsule.radius, length > kNoDirection ? Vec3(offset / length) : away_from_axis(capsule)};
}

bool finite(const Capsule& capsule) {
  return capsule.a.allFinite() && capsule.b.allFinite() && std::isfinite(capsule.radius) && capsule.radius > 0;
}

std::vector<Capsule> capsules_of(const ObstacleFrame& frame) {
  std::vector<Capsule> capsules;
  if (frame.capsule_ends.rows() == 2 * static_cast<Eigen::Index>(frame.capsule_radii.size())) {
    for (const float radius : frame.capsule_radii) {
      const auto row = 2 * static_cast<Eigen::Index>(capsules.size());
      capsules.push_back({frame.capsule_ends.row(row).cast<double>().transpose(),
                          frame.capsule_ends.row(row + 1).cast<double>().transpose(), static_cast<double>(radius)});
    }
  }
  if (capsules.empty() || !std::all_of(capsules.begin(), capsules.end(), finite)) {
    throw_invalid_argument("obstacle " + frame.name + ": capsules need two finite ends and a radius above 0 each");
  }
  return capsules;
}

}  // namespace

ObstacleContact capsule_contact(const Capsule& capsule, const Vec3& p) {
  const double s = closest_on_segment(p, capsule.a, capsule.b);
  return contact_along(capsule, p - capsule.a - s * (capsule.b - capsule.a));
}

TriangleContact capsule_contact(const Capsule& capsule, const Vec3& a, const Vec3& b, const Vec3& c) {
  TriangleContact nearest{closest_on_triangle(capsule.a, a, b, c), {}};
  Vec3 offset = nearest.weights[0] * a + nearest.weights[1] * b + nearest.weights[2] * c - capsule.a;
  double squared = offset.squaredNorm();
  const auto consider = [&](const Vec3& weights, const Vec3& on_axis) {
    const Vec3 other = weights[0] * a + weights[1] * b + weights[2] * c - on_axis;
    if (other.squaredNorm() >= squared) return;
    squared = other.squaredNorm();
    nearest.weights = weights;
    offset = other;
  };
  if (capsule.a != capsule.b) {
    consider(closest_on_triangle(capsule.b, a, b, c), capsule.b);
    const std::array<Vec3, 3> corner{a, b, c};
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3;
      const ClosestPoints pair = closest_edge_edge(corner[static_cast<std::size_t>(k)],
                                                   corner[static_cast<std::size_t>(next)], capsule.a, capsule.b);
      Vec3 weights = Vec3::Zero();
      weights[k] = pair.weights[0];
      weights[next] = pair.weights[1];
      consider(weights, -pair.weights[2] * capsule.a - pair.weights[3] * capsule.b);
    }
    // Where the axis pierces the triangle, it is nearest to itself.
    const Vec3 normal = (b - a).cross(c - a);
    const double from = normal.dot(capsule.a - a), to = normal.dot(capsule.b - a);
    if ((from < 0) != (to < 0)) {
      const Vec3 pierced = capsule.a + from / (from - to) * (capsule.b - capsule.a);
      consider(closest_on_triangle(pierced, a, b, c), pierced);
    }
  }
  nearest.contact = contact_along(capsule, offset);
  return nearest;
}

namespace {

// Whether a face reaches into a capsule, and where it does most.
std::optional<TriangleContact> penetration(const Capsule& capsule, const Positions& positions, const Faces& faces,
                                           std::uint32_t face) {
  const Vec3 a = point(positions, faces(face, 0)), b = point(positions, faces(face, 1)),
             c = point(positions, faces(face, 2));
  // No point of the face is farther from its first corner than the other corners are.
  const double reach = std::sqrt(std::max((b - a).squaredNorm(), (c - a).squaredNorm()));
  if (capsule_contact(capsule, a).distance > reach) return std::nullopt;
  const TriangleContact found = capsule_contact(capsule, a, b, c);
  if (found.contact.distance >= -kPenetrationTolerance) return std::nullopt;
  return found;
}

}  // namespace

bool reaches_in(const Capsule& capsule, const Positions& positions, const Faces& faces, std::uint32_t face) {
  return penetration(capsule, positions, faces, face).has_value();
}

MeshObstacle::MeshObstacle(const Faces& faces, Eigen::Index vertex_count, const std::string& name) : faces_(faces) {
  Topology topology;
  topology.rest_positions = Positions::Zero(vertex_count, 3);
  topology.faces = faces;
  validate_topology(topology, "obstacle " + name);
  connectivity_ = build_connectivity(vertex_count, faces);
  for (const Edge& edge : connectivity_.edges) {
    if (edge.f1 == kNone) {
      throw_invalid_argument("obstacle " + name + ": the mesh is not closed at edge " + std::to_string(edge.v0) + "-" +
                             std::to_string(edge.v1));
    }
  }
}

// Near in the first frame is near later on.
void MeshObstacle::build_packs() {
  std::vector<Box> boxes;
  for (std::uint32_t f = 0; f < static_cast<std::uint32_t>(faces_.rows()); ++f) {
    boxes.push_back(box_of(corners(positions_, faces_, f)));
  }
  const std::vector<std::uint32_t> order = near_groups(boxes, kWidth);
  packs_.resize((order.size() + kWidth - 1) / kWidth);
  for (std::size_t i = 0; i < packs_.size() * kWidth; ++i) {
    packs_[i / kWidth].faces[i % kWidth] = order[std::min(i, order.size() - 1)];
  }
  boxes_.resize(packs_.size());
}

void MeshObstacle::update(const Positions& positions) {
  positions_ = positions;
  if (packs_.empty()) build_packs();
  for (std::size_t i = 0; i < packs_.size(); ++i) {
    Pack& pack = packs_[i];
    Float4 low = broadcast4(3e38f), high = broadcast4(-3e38f);
    for (std::size_t k = 0; k < 3; ++k) {
      Float4 rows[kWidth];
      for (std::size_t lane = 0; lane < kWidth; ++lane) {
        const float* at = positions_.data() + 3 * std::size_t{faces_(pack.faces[lane], static_cast<Eigen::Index>(k))};
        rows[lane] = Float4{at[0], at[1], at[2], 0};
        low = min(low, rows[lane]);
        high = max(high, rows[lane]);
      }
      Float8 columns[4];
      transpose(rows, columns);
      pack.corners[k] = {columns[0], columns[1], columns[2]};
    }
    pack.error = max(max(rounding(pack.corners[0]), rounding(pack.corners[1])), rounding(pack.corners[2]));
    store_to(boxes_[i].lower, low);
    store_to(boxes_[i].upper, high);
  }
  if (tree_.empty()) {
    tree_ = Bvh(boxes_);
  } else {
    tree_.refit(boxes_);
  }
}

Vec3 MeshObstacle::face_normal(std::uint32_t face) const {
  const Vec3 a = point(positions_, faces_(face, 0));
  const Vec3 normal = (point(positions_, faces_(face, 1)) - a).cross(point(positions_, faces_(face, 2)) - a);
  const double length = normal.norm();
  return length > 0 ? Vec3(normal / length) : Vec3(Vec3::Zero());
}

Vec3 MeshObstacle::vertex_normal(std::uint32_t vertex) const {
  Vec3 sum = Vec3::Zero();
  const Vec3 x = point(positions_, vertex);
  for (std::uint32_t i = connectivity_.vertex_face_offsets[vertex]; i < connectivity_.vertex_face_offsets[vertex + 1];
       ++i) {
    const std::uint32_t face = connectivity_.vertex_faces[i];
    int k = 0;
    while (faces_(face, k) != vertex) ++k;
    const Vec3 u = point(positions_, faces_(face, (k + 1) % 3)) - x,
               v = point(positions_, faces_(face, (k + 2) % 3)) - x;
    sum += std::atan2(u.cross(v).norm(), u.dot(v)) * face_normal(face);
  }
  return sum.normalized();
}

void MeshObstacle::consider(const Vec3& p, std::uint32_t face, Nearest& best) const {
  const Vec3 a = point(positions_, faces_(face, 0)), b = point(positions_, faces_(face, 1)),
             c = point(positions_, faces_(face, 2));
  const Vec3 weights = closest_on_triangle(p, a, b, c);
  const double squared = (p - weights[0] * a - weights[1] * b - weights[2] * c).squaredNorm();
  // The smaller index of two equally near faces, whatever the tree's shape.
  if (squared < best.squared || (squared == best.squared && face < best.face)) best = {squared, face, weights};
}

// In float32 who can't be the nearest one; in double, the most promising first, the others.
void MeshObstacle::consider_pack(const Vec3& p, const Pack& pack, Nearest& best) const {
  const Vec3f near = p.cast<float>();
  const Points8 p8{broadcast8(near.x()), broadcast8(near.y()), broadcast8(near.z())};
  const auto& [a, b, c] = pack.corners;
  const Float8 least = at_least(squared_vertex_face_distance(p8, a, b, c), max(pack.error, rounding(p8)));
  const auto may_be_nearer = [&] {
    constexpr double kMost = 1e18;
    return bits(~(least > broadcast8(static_cast<float>((1 + 1e-6) * std::sqrt(std::min(best.squared, kMost))))));
  };
  std::uint32_t looked_at = 0;
  for (std::uint32_t lanes = may_be_nearer(); lanes != 0; lanes = may_be_nearer() & ~looked_at) {
    int first = __builtin_ctz(lanes);
    for (std::uint32_t rest = lanes & (lanes - 1); rest != 0; rest &= rest - 1) {
      const int lane = __builtin_ctz(rest);
      if (least[lane] < least[first]) first = lane;
    }
    looked_at |= 1u << first;
    consider(p, pack.faces[static_cast<std::size_t>(first)], best);
  }
}

std::optional<ObstacleContact> MeshObstacle::nearest(const Vec3& p, double squared_reach, std::uint32_t& hint) const {
  Nearest best{squared_reach};
  if (hint < static_cast<std::uint32_t>(faces_.rows())) consider(p, hint, best);
  tree_.nearest(p, best.squared, [&](std::uint32_t pack) {
    consider_pack(p, packs_[pack], best);
    return best.squared;
  });
  hint = best.face;
  return contact_at(p, best);
}

std::optional<ObstacleContact> MeshObstacle::contact_near(const Vec3& p, double reach,
                                                          std::span<const std::uint32_t> packs) const {
  Nearest best{reach * reach};
  for (const std::uint32_t pack : packs) {
    // Rounding must not leave out a face as near as the best one.
    if ((1 - 1e-12) * squared_distance(boxes_[pack], p) <= best.squared) consider_pack(p, packs_[pack], best);
  }
  return contact_at(p, best);
}

std::optional<ObstacleContact> MeshObstacle::contact_at(const Vec3& p, const Nearest& nearest) const {
  const double best = nearest.squared;
  const std::uint32_t best_face = nearest.face;
  const Vec3& best_weights = nearest.weights;
  if (best_face == kNone) return std::nullopt;
  Vec3 closest = Vec3::Zero();
  for (int k = 0; k < 3; ++k) closest += best_weights[k] * point(positions_, faces_(best_face, k));
  constexpr double kOnBoundary = 1e-9;
  const auto corner = [&](int k) { return best_weights[k] > 1 - kOnBoundary; };
  Vec3 normal;
  if (corner(0) || corner(1) || corner(2)) {
    normal = vertex_normal(faces_(best_face, corner(0) ? 0 : (corner(1) ? 1 : 2)));
  } else if (best_weights.minCoeff() < kOnBoundary) {
    int opposite = 0;
    best_weights.minCoeff(&opposite);
    const Edge& edge =
        connectivity_.edges[connectivity_.face_edges[best_face][static_cast<std::size_t>((opposite + 1) % 3)]];
    normal = (face_normal(edge.f0) + face_normal(edge.f1)).normalized();
  } else {
    normal = face_normal(best_face);
  }
  const Vec3 offset = p - closest;
  const double length = std::sqrt(best);
  const double distance = offset.dot(normal) < 0 ? -length : length;
  return ObstacleContact{distance, length > kNoDirection ? Vec3(offset / distance) : normal};
}

std::optional<ObstacleContact> MeshObstacle::contact(const Vec3& p, double reach) const {
  if (squared_distance(bounds(), p) > reach * reach) return std::nullopt;
  std::uint32_t hint = kNone;
  auto found = nearest(p, std::numeric_limits<double>::max(), hint);
  if (!found || found->distance > reach) return std::nullopt;
  return found;
}

std::optional<ObstacleContact> MeshObstacle::contact_near(const Vec3& p, double reach, std::uint32_t& hint) const {
  return nearest(p, reach * reach, hint);
}

void MeshObstacle::find_packs(const Box& box, std::vector<std::uint32_t>& packs) const {
  tree_.query(box, [&](std::uint32_t pack) { packs.push_back(pack); });
}

template <typename Visit>
void MeshObstacle::visit_intersecting(const Pack& pack, const Box& box, const Triangle3f& triangle,
                                      const Visit& visit) const {
  const auto& [a, b, c] = pack.corners;
  Int8 apart{};
  const auto compare = [&](Float8 x, Float8 y, Float8 z, int axis) {
    apart |= (min(min(x, y), z) > broadcast8(box.upper[axis])) | (max(max(x, y), z) < broadcast8(box.lower[axis]));
  };
  compare(a.x, b.x, c.x, 0);
  compare(a.y, b.y, c.y, 1);
  compare(a.z, b.z, c.z, 2);
  for (std::uint32_t lanes = ~bits(apart) & 0xffu; lanes != 0; lanes &= lanes - 1) {
    const std::uint32_t face = pack.faces[static_cast<std::size_t>(__builtin_ctz(lanes))];
    if (triangles_intersect(triangle, corners(positions_, faces_, face)) && !visit(face)) return;
  }
}

bool MeshObstacle::intersects(const Triangle3f& triangle, std::span<const std::uint32_t> packs) const {
  const Box box = box_of(triangle);
  bool found = false;
  for (std::size_t i = 0; i < packs.size() && !found; ++i) {
    if (!box.overlaps(boxes_[packs[i]])) continue;
    visit_intersecting(packs_[packs[i]], box, triangle, [&](std::uint32_t) {
      found = true;
      return false;
    });
  }
  return found;
}

bool MeshObstacle::intersects(const Triangle3f& triangle) const {
  std::vector<std::uint32_t> packs;
  find_packs(box_of(triangle), packs);
  return intersects(triangle, packs);
}

void MeshObstacle::intersecting_vertices(const Triangle3f& triangle, std::vector<std::uint32_t>& out) const {
  const auto first = static_cast<std::ptrdiff_t>(out.size());
  const Box box = box_of(triangle);
  tree_.query(box, [&](std::uint32_t pack) {
    visit_intersecting(packs_[pack], box, triangle, [&](std::uint32_t f) {
      for (int k = 0; k < 3; ++k) out.push_back(faces_(f, k));
      return true;
    });
  });
  std::sort(out.begin() + first, out.end());
  out.erase(std::unique(out.begin() + first, out.end()), out.end());
}

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

// The obstacle of this name, new if there is none, marked as present.
ObstacleField::Part& ObstacleField::part_named(const std::string& name) {
  auto part = std::find_if(parts_.begin(), parts_.end(), [&](const Part& p) { return p.name == name; });
  if (part == parts_.end()) {
    parts_.emplace_back();
    part = parts_.end() - 1;
    part->name = name;
  }
  if (part->present) throw_invalid_argument("obstacle " + name + " is twice in one frame");
  part->present = true;
  return *part;
}

void ObstacleField::update(std::span<const ObstacleFrame> frames) {
  for (Part& part : parts_) part.present = false;
  for (const ObstacleFrame& frame : frames) {
    Part& part = part_named(frame.name);
    if (!frame.capsule_radii.empty()) {
      if (part.faces.rows() != 0) throw_invalid_argument("obstacle " + frame.name + " is a mesh in this session");
      part.capsules = capsules_of(frame);
      continue;
    }
    if (part.faces.rows() == 0) {
      if (frame.positions.rows() != 0 && frame.radius == 0)
        throw_invalid_argument("obstacle " + frame.name + ": a mesh without its faces");
      const Eigen::Vector3d center = frame.center.cast<double>();
      const Capsule sphere{center, center, static_cast<double>(frame.radius)};
      if (!finite(sphere) || frame.positions.rows() != 0) {
        throw_invalid_argument("obstacle " + frame.name + ": a sphere needs a finite centre and a radius above 0");
      }
      part.capsules.assign(1, sphere);
      continue;
    }
    if (frame.positions.rows() == 0 || !all_finite(frame.positions)) {
      throw_invalid_argument("obstacle " + frame.name + ": positions are absent or not finite");
    }
    if (part.mesh == nullptr) {
      part.mesh = std::make_unique<MeshObstacle>(part.faces, frame.positions.rows(), part.name);
    } else if (frame.positions.rows() != part.mesh->positions().rows()) {
      throw_invalid_argument("obstacle " + frame.name + ": " + std::to_string(frame.positions.rows()) +
                             " positions, earlier " + std::to_string(part.mesh->positions().rows()));
    }
    part.mesh->update(frame.positions);
  }
  for (const Part& part : parts_) {
    if (!part.present && part.faces.rows() != 0)
      throw_invalid_argument("obstacle " + part.name + " is not in the frame");
  }
}

bool ObstacleField::empty() const {
  return std::none_of(parts_.begin(), parts_.end(), [](const Part& part) { return part.present; });
}

void ObstacleField::append_bounds(double margin, std::vector<Box>& boxes) const {
  for (const Part& part : parts_) {
    if (!part.present) continue;
    if (part.mesh != nullptr) {
      boxes.push_back(widened(part.mesh->bounds(), margin));
      continue;
    }
    for (const Capsule& capsule : part.capsules) {
      Box box;
      box.extend(capsule.a, capsule.radius + margin);
      box.extend(capsule.b, capsule.radius + margin);
      boxes.push_back(box);
    }
  }
}

namespace {

// of_mesh(part): the contact with its mesh, if there is any.
template <typename Parts, typename OfMesh>
std::optional<ObstacleContact> deepest_contact(Parts& parts, const Vec3& p, double reach, const OfMesh& of_mesh) {
  std::optional<ObstacleContact> deepest;
  const auto consider = [&](const ObstacleContact& found) {
    if (found.distance <= reach && (!deepest || found.distance < deepest->distance)) deepest = found;
  };
  for (auto& part : parts) {
    if (!part.present) continue;
    if (part.mesh == nullptr) {
      for (const Capsule& capsule : part.capsules) consider(capsule_contact(capsule, p));
    } else if (const std::optional<ObstacleContact> found = of_mesh(part)) {
      consider(*found);
    }
  }
  return deepest;
}

}  // namespace

std::optional<ObstacleContact> ObstacleField::contact(const Vec3& p, double reach) const {
  return deepest_contact(parts_, p, reach, [&](const Part& part) { return part.mesh->contact(p, reach); });
}

std::optional<ObstacleContact> ObstacleField::contact_near(const Vec3& p, double reach, double depth) {
  const double radius = std::max(reach, depth);
  return deepest_contact(parts_, p, reach,
                         [&](Part& part) { return part.mesh->contact_near(p, radius, part.nearest); });
}

bool ObstacleField::penetrates(const Positions& positions, const Faces& faces, std::uint32_t face) const {
  for (const Part& part : parts_) {
    if (!part.present) continue;
    if (part.mesh == nullptr) {
      for (const Capsule& capsule : part.capsules) {
        if (reaches_in(capsule, positions, faces, face)) return true;
      }
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

bool ObstacleField::push_face_out(Positions& positions, const Faces& faces, std::uint32_t face, double clearance) {
  bool moved = false;
  for (const Part& part : parts_) {
    if (!part.present) continue;
    for (const Capsule& capsule : part.capsules) {
      const auto found = penetration(capsule, positions, faces, face);
      if (!found) continue;
      const ObstacleContact& contact = found->contact;
      move_point(positions, faces, face, found->weights, (0.5 * clearance - contact.distance) * contact.normal);
      moved = true;
    }
    if (part.mesh == nullptr) continue;
    // Corners of the obstacle that stick through the face push it along their normals.
    corners_.clear();
    part.mesh->intersecting_vertices(corners(positions, faces, face), corners_);
    for (const std::uint32_t v : corners_) {
      const Vec3 q = point(part.mesh->positions(), v), normal = part.mesh->vertex_normal(v);
      const Vec3 a = point(positions, faces(face, 0)), b = point(positions, faces(face, 1)),
                 c = point(positions, faces(face, 2));
      const Vec3 weights = closest_on_triangle(q, a, b, c);
      const Vec3 way = q - weights[0] * a - weights[1] * b - weights[2] * c;
      // A corner farther away than the face is large does not stick through it: a face of the obstacle may be a wall.
      const double size = std::max({(b - a).squaredNorm(), (c - b).squaredNorm(), (a - c).squaredNorm()});
      const double depth = way.dot(normal);
      if (depth <= 0 || way.squaredNorm() > size) continue;
      move_point(positions, faces, face, weights, (depth + 0.5 * clearance) * normal);
      moved = true;
    }
  }
  return moved;
}

}  // namespace pleat
