#include "services/simulation/untangle.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "services/simulation/union_find.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

constexpr int kRounds = 500;
// Rounds without fewer violations than ever before.
constexpr int kPatience = 80;
constexpr int kSmoothingSweeps = 4;
// Of the thickness: how far beyond a face a vertex goes that has crossed it.
constexpr double kMargin = 0.1;
// Of the mean edge: the longest step of a round, and that along a contour.
constexpr double kLongestStep = 1;
constexpr double kContourStep = 0.25;

using EdgeKey = std::pair<std::uint32_t, std::uint32_t>;

class Untangler {
 public:
  Untangler(const ContactSystem& contact, const Points& start) : contact_(contact), start_(start) {
    const std::size_t cloth = contact.cloth_count();
    offsets_.assign(cloth + 1, 0);
    double length = 0;
    std::size_t edges = 0;
    for (const auto& [a, b] : contact.edges()) {
      if (b >= cloth) continue;
      ++offsets_[a + 1];
      ++offsets_[b + 1];
      length += (start[a] - start[b]).norm();
      ++edges;
    }
    mean_edge_ = length / static_cast<double>(std::max<std::size_t>(edges, 1));
    for (std::size_t v = 0; v < cloth; ++v) offsets_[v + 1] += offsets_[v];
    neighbours_.resize(offsets_.back());
    std::vector<std::uint32_t> next(offsets_.begin(), offsets_.end() - 1);
    for (const auto& [a, b] : contact.edges()) {
      if (b >= cloth) continue;
      neighbours_[next[a]++] = b;
      neighbours_[next[b]++] = a;
    }
    for (const auto& face : contact.cloth_faces()) {
      for (std::size_t k = 0; k < 3; ++k) {
        opposite_[std::minmax(face[k], face[(k + 1) % 3])].push_back(face[(k + 2) % 3]);
      }
    }
    held_.assign(cloth, 0);
  }

  void round(const std::vector<Violation>& violations, Points& x) {
    pushes_.assign(contact_.cloth_count(), Vector3d::Zero());
    counts_.assign(contact_.cloth_count(), 0);
    find_parts(violations);
    for (const Violation& violation : violations) {
      if (violation.kind == Violation::Kind::kCrossing) {
        uncross(violation, x);
      } else {
        push({violation.particles[0], violation.particles[1], violation.particles[2], violation.particles[3]},
             violation.weights, violation.normal, violation.depth);
      }
    }
    for (std::size_t v = 0; v < counts_.size(); ++v) {
      if (counts_[v] == 0) continue;
      Vector3d step = pushes_[v] / counts_[v];
      const double longest = kLongestStep * mean_edge_, length = step.norm();
      if (length > longest) step *= longest / length;
      x[v] += step;
      held_[v] = 1;
    }
    smooth(x);
  }

 private:
  // The parts into which the crossings cut the cloth and the obstacles, and who is inside an obstacle.
  void find_parts(const std::vector<Violation>& violations) {
    std::vector<EdgeKey> cut;
    inside_.assign(start_.size(), 0);
    for (const Violation& violation : violations) {
      const auto& p = violation.particles;
      if (violation.kind == Violation::Kind::kCrossing) cut.push_back(std::minmax(p[0], p[1]));
      if (violation.kind == Violation::Kind::kInside) inside_[p[0]] = 1;
    }
    std::sort(cut.begin(), cut.end());
    UnionFind sets(start_.size());
    for (const auto& [a, b] : contact_.edges()) {
      if (!std::binary_search(cut.begin(), cut.end(), EdgeKey(std::minmax(a, b)))) sets.join(a, b);
    }
    part_.resize(start_.size());
    part_size_.assign(start_.size(), 0);
    for (std::uint32_t v = 0; v < part_.size(); ++v) {
      part_[v] = sets.root(v);
      ++part_size_[part_[v]];
    }
  }

  // Moves sum weights[k] particles[k] by depth along the normal; only the cloth yields, from `outer` on its layers.
  void push(const std::array<std::uint32_t, 4>& particles, const std::array<double, 4>& weights, const Vector3d& normal,
            double depth, std::uint32_t outer = 0) {
    const std::span<const std::uint32_t> layers = contact_.layers();
    const auto yields = [&](std::uint32_t particle) {
      return particle < pushes_.size() && (layers.empty() || layers[particle] >= outer);
    };
    double mobility = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      if (yields(particles[k])) mobility += weights[k] * weights[k];
    }
    if (mobility <= 0) return;
    for (std::size_t k = 0; k < 4; ++k) {
      if (!yields(particles[k]) || weights[k] == 0) continue;
      pushes_[particles[k]] += depth / mobility * weights[k] * normal;
      ++counts_[particles[k]];
    }
  }

  void uncross(const Violation& crossing, const Points& x) {
    const auto& p = crossing.particles;
    const Vector3d &a = x[p[0]], &b = x[p[1]], &c0 = x[p[2]], &c1 = x[p[3]], &c2 = x[p[4]];
    const Vector3d cross = (c1 - c0).cross(c2 - c0);
    const double size = cross.norm();
    if (!(size > 0)) return;
    const Vector3d normal = cross / size;
    const double height_a = normal.dot(a - c0), height_b = normal.dot(b - c0);
    if (height_a == height_b) return;
    const double t = std::clamp(height_a / (height_a - height_b), 0.0, 1.0);
    const Vector3d meeting = a + t * (b - a);
    const double w1 = (meeting - c0).cross(c2 - c0).dot(normal) / size,
                 w2 = (c1 - c0).cross(meeting - c0).dot(normal) / size;
    const std::array<double, 3> w{1 - w1 - w2, w1, w2};

    bool first_is_wrong = false;
    const std::span<const std::uint32_t> layers = contact_.layers();
    const bool of_layers = !layers.empty() && crossing.obstacle == kNone && layers[p[0]] != layers[p[2]];
    // What lies between a body and another garment has nowhere to go: the outer garment makes way.
    const std::uint32_t outer = of_layers ? std::max(layers[p[0]], layers[p[2]]) : 0;
    if (of_layers) {
      // The outer garment belongs before the inner one, whose normals look at it.
      first_is_wrong = (height_a < height_b) == (layers[p[0]] > layers[p[2]]);
    } else if (inside_[p[0]] != inside_[p[1]]) {
      first_is_wrong = inside_[p[0]] != 0;
    } else if (part_[p[0]] != part_[p[1]]) {
      const auto rank = [&](std::uint32_t v) { return std::pair(part_size_[part_[v]], part_[v]); };
      // Of a capsule's segment the nearer end goes back.
      const bool equal = part_size_[part_[p[0]]] == part_size_[part_[p[1]]];
      first_is_wrong = equal && p[0] >= pushes_.size() ? t < 0.5 : rank(p[0]) < rank(p[1]);
    } else {
      if (crossing.obstacle == kNone) shorten_contour(crossing, normal, t, w, x);
      return;
    }
    const std::uint32_t wrong = first_is_wrong ? p[0] : p[1];
    const double height = first_is_wrong ? height_a : height_b;
    const double side = (first_is_wrong ? height_b : height_a) >= 0 ? 1 : -1;
    const double depth = std::max(0.0, -side * height) + kMargin * contact_.thickness();
    push({wrong, p[2], p[3], p[4]}, {1, -w[0], -w[1], -w[2]}, side * normal, depth, outer);
  }

  // No side is the wrong one where a crossing ends inside of both surfaces. Moving the edge against the face along the
  // gradient of the contour's length pulls one out of the other (after Volino and Magnenat-Thalmann 2006): the contour
  // runs from the meeting point into each face at the edge.
  void shorten_contour(const Violation& crossing, const Vector3d& normal, double t, const std::array<double, 3>& w,
                       const Points& x) {
    const auto& p = crossing.particles;
    const Vector3d edge = (x[p[1]] - x[p[0]]).normalized();
    const double across = edge.dot(normal);
    if (std::abs(across) < 1e-3) return;
    const auto found = opposite_.find(std::minmax(p[0], p[1]));
    if (found == opposite_.end()) return;
    Vector3d gradient = Vector3d::Zero();
    for (const std::uint32_t o : found->second) {
      Vector3d wing = x[o] - x[p[0]];
      wing -= edge.dot(wing) * edge;
      Vector3d contour = normal.cross(edge.cross(wing));
      if (contour.dot(wing) < 0) contour = -contour;
      if (!(contour.norm() > 0)) continue;
      contour.normalize();
      gradient += contour - edge.dot(contour) / across * normal;
    }
    const double length = gradient.norm();
    if (length < 1e-3) return;
    const double step = kContourStep * mean_edge_;
    push({p[0], p[1], kNone, kNone}, {1 - t, t, 0, 0}, gradient / length, step / 2);
    push({p[2], p[3], p[4], kNone}, {w[0], w[1], w[2], 0}, -gradient / length, step / 2);
  }

  // What was never pushed follows its neighbours: its displacement from the start becomes their mean.
  void smooth(Points& x) {
    for (int sweep = 0; sweep < kSmoothingSweeps; ++sweep) {
      pushes_.assign(held_.size(), Vector3d::Zero());
      for (std::size_t v = 0; v < held_.size(); ++v) {
        const std::uint32_t first = offsets_[v], last = offsets_[v + 1];
        if (held_[v] || first == last) continue;
        for (std::uint32_t n = first; n < last; ++n) pushes_[v] += x[neighbours_[n]] - start_[neighbours_[n]];
        pushes_[v] /= static_cast<double>(last - first);
      }
      for (std::size_t v = 0; v < held_.size(); ++v) {
        if (!held_[v] && offsets_[v] != offsets_[v + 1]) x[v] = start_[v] + pushes_[v];
      }
    }
  }

  const ContactSystem& contact_;
  const Points start_;
  double mean_edge_ = 0;
  std::vector<std::uint32_t> offsets_, neighbours_;         // compressed rows: the cloth's vertices
  std::map<EdgeKey, std::vector<std::uint32_t>> opposite_;  // corners opposite to an edge of the cloth
  std::vector<char> held_;                                  // was pushed once
  std::vector<char> inside_;
  std::vector<std::uint32_t> part_, part_size_;
  Points pushes_;
  std::vector<int> counts_;
};

}  // namespace

bool untangle(ContactSystem& contact, Points& positions, ThreadPool& pool) {
  std::vector<Violation> violations = contact.violations(positions, pool);
  if (violations.empty()) return true;
  Untangler untangler(contact, positions);
  Points best = positions;
  std::size_t fewest = std::numeric_limits<std::size_t>::max();
  int waited = 0;
  for (int round = 0; round < kRounds && waited < kPatience; ++round) {
    if (violations.size() < fewest) {
      fewest = violations.size();
      best = positions;
      waited = 0;
    }
    ++waited;
    untangler.round(violations, positions);
    violations = contact.violations(positions, pool);
    if (violations.empty()) return true;
  }
  // What remains is named from the state that has least of it.
  positions = best;
  return false;
}

}  // namespace pleat::simulation
