// Where a state is not clean: what a scene's start is checked for.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <set>

#include "common/base/error.hpp"
#include "services/simulation/contact.hpp"
#include "services/simulation/union_find.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

// Metres. Less than this apart is a touch.
constexpr double kMinimumClearance = 1e-6;
// Of the thickness: how far apart a touch should be brought.
constexpr double kWantedClearance = 0.1;
// An error names so many places of a kind and obstacle.
constexpr std::size_t kNamedOfAKind = 3;

// Whether segment p-q meets triangle a,b,c (Moeller and Trumbore 1997); touching counts.
bool segment_meets_triangle(const Vector3d& p, const Vector3d& q, const Vector3d& a, const Vector3d& b,
                            const Vector3d& c) {
  const Vector3d direction = q - p, e1 = b - a, e2 = c - a, s = p - a;
  const Vector3d cross = direction.cross(e2);
  const double determinant = e1.dot(cross);
  if (std::abs(determinant) <= 1e-14 * direction.norm() * e1.norm() * e2.norm()) return false;  // coplanar
  const double u = s.dot(cross) / determinant;
  const Vector3d other = s.cross(e1);
  const double v = direction.dot(other) / determinant, t = e2.dot(other) / determinant;
  return u >= 0 && v >= 0 && u + v <= 1 && t >= 0 && t <= 1;
}

// Winding number of a closed mesh about a point: +-1 inside, 0 outside (van Oosterom and Strackee 1983).
double winding_number(const Vector3d& p, const Points& x, std::span<const std::array<std::uint32_t, 3>> faces) {
  double sum = 0;
  for (const auto& face : faces) {
    const Vector3d a = x[face[0]] - p, b = x[face[1]] - p, c = x[face[2]] - p;
    const double la = a.norm(), lb = b.norm(), lc = c.norm();
    sum += std::atan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
  }
  return sum / (2 * std::numbers::pi);
}

// A direction apart for primitives that lie in each other: their common normal. Which side is which follows from the
// vertices' order, so that all pairs of two sheets that lie in each other agree.
Vector3d direction_apart(const Points& x, const std::array<std::uint32_t, 4>& v, bool edges) {
  const Vector3d first = edges ? x[v[1]] - x[v[0]] : x[v[2]] - x[v[1]];
  const Vector3d second = x[v[3]] - (edges ? x[v[2]] : x[v[1]]);
  Vector3d normal = first.cross(second);
  if (!(normal.norm() > 0)) normal = Vector3d::UnitY();
  normal.normalize();
  Eigen::Index largest = 0;
  normal.cwiseAbs().maxCoeff(&largest);
  const std::uint32_t one = edges ? std::min(v[0], v[1]) : v[0];
  const std::uint32_t other = edges ? std::min(v[2], v[3]) : std::min({v[1], v[2], v[3]});
  return (normal[largest] > 0) == (one < other) ? normal : Vector3d(-normal);
}

}  // namespace

void ContactSystem::find_crossings(const Points& x, ThreadPool& pool, std::vector<Violation>& found) const {
  std::vector<SweptBvh::Pair> face_pairs;
  if (scene_.contact.self_collision) face_pairs = cloth_bvh_.self_pairs(pool, 100'000'000, true);
  if (!obstacle_bvh_.empty()) {
    for (const auto& [f, g] : cloth_bvh_.pairs(obstacle_bvh_)) {
      face_pairs.push_back({f, g + static_cast<std::uint32_t>(cloth_faces_)});
    }
  }
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t crossed, std::uint32_t cloth_face,
                       std::uint32_t other_face) {
    const auto& c = faces_[crossed];
    if (a == c[0] || a == c[1] || a == c[2] || b == c[0] || b == c[1] || b == c[2]) return;
    if (!segment_meets_triangle(x[a], x[b], x[c[0]], x[c[1]], x[c[2]])) return;
    Violation violation{Violation::Kind::kCrossing, {a, b, c[0], c[1], c[2]}};
    violation.face = cloth_face;
    violation.other_face = other_face;
    if (other_face == kNone) violation.obstacle = obstacle_of(std::max(a, c[0]));
    found.push_back(violation);
  };
  for (const auto& [f, g] : face_pairs) {
    const std::uint32_t other = g < cloth_faces_ ? g : kNone;
    for (const std::uint32_t e : own_edges_[f]) {
      if (e != kNone) add(edges_[e][0], edges_[e][1], g, f, other);
    }
    for (const std::uint32_t e : own_edges_[g]) {
      if (e != kNone) add(edges_[e][0], edges_[e][1], f, f, other);
    }
  }
  for (const Round& round : rounds_) {
    if (round.b == kNone) continue;
    SweptBox box(x[round.a], x[round.a], 0);
    box.extend(SweptBox(x[round.b], x[round.b], 0));
    for (const std::uint32_t f : cloth_bvh_.query(box)) add(round.a, round.b, f, f, kNone);
  }
}

void ContactSystem::find_touches(const Points& x, std::vector<Violation>& found) const {
  for (const Pair& pair : pairs_) {
    const ClosestPoints points = closest(pair, x);
    const double distance = std::sqrt(points.squared_distance);
    const double clearance = distance - static_cast<double>(pair.minimum);
    if (clearance > kMinimumClearance) continue;
    Violation violation{Violation::Kind::kTouch, {pair.v[0], pair.v[1], pair.v[2], pair.v[3], kNone}};
    for (const std::uint32_t v : pair.v) {
      if (v >= cloth_count_) violation.obstacle = obstacle_of(v);
    }
    violation.weights = points.weights;
    violation.normal = distance > 1e-9 ? Vector3d(points.difference / distance)
                                       : direction_apart(x, pair.v, pair.kind == Kind::kEdgeEdge);
    violation.depth = kWantedClearance * thickness_ - clearance;
    found.push_back(violation);
  }
}

// Vertices inside obstacle meshes: what is connected without a crossing is on one side.
void ContactSystem::find_inside(const Points& x, std::vector<Violation>& found) const {
  const std::size_t crossings = found.size();
  for (std::uint32_t o = 0; o < scene_.obstacles.size(); ++o) {
    const std::uint32_t first = first_face_[o], last = first_face_[o + 1];
    if (first == last) continue;
    std::set<std::pair<std::uint32_t, std::uint32_t>> cut;
    for (std::size_t i = 0; i < crossings; ++i) {
      const Violation& crossing = found[i];
      if (crossing.kind != Violation::Kind::kCrossing || crossing.obstacle != o) continue;
      if (crossing.particles[0] < cloth_count_) cut.insert(std::minmax(crossing.particles[0], crossing.particles[1]));
    }
    UnionFind parts(cloth_count_);
    for (const auto& [a, b] : edges_) {
      if (b < cloth_count_ && !cut.contains(std::minmax(a, b))) parts.join(a, b);
    }
    std::map<std::uint32_t, bool> inside;
    for (std::uint32_t v = 0; v < cloth_count_; ++v) {
      const auto [part, fresh] = inside.try_emplace(parts.root(v), false);
      if (fresh) {
        part->second = std::abs(winding_number(x[v], x, std::span(faces_).subspan(first, last - first))) > 0.5;
      }
      if (!part->second) continue;
      Violation violation{Violation::Kind::kInside, {v, kNone, kNone, kNone, kNone}};
      violation.obstacle = o;
      violation.weights = {1, 0, 0, 0};
      double best = 1e30;
      Vector3d way = Vector3d::Zero();
      for (double reach = 4 * thickness_; best > reach * reach && reach < 1e6; reach *= 2) {
        for (const std::uint32_t f : obstacle_bvh_.query(SweptBox(x[v], x[v], reach))) {
          const std::uint32_t face = f + static_cast<std::uint32_t>(cloth_faces_);
          if (face < first || face >= last) continue;
          const auto& c = faces_[face];
          const ClosestPoints points = closest_vertex_face(x[v], x[c[0]], x[c[1]], x[c[2]]);
          if (points.squared_distance >= best) continue;
          best = points.squared_distance;
          way = -points.difference;
          if (best < 1e-18) way = (x[c[1]] - x[c[0]]).cross(x[c[2]] - x[c[0]]);
        }
      }
      violation.normal = way.normalized();
      violation.depth = std::sqrt(best) + kWantedClearance * thickness_;
      // On the surface the winding number says nothing.
      if (std::sqrt(best) <= kMinimumClearance) violation.kind = Violation::Kind::kTouch;
      found.push_back(violation);
    }
  }
}

// What is nearer to an obstacle than where the layer carries its weight. The pairs are those of violations().
void ContactSystem::begin_layer(const Points& x) {
  start_lag_.assign(cloth_count_, 0);
  const double weight = scene_.material.density * scene_.density_multiplier * scene_.gravity.norm();  // N/m^2
  const double carries = std::sqrt(2 * thickness_ * weight / scene_.contact.stiffness);
  bool any = false;
  for (const Pair& pair : pairs_) {
    if (std::none_of(pair.v.begin(), pair.v.end(), [this](std::uint32_t v) { return v >= cloth_count_; })) continue;
    const ClosestPoints points = closest(pair, x);
    const double clearance = std::sqrt(points.squared_distance) - static_cast<double>(pair.minimum);
    const double lag = thickness_ - carries - clearance;
    for (std::size_t k = 0; k < 4; ++k) {
      if (pair.v[k] >= cloth_count_ || std::abs(points.weights[k]) < 1e-6 || !(lag > start_lag_[pair.v[k]])) continue;
      start_lag_[pair.v[k]] = lag;
      any = true;
    }
  }
  if (!any) start_lag_.clear();
}

std::vector<Violation> ContactSystem::violations(const Points& x, ThreadPool& pool) {
  find_pairs(x, x, pool);
  if (!obstacle_bvh_.empty()) obstacle_bvh_.refit(boxes_, pool);  // find_inside() looks for what is far away, too
  std::vector<Violation> found;
  find_crossings(x, pool, found);
  find_inside(x, found);
  find_touches(x, found);
  return found;
}

// In messages a face counts within its layer.
std::string ContactSystem::name_of_face(std::uint32_t f) const {
  const std::size_t children = cloth_faces_ / static_cast<std::size_t>(scene_.garment.face_count());
  std::size_t first = 0;
  for (const GarmentLayer& layer : scene_.layers) {
    const std::size_t count = children * static_cast<std::size_t>(layer.faces);
    if (f < first + count) return std::to_string(f - first) + " of '" + layer.name + "'";
    first += count;
  }
  return std::to_string(f);
}

std::string ContactSystem::describe(const Violation& violation) const {
  const auto name = [](std::uint32_t i) { return std::to_string(i); };
  const std::string obstacle =
      violation.obstacle == kNone ? "" : "obstacle '" + scene_.obstacles[violation.obstacle].name + "'";
  switch (violation.kind) {
    case Violation::Kind::kCrossing:
      if (obstacle.empty()) {
        const auto [f, g] = std::minmax(violation.face, violation.other_face);
        if (!layers_.empty()) return "faces " + name_of_face(f) + " and " + name_of_face(g) + " intersect";
        return "faces " + name(f) + " and " + name(g) + " of the cloth intersect";
      }
      return "face " + name_of_face(violation.face) + (layers_.empty() ? " of the cloth cuts " : " cuts ") + obstacle;
    case Violation::Kind::kInside:
      return "vertex " + name(violation.particles[0]) + " of the cloth is inside " + obstacle;
    case Violation::Kind::kTouch:
      break;
  }
  std::uint32_t cloth_vertex = kNone;
  for (std::size_t k = 0; k < 4; ++k) cloth_vertex = std::min(cloth_vertex, violation.particles[k]);
  if (!obstacle.empty()) return "the cloth touches " + obstacle + " near vertex " + name(cloth_vertex);
  // The first of either primitive: a vertex and a face, or two edges, never share one.
  return "the cloth touches itself between vertices " + name(violation.particles[0]) + " and " +
         name(violation.particles[2]);
}

void ContactSystem::check_start(const Points& x, ThreadPool& pool) {
  std::set<std::string> seen;
  std::map<std::pair<Violation::Kind, std::uint32_t>, std::size_t> of_a_kind;
  std::string message;
  std::size_t unnamed = 0;
  for (const Violation& violation : violations(x, pool)) {
    const std::string text = describe(violation);
    if (!seen.insert(text).second) continue;
    if (++of_a_kind[{violation.kind, violation.obstacle}] > kNamedOfAKind) {
      ++unnamed;
      continue;
    }
    message += (message.empty() ? "" : "; ") + text;
  }
  if (message.empty()) {
    begin_layer(x);
    return;
  }
  if (unnamed > 0) message += "; and " + std::to_string(unnamed) + " more places";
  throw_invalid_argument("scene '" + scene_.name + "': not clean at the start" +
                         (scene_.untangle ? ", not even after untangling: " : ": ") + message);
}

}  // namespace pleat::simulation
