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

// Eight particles: where the step ends, and by how much they move in it.
struct Moving8 {
  Points8 end, motion;
};

template <typename Moving, typename IndexOf>
Moving8 gather(const std::vector<Moving>& moving, const IndexOf& index_of) {
  Float4 end[kLanes], motion[kLanes];
  for (std::size_t k = 0; k < kLanes; ++k) {
    const Moving& particle = moving[index_of(k)];
    end[k] = particle.end;
    motion[k] = particle.motion;
  }
  Float8 e[4], m[4];
  transpose(end, e);
  transpose(motion, m);
  return {{e[0], e[1], e[2]}, {m[0], m[1], m[2]}};
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

// The vertex-face and edge-edge pairs that two faces own, each pair of the mesh being owned by one pair of faces. Bits
// 0-2: vertices of f with g, bits 3-5: vertices of g with f, bit 6 + 3 i + j: edge i of f with edge j of g.
std::uint32_t ContactSystem::owned_pairs(std::uint32_t f, std::uint32_t g) const {
  const std::uint32_t own_f = own_bits_[f], own_g = own_bits_[g], edges_f = own_f >> 3, edges_g = own_g >> 3;
  const std::uint32_t first_of_rows = (edges_f & 1u) | (edges_f & 2u) << 2 | (edges_f & 4u) << 4;
  return (own_f & 7u) | (own_g & 7u) << 3 | (first_of_rows * edges_g) << 6;
}

// owned: some of owned_pairs().
void ContactSystem::append_pairs(std::uint32_t f, std::uint32_t g, std::uint32_t owned, std::vector<Pair>& out) const {
  const auto &c = faces_[f], &d = faces_[g];
  std::size_t at = out.size();
  out.resize(at + static_cast<std::size_t>(__builtin_popcount(owned)));
  for (; owned != 0; owned &= owned - 1) {
    const auto bit = static_cast<std::size_t>(__builtin_ctz(owned));
    if (bit >= 6) {
      const auto &a = edges_[own_edges_[f][(bit - 6) / 3]], &b = edges_[own_edges_[g][(bit - 6) % 3]];
      out[at++] = {{a[0], a[1], b[0], b[1]}, Kind::kEdgeEdge, 0};
    } else if (bit >= 3) {
      out[at++] = {{d[bit - 3], c[0], c[1], c[2]}, Kind::kVertexFace, 0};
    } else {
      out[at++] = {{c[bit], d[0], d[1], d[2]}, Kind::kVertexFace, 0};
    }
  }
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
      std::uint32_t apart = 0;  // those that share no vertex
      std::vector<Pair> owned;
      const std::uint32_t all = owned_pairs(f, g);
      append_pairs(f, g, all, owned);
      std::uint32_t rest = all;
      for (const Pair& pair : owned) {
        const auto& v = pair.v;
        const bool shares = pair.kind == Kind::kVertexFace
                                ? v[0] == v[1] || v[0] == v[2] || v[0] == v[3]
                                : v[0] == v[2] || v[0] == v[3] || v[1] == v[2] || v[1] == v[3];
        if (!shares) apart |= rest & -rest;
        rest &= rest - 1;
      }
      if (apart != 0) neighbours_.push_back({f, g, between, apart, -1});
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
    for (std::size_t i = 0; i < 4; ++i) p[i] = gather(moving_, [&](std::size_t k) { return at(k).v[i]; });
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
    const Points8 &x0 = p[0].end, &x1 = p[1].end, &x2 = p[2].end, &x3 = p[3].end;
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
  const std::size_t parts = (neighbours_.size() + kGrain - 1) / kGrain;
  if (parts_.size() < parts) parts_.resize(parts);
  const double reach = thickness_ + 4 * slack_ + 2 * kGap;
  pool.parallel_for(neighbours_.size(), kGrain, [&](std::size_t begin, std::size_t last) {
    auto& [candidates, kept] = parts_[begin / kGrain];
    candidates.clear();
    kept.clear();
    std::vector<std::uint32_t> ends;  // of the candidates of each neighbour that is looked at
    std::vector<Neighbours*> looked;
    for (std::size_t i = begin; i < last; ++i) {
      Neighbours& n = neighbours_[i];
      const double deformation = deformation_of(n);
      if (deformation < n.safe_until) continue;
      append_pairs(n.f, n.g, n.owned, candidates);
      ends.push_back(static_cast<std::uint32_t>(candidates.size()));
      looked.push_back(&n);
    }
    std::vector<double> clearances(candidates.size());
    keep_close(candidates, start, end, kept, clearances);
    std::size_t next = 0;
    for (std::size_t k = 0; k < looked.size(); ++k) {
      double clearance = 1e30;
      for (; next < ends[k]; ++next) clearance = std::min(clearance, clearances[next]);
      looked[k]->safe_until = deformation_of(*looked[k]) + clearance - reach;
    }
  });
  take_kept(parts);
}

// The first parts' pairs, in their order.
void ContactSystem::take_kept(std::size_t parts) {
  for (std::size_t i = 0; i < parts; ++i) {
    pairs_.insert(pairs_.end(), parts_[i].kept.begin(), parts_[i].kept.end());
  }
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
    const Moving8 a = gather(moving_, [&](std::size_t k) { return faces_[at(k).first][i]; });
    const Moving8 b = gather(moving_, [&](std::size_t k) { return faces_[at(k).second][i]; });
    if (i == 0) {
      origin = a.end;
      error = 4 * rounding(origin);
    }
    a1[i] = a.end - origin;
    b1[i] = b.end - origin;
    a0[i] = a1[i] - a.motion;
    b0[i] = b1[i] - b.motion;
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
    for (std::size_t i = begin; i < last; ++i) {
      boxes_[i] = SweptBox(start[i], end[i], margin);
      moving_[i] = {to_float4(end[i]), boxes_[i].motion_lower};
    }
  });
  cloth_bvh_.refit(boxes_, pool);
  face_pairs_.clear();
  pairs_.clear();
  if (scene_.contact.self_collision) {
    add_neighbours(start, end, pool);
    for (const auto& [f, g] : cloth_bvh_.self_pairs(pool, 1'000'000 + 1000 * cloth_faces_)) {
      if (!is_joined(f, g)) face_pairs_.push_back({f, g});
    }
  }
  if (!obstacle_bvh_.empty()) {
    obstacle_bvh_.refit(boxes_, cloth_bvh_);
    const std::size_t first = face_pairs_.size();
    cloth_bvh_.append_pairs(obstacle_bvh_, face_pairs_);
    for (std::size_t i = first; i < face_pairs_.size(); ++i) {
      face_pairs_[i].second += static_cast<std::uint32_t>(cloth_faces_);
    }
  }
  constexpr std::size_t kGrain = 4096;
  const std::size_t parts = (face_pairs_.size() + kGrain - 1) / kGrain;
  if (parts_.size() < parts) parts_.resize(parts);
  pool.parallel_for(face_pairs_.size(), kGrain, [&](std::size_t begin, std::size_t last) {
    auto& [candidates, kept] = parts_[begin / kGrain];
    candidates.clear();
    kept.clear();
    for (std::size_t p = begin; p < last; p += kLanes) {
      const std::span group = std::span(face_pairs_).subspan(p, std::min(kLanes, last - p));
      const std::uint32_t gone = apart(group);
      for (std::size_t k = 0; k < group.size(); ++k) {
        const auto [f, g] = group[k];
        if ((gone >> k & 1u) == 0) append_pairs(f, g, owned_pairs(f, g), candidates);
      }
    }
    keep_close(candidates, start, end, kept, {});
  });
  take_kept(parts);
  add_round_pairs(start, end, margin);
  pairs_end_ = end;
}

}  // namespace pleat::simulation
