// Which pairs of primitives can matter in a step: the hierarchies' pairs of faces, thinned out eight at a time in
// float32, and what is left in double.
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "common/base/simd.hpp"
#include "common/mesh/closest_points8.hpp"
#include "services/simulation/contact.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

// Above, the faces that an edge joins are looked for like all others: some 25 a face are too many to remember.
constexpr std::size_t kMostJoinedFaces = 100'000;

constexpr std::size_t kLanes = 8;

// Eight particles: where the step starts, and by how much they move in it.
struct Moving8 {
  Points8 start, motion;
  Points8 end() const { return start + motion; }
};

// The boxes of single particles hold both.
template <typename IndexOf>
Moving8 gather(const std::vector<SweptBox>& boxes, const IndexOf& index_of) {
  Float4 start[kLanes], motion[kLanes];
  for (std::size_t k = 0; k < kLanes; ++k) {
    const SweptBox& box = boxes[index_of(k)];
    start[k] = 0.5f * (box.lower + box.upper);
    motion[k] = box.motion_lower;
  }
  Float8 s[4], m[4];
  transpose(start, s);
  transpose(motion, m);
  return {{s[0], s[1], s[2]}, {m[0], m[1], m[2]}};
}

}  // namespace

// Keeps the pair if it may matter for the motion or at its end. Returns the distance at the end, less the minimum.
double ContactSystem::keep_if_close(const Pair& pair, const Points& start, const Points& end,
                                    std::vector<Pair>& out) const {
  const auto& v = pair.v;
  const double clearance = std::sqrt(closest(pair, end).squared_distance) - static_cast<double>(pair.minimum);
  bool keep = clearance <= thickness_ + 2 * slack_;
  if (!keep) {
    const std::array<Vector3d, 4> from{start[v[0]], start[v[1]], start[v[2]], start[v[3]]};
    const std::array<Vector3d, 4> to{end[v[0]], end[v[1]], end[v[2]], end[v[3]]};
    const double bound = motion_bound(from, to, pair.kind == Kind::kEdgeEdge ? 2 : 1);
    // With every vertex within slack_ of `end`, distances change by 2 slack_ and bounds by 4 slack_ at most.
    keep = clearance <= bound + 6 * slack_ + 2 * kGap;
  }
  if (keep) out.push_back(pair);
  return clearance;
}

// Calls use(pair) for the vertex-face and edge-edge pairs that two faces own, each pair of the mesh being owned by one
// pair of faces. boxes: only those whose boxes overlap.
template <typename Use>
void ContactSystem::for_each_pair(std::uint32_t f, std::uint32_t g, bool boxes, const Use& use) const {
  SweptBox box_f, box_g;
  if (boxes) {
    box_f = face_box(f);
    box_g = face_box(g);
  }
  const auto vertices_against_face = [&](std::uint32_t owner, std::uint32_t face, const SweptBox& face_box) {
    const auto& corners = faces_[face];
    for (const std::uint32_t v : own_vertices_[owner]) {
      if (v == kNone || v == corners[0] || v == corners[1] || v == corners[2]) continue;
      if (boxes && !boxes_[v].may_meet(face_box)) continue;
      use(Pair{{v, corners[0], corners[1], corners[2]}, Kind::kVertexFace, 0});
    }
  };
  vertices_against_face(f, g, box_g);
  vertices_against_face(g, f, box_f);
  for (const std::uint32_t e : own_edges_[f]) {
    if (e == kNone) continue;
    const auto [a, b] = edges_[e];
    SweptBox box = boxes_[a];
    box.extend(boxes_[b]);
    if (boxes && !box.may_meet(box_g)) continue;
    for (const std::uint32_t other : own_edges_[g]) {
      if (other == kNone) continue;
      const auto [c, d] = edges_[other];
      if (a == c || a == d || b == c || b == d) continue;
      if (boxes) {
        SweptBox other_box = boxes_[c];
        other_box.extend(boxes_[d]);
        if (!box.may_meet(other_box)) continue;
      }
      use(Pair{{a, b, c, d}, Kind::kEdgeEdge, 0});
    }
  }
}

SweptBox ContactSystem::face_box(std::uint32_t f) const {
  SweptBox box = boxes_[faces_[f][0]];
  box.extend(boxes_[faces_[f][1]]);
  box.extend(boxes_[faces_[f][2]]);
  return box;
}

void ContactSystem::find_neighbours() {
  std::vector<std::vector<std::uint32_t>> at_vertex(cloth_count_);
  for (std::uint32_t f = 0; f < cloth_faces_; ++f) {
    for (const std::uint32_t v : faces_[f]) at_vertex[v].push_back(f);
  }
  // Face and the one between, the shared vertex before the joining edge.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> near;
  const auto add = [&](std::uint32_t f, std::size_t from, bool sharing) {
    std::sort(near.begin() + static_cast<std::ptrdiff_t>(from), near.end());
    for (std::size_t i = from; i < near.size(); ++i) {
      const auto [g, between] = near[i];
      const bool known = std::any_of(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(i),
                                     [g = g](const auto& other) { return other.first == g; });
      if (g <= f || known) continue;
      bool owns = false;
      for_each_pair(f, g, false, [&](const Pair&) { owns = true; });
      if (owns) neighbours_.push_back({f, g, between, -1});
      if (!sharing) joined_.push_back(g);
    }
  };
  joined_first_.assign(1, 0);
  for (std::uint32_t f = 0; f < cloth_faces_; ++f) {
    near.clear();
    for (const std::uint32_t v : faces_[f]) {
      for (const std::uint32_t g : at_vertex[v]) near.emplace_back(g, f);
    }
    add(f, 0, true);
    const std::size_t sharing = near.size();
    for (std::size_t i = 0; i < sharing && cloth_faces_ <= kMostJoinedFaces; ++i) {
      const std::uint32_t between = near[i].first;
      for (const std::uint32_t v : faces_[between]) {
        for (const std::uint32_t g : at_vertex[v]) near.emplace_back(g, between);
      }
    }
    add(f, sharing, false);
    joined_.resize((joined_.size() + 7) / 8 * 8, kNone);
    joined_first_.push_back(static_cast<std::uint32_t>(joined_.size()));
  }
  deformation_.assign(cloth_faces_, 0);
}

bool ContactSystem::is_joined(std::uint32_t f, std::uint32_t g) const {
  for (std::uint32_t i = joined_first_[f]; i < joined_first_[f + 1]; i += 8) {
    bool found = false;
    for (std::uint32_t k = 0; k < 8; ++k) found |= joined_[i + k] == g;
    if (found) return true;
  }
  return false;
}

// keep_if_close for many: first, eight at a time and in float32, who is surely too far away. clearances: gets a lower
// bound of each candidate's distance at the end, unless it is empty.
void ContactSystem::keep_close(std::span<const Pair> candidates, const Points& start, const Points& end,
                               std::vector<Pair>& out, std::span<double> clearances) const {
  const Float8 reach = broadcast8(static_cast<float>(thickness_ + 2 * slack_));
  const auto beyond = static_cast<float>(6 * slack_ + 2 * kGap);
  for (std::size_t begin = 0; begin < candidates.size(); begin += kLanes) {
    const std::size_t count = std::min(kLanes, candidates.size() - begin);
    const auto at = [&](std::size_t k) -> const Pair& { return candidates[begin + std::min(k, count - 1)]; };
    std::array<Moving8, 4> p;
    for (std::size_t i = 0; i < 4; ++i) p[i] = gather(boxes_, [&](std::size_t k) { return at(k).v[i]; });
    Int8 edges{};
    for (std::size_t k = 0; k < kLanes; ++k) edges[static_cast<int>(k)] = at(k).kind == Kind::kEdgeEdge ? -1 : 0;
    // Bound of the motion of the two sides towards each other (motion_bound).
    const Points8 mean = (p[0].motion + p[1].motion + p[2].motion + p[3].motion) * broadcast8(0.25f);
    std::array<Float8, 4> speed;
    for (std::size_t i = 0; i < 4; ++i) {
      const Points8 own = p[i].motion - mean;
      speed[i] = dot(own, own);
    }
    const Float8 later = max(speed[2], speed[3]);
    const Float8 bound =
        sqrt(select(edges, max(speed[0], speed[1]), speed[0])) + sqrt(select(edges, later, max(speed[1], later)));
    const Points8 x0 = p[0].end(), x1 = p[1].end(), x2 = p[2].end(), x3 = p[3].end();
    const Float8 squared =
        select(edges, squared_edge_edge_distance(x0, x1, x2, x3), squared_vertex_face_distance(x0, x1, x2, x3));
    const Float8 distance = at_least(squared, max(max(rounding(x0), rounding(x1)), max(rounding(x2), rounding(x3))));
    const std::uint32_t far = bits(distance > max(reach, bound + beyond));
    for (std::size_t k = 0; k < count; ++k) {
      double clearance = static_cast<double>(distance[static_cast<int>(k)]);
      if ((far >> k & 1u) == 0) clearance = keep_if_close(candidates[begin + k], start, end, out);
      if (!clearances.empty()) clearances[begin + k] = clearance;
    }
  }
}

// Two points of faces that share a vertex can't have come closer than the deformation of the two faces since they were
// last measured: each has moved, relative to the shared vertex, by the change of its face's edge vectors at most. Where
// an edge joins the faces its own change counts too.
void ContactSystem::add_neighbours(const Points& start, const Points& end, ThreadPool& pool) {
  const bool first = pairs_end_.size() != end.size();
  if (first) {
    for (Neighbours& n : neighbours_) n.safe_until = -1;
  } else {
    pool.parallel_for(cloth_faces_, 4096, [&](std::size_t begin, std::size_t last) {
      for (std::size_t f = begin; f < last; ++f) {
        double most = 0;
        for (std::size_t k = 0; k < 3; ++k) {
          const std::uint32_t a = faces_[f][k], b = faces_[f][(k + 1) % 3];
          const Vector3d before = pairs_end_[b] - pairs_end_[a], now = start[b] - start[a], then = end[b] - end[a];
          most = std::max(most, (now - before).norm() + (then - now).norm());
        }
        deformation_[f] += most;
      }
    });
  }
  constexpr std::size_t kGrain = 8192;
  std::vector<std::vector<Pair>> results((neighbours_.size() + kGrain - 1) / kGrain);
  const double reach = thickness_ + 4 * slack_ + 2 * kGap;
  pool.parallel_for(neighbours_.size(), kGrain, [&](std::size_t begin, std::size_t last) {
    std::vector<Pair> candidates;
    std::vector<std::uint32_t> ends;  // of the candidates of each neighbour that is looked at
    std::vector<Neighbours*> looked;
    for (std::size_t i = begin; i < last; ++i) {
      Neighbours& n = neighbours_[i];
      const double deformation = deformation_of(n);
      if (deformation < n.safe_until) continue;
      for_each_pair(n.f, n.g, false, [&](const Pair& pair) { candidates.push_back(pair); });
      ends.push_back(static_cast<std::uint32_t>(candidates.size()));
      looked.push_back(&n);
    }
    std::vector<double> clearances(candidates.size());
    keep_close(candidates, start, end, results[begin / kGrain], clearances);
    std::size_t next = 0;
    for (std::size_t k = 0; k < looked.size(); ++k) {
      double clearance = 1e30;
      for (; next < ends[k]; ++next) clearance = std::min(clearance, clearances[next]);
      looked[k]->safe_until = deformation_of(*looked[k]) + clearance - reach;
    }
  });
  for (const auto& r : results) pairs_.insert(pairs_.end(), r.begin(), r.end());
}

// Which of at most eight pairs of faces (f of the cloth, g) a plane keeps apart for the whole motion, a bit each, and
// by more than any pair that is kept: the distance of two points along a fixed direction is linear in time, so that its
// least value is at the start or at the end. Most faces whose boxes meet lie beside each other on the cloth, and the
// line between their centres tells; or one lies under the other, and a normal does.
std::uint32_t ContactSystem::apart(std::span<const SweptBvh::Pair> faces) const {
  if (faces.empty()) return 0;
  const auto at = [&](std::size_t k) -> const SweptBvh::Pair& { return faces[std::min(k, faces.size() - 1)]; };
  std::array<Points8, 3> a0, a1, b0, b1;
  Points8 origin{};
  Float8 error{};
  for (std::size_t i = 0; i < 3; ++i) {
    const Moving8 a = gather(boxes_, [&](std::size_t k) { return faces_[at(k).first][i]; });
    const Moving8 b = gather(boxes_, [&](std::size_t k) { return faces_[at(k).second][i]; });
    if (i == 0) {
      origin = a.start;
      error = 4 * rounding(origin);
    }
    a0[i] = a.start - origin;
    b0[i] = b.start - origin;
    a1[i] = a0[i] + a.motion;
    b1[i] = b0[i] + b.motion;
  }
  const Points8 between =
      a0[0] + a0[1] + a0[2] + a1[0] + a1[1] + a1[2] - (b0[0] + b0[1] + b0[2] + b1[0] + b1[1] + b1[2]);
  // As in keep_if_close: vertices may yet move by slack_, on either side.
  const auto at_start = static_cast<float>(2 * slack_ + 2 * kGap);
  const auto at_end = static_cast<float>(thickness_ + 2 * slack_ + 2 * kGap);
  const auto along = [&](const Points8& axis) {
    const auto gap = [&](const std::array<Points8, 3>& p, const std::array<Points8, 3>& q) {
      return min(min(dot(axis, p[0]), dot(axis, p[1])), dot(axis, p[2])) -
             max(max(dot(axis, q[0]), dot(axis, q[1])), dot(axis, q[2]));
    };
    const Float8 length = (1 + 1e-5f) * sqrt(dot(axis, axis));
    return (gap(a0, b0) > length * (at_start + error)) & (gap(a1, b1) > length * (at_end + error));
  };
  const auto along_normal = [&](const std::array<Points8, 3>& face) {
    const Points8 normal = cross(face[1] - face[0], face[2] - face[0]);
    return along(normal * select(dot(normal, between) < 0, broadcast8(-1), broadcast8(1)));
  };
  return bits(along(between) | along_normal(a1) | along_normal(b1));
}

void ContactSystem::find_pairs(const Points& start, const Points& end, ThreadPool& pool) {
  const double margin = 0.5 * thickness_ + slack_ + kGap;
  pool.parallel_for(particle_count_, 4096, [&](std::size_t begin, std::size_t last) {
    for (std::size_t i = begin; i < last; ++i) boxes_[i] = SweptBox(start[i], end[i], margin);
  });
  cloth_bvh_.refit(boxes_, pool);
  std::vector<SweptBvh::Pair> face_pairs;
  if (scene_.contact.self_collision) face_pairs = cloth_bvh_.self_pairs(pool, 1'000'000 + 1000 * cloth_faces_);
  if (!obstacle_bvh_.empty()) {
    obstacle_bvh_.refit(boxes_, pool);
    for (const auto& [f, g] : cloth_bvh_.pairs(obstacle_bvh_)) {
      face_pairs.push_back({f, g + static_cast<std::uint32_t>(cloth_faces_)});
    }
  }
  constexpr std::size_t kGrain = 4096;
  std::vector<std::vector<Pair>> results((face_pairs.size() + kGrain - 1) / kGrain);
  pool.parallel_for(face_pairs.size(), kGrain, [&](std::size_t begin, std::size_t last) {
    std::vector<Pair> candidates;
    std::array<SweptBvh::Pair, kLanes> group{};
    for (std::size_t p = begin; p < last;) {
      std::size_t count = 0;
      for (; p < last && count < kLanes; ++p) {
        const auto [f, g] = face_pairs[p];
        if (g >= cloth_faces_ || !is_joined(f, g)) group[count++] = face_pairs[p];
      }
      const std::uint32_t gone = apart({group.data(), count});
      for (std::size_t k = 0; k < count; ++k) {
        if ((gone >> k & 1u) != 0) continue;
        for_each_pair(group[k].first, group[k].second, true, [&](const Pair& pair) { candidates.push_back(pair); });
      }
    }
    keep_close(candidates, start, end, results[begin / kGrain], {});
  });
  pairs_.clear();
  if (scene_.contact.self_collision) add_neighbours(start, end, pool);
  for (const auto& r : results) pairs_.insert(pairs_.end(), r.begin(), r.end());
  add_round_pairs(start, end, margin);
  pairs_end_ = end;
}

}  // namespace pleat::simulation
