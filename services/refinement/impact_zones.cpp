#include "services/refinement/impact_zones.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

#include "common/mesh/triangle_intersection.hpp"

namespace pleat {
namespace {

// Above this many candidate pairs a zone is tested by searches that stop at the first hit.
constexpr std::size_t kMaxCandidates = 400'000;
constexpr int kGrowthsOfUncleanInput = 1;

std::uint32_t root_of(std::vector<std::uint32_t>& parent, std::uint32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

class Zones {
 public:
  Zones(const BlendProblem& problem, Positions& positions, SelfIntersectionFinder& finder)
      : problem_(problem),
        positions_(positions),
        finder_(finder),
        zone_of_(static_cast<std::size_t>(positions.rows()), -1),
        face_in_zone_(static_cast<std::size_t>(finder.faces().rows()), 0) {}

  void seed(std::span<const FacePair> pairs, std::span<const std::uint32_t> penetrations) {
    std::vector<std::uint32_t> parent(zone_of_.size());
    std::iota(parent.begin(), parent.end(), 0u);
    std::vector<std::uint8_t> used(zone_of_.size(), 0);
    const auto unite = [&](std::uint32_t a, std::uint32_t b) {
      used[a] = used[b] = 1;
      a = root_of(parent, a);
      b = root_of(parent, b);
      parent[std::max(a, b)] = std::min(a, b);
    };
    const auto add_face = [&](std::uint32_t face, std::uint32_t anchor) {
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t v = finder_.faces()(face, k);
        unite(v, anchor);
        for (const std::uint32_t n : ring(v)) unite(n, v);
      }
    };
    for (const FacePair& pair : pairs) {
      for (const std::uint32_t face : pair) add_face(face, finder_.faces()(pair[0], 0));
    }
    for (const std::uint32_t face : penetrations) add_face(face, finder_.faces()(face, 0));
    std::vector<int> zone_of_root(zone_of_.size(), -1);
    for (std::uint32_t v = 0; v < zone_of_.size(); ++v) {
      if (used[v] == 0) continue;
      int& zone = zone_of_root[root_of(parent, v)];
      if (zone < 0) {
        zone = static_cast<int>(zones_.size());
        zones_.emplace_back();
      }
      add(zone, v);
    }
  }

  void seed_all() {
    zones_.emplace_back();
    for (std::uint32_t v = 0; v < zone_of_.size(); ++v) add(0, v);
  }

  std::size_t solve_all() {
    std::size_t solved = 0;
    for (int zone = 0; zone < static_cast<int>(zones_.size()); ++zone) {
      if (zones_[static_cast<std::size_t>(zone)].empty()) continue;
      solve(zone);
      ++solved;
    }
    return solved;
  }

 private:
  std::span<const std::uint32_t> ring(std::uint32_t v) const {
    const Neighbourhood& n = *problem_.neighbourhood;
    return std::span(n.vertices).subspan(n.vertex_offsets[v], n.vertex_offsets[v + 1] - n.vertex_offsets[v]);
  }

  void add(int zone, std::uint32_t v) {
    zone_of_[v] = zone;
    zones_[static_cast<std::size_t>(zone)].push_back(v);
  }

  // v joins the zone; if it has another, that one joins as a whole.
  void absorb(int zone, std::uint32_t v) {
    const int other = zone_of_[v];
    if (other == zone) return;
    if (other < 0) {
      add(zone, v);
      return;
    }
    for (const std::uint32_t w : std::exchange(zones_[static_cast<std::size_t>(other)], {})) add(zone, w);
  }

  void grow(int zone, const std::vector<std::uint32_t>& offenders, int rings) {
    for (const std::uint32_t f : offenders) {
      for (int k = 0; k < 3; ++k) absorb(zone, finder_.faces()(f, k));
    }
    for (int i = 0; i < rings; ++i) {
      const std::vector<std::uint32_t> members = zones_[static_cast<std::size_t>(zone)];
      for (const std::uint32_t v : members) {
        for (const std::uint32_t n : ring(v)) absorb(zone, n);
      }
    }
  }

  void set_weight(int zone, float weight) {
    const Positions &safe = *problem_.safe, &wanted = *problem_.wanted;
    for (const std::uint32_t v : zones_[static_cast<std::size_t>(zone)]) {
      if (weight == 1) {
        positions_.row(v) = wanted.row(v);
        continue;
      }
      // Rounding must not leave the box of the two ends, which the candidates are found with.
      const Eigen::RowVector3f a = safe.row(v), b = wanted.row(v);
      positions_.row(v) = (a + weight * (b - a)).cwiseMax(a.cwiseMin(b)).cwiseMin(a.cwiseMax(b));
    }
  }

  // The faces that touch the zone, ascending.
  void collect_faces(int zone) {
    for (const std::uint32_t f : faces_) face_in_zone_[f] = 0;
    faces_.clear();
    const Neighbourhood& n = *problem_.neighbourhood;
    for (const std::uint32_t v : zones_[static_cast<std::size_t>(zone)]) {
      for (std::uint32_t i = n.face_offsets[v]; i < n.face_offsets[v + 1]; ++i) {
        if (face_in_zone_[n.faces[i]] != 0) continue;
        face_in_zone_[n.faces[i]] = 1;
        faces_.push_back(n.faces[i]);
      }
    }
    std::sort(faces_.begin(), faces_.end());
  }

  // Each pair of a zone's face with another face once. Returns false if visit() asked to stop.
  template <typename Visit>
  bool visit_neighbours(const Visit& visit) const {
    bool go_on = true;
    for (const std::uint32_t f : faces_) {
      finder_.query(finder_.box(f), [&](std::uint32_t g) {
        if (go_on && g != f && (face_in_zone_[g] == 0 || f < g)) go_on = visit(f, g);
      });
      if (!go_on) return false;
    }
    return true;
  }

  // All pairs that may meet while the zone moves between the two ends; false if they are too many to keep.
  bool collect_candidates() {
    candidates_.clear();
    finder_.update_swept(*problem_.safe, *problem_.wanted, faces_);
    return visit_neighbours([&](std::uint32_t f, std::uint32_t g) {
      if (candidates_.size() == kMaxCandidates) return false;
      candidates_.push_back({f, g});
      return true;
    });
  }

  // Whether the zone's faces are clean at the current positions; otherwise, if asked for, all faces that are not.
  bool is_clean(bool use_candidates, std::vector<std::uint32_t>* offenders) {
    bool clean = true;
    const auto report = [&](std::uint32_t f) {
      clean = false;
      if (offenders != nullptr) offenders->push_back(f);
      return offenders != nullptr;
    };
    for (const std::uint32_t f : faces_) {
      if (problem_.field->empty()) break;
      if (problem_.field->penetrates(positions_, finder_.faces(), f) && !report(f)) return false;
    }
    const auto test = [&](std::uint32_t f, std::uint32_t g) {
      return !faces_intersect(positions_, finder_.faces(), f, g) || (report(g) && report(f));
    };
    if (use_candidates) {
      for (const FacePair& pair : candidates_) {
        if (boxes_overlap(pair[0], pair[1]) && !test(pair[0], pair[1])) return false;
      }
    } else if (face_in_zone_.size() == faces_.size()) {
      finder_.update(positions_);
      std::vector<FacePair> pairs;
      finder_.find(positions_, offenders == nullptr ? 1 : kMaxCandidates, pairs);
      for (const FacePair& pair : pairs) clean = report(pair[0]) && report(pair[1]) && clean;
      clean = clean && pairs.empty();
    } else {
      finder_.update(positions_, faces_);
      visit_neighbours(test);
    }
    return clean;
  }

  bool boxes_overlap(std::uint32_t f, std::uint32_t g) const {
    for (int k = 0; k < 3; ++k) {
      const auto at = [&](std::uint32_t face, int corner) { return positions_(finder_.faces()(face, corner), k); };
      const float f0 = at(f, 0), f1 = at(f, 1), f2 = at(f, 2), g0 = at(g, 0), g1 = at(g, 1), g2 = at(g, 2);
      if (std::min({f0, f1, f2}) > std::max({g0, g1, g2}) || std::min({g0, g1, g2}) > std::max({f0, f1, f2}))
        return false;
    }
    return true;
  }

  void solve(int zone) {
    std::vector<std::uint32_t> offenders;
    for (int growth = 0;; ++growth) {
      collect_faces(zone);
      const bool use_candidates = collect_candidates();
      set_weight(zone, 0);
      offenders.clear();
      const bool safe = is_clean(use_candidates, &offenders);
      const std::size_t size = zones_[static_cast<std::size_t>(zone)].size();
      if (safe || size == zone_of_.size() || (!problem_.may_take_all && growth == kGrowthsOfUncleanInput)) {
        if (safe) {
          bisect(zone, use_candidates);
        } else {
          choose_end(zone, use_candidates, offenders.size());
        }
        finder_.update(positions_, faces_);
        return;
      }
      set_weight(zone, 1);
      finder_.update(positions_, faces_);
      grow(zone, offenders, 1 << std::min(growth, 6));
      if (problem_.may_take_all && 2 * zones_[static_cast<std::size_t>(zone)].size() > zone_of_.size()) {
        for (std::uint32_t v = 0; v < zone_of_.size(); ++v) absorb(zone, v);
      }
    }
  }

  // Weight 0 is clean.
  void bisect(int zone, bool use_candidates) {
    float clean = 0, unclean = 1;
    for (int i = 0; i < problem_.bisections; ++i) {
      const float middle = 0.5f * (clean + unclean);
      set_weight(zone, middle);
      (is_clean(use_candidates, nullptr) ? clean : unclean) = middle;
    }
    set_weight(zone, clean);
  }

  // Weight 0 is not clean, because the coarse mesh is not: keep the end with fewer offences, the wanted one if equal.
  void choose_end(int zone, bool use_candidates, std::size_t offences_when_safe) {
    std::vector<std::uint32_t> offenders;
    set_weight(zone, 1);
    is_clean(use_candidates, &offenders);
    if (offences_when_safe < offenders.size()) set_weight(zone, 0);
  }

  const BlendProblem& problem_;
  Positions& positions_;
  SelfIntersectionFinder& finder_;
  std::vector<int> zone_of_;                       // of a vertex, or -1
  std::vector<std::vector<std::uint32_t>> zones_;  // vertices; a swallowed zone is empty
  std::vector<std::uint8_t> face_in_zone_;         // of the zone being solved
  std::vector<std::uint32_t> faces_;               // of the zone being solved
  std::vector<FacePair> candidates_;
};

}  // namespace

Neighbourhood build_neighbourhood(const Faces& faces, Eigen::Index vertex_count) {
  Neighbourhood n;
  std::vector<std::vector<std::uint32_t>> at(static_cast<std::size_t>(vertex_count)), around(at.size());
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      at[faces(f, k)].push_back(static_cast<std::uint32_t>(f));
      around[faces(f, k)].push_back(faces(f, (k + 1) % 3));
      around[faces(f, k)].push_back(faces(f, (k + 2) % 3));
    }
  }
  n.vertex_offsets.push_back(0);
  n.face_offsets.push_back(0);
  for (std::size_t v = 0; v < at.size(); ++v) {
    std::sort(around[v].begin(), around[v].end());
    around[v].erase(std::unique(around[v].begin(), around[v].end()), around[v].end());
    n.vertices.insert(n.vertices.end(), around[v].begin(), around[v].end());
    n.faces.insert(n.faces.end(), at[v].begin(), at[v].end());
    n.vertex_offsets.push_back(static_cast<std::uint32_t>(n.vertices.size()));
    n.face_offsets.push_back(static_cast<std::uint32_t>(n.faces.size()));
  }
  return n;
}

std::size_t resolve_zones(const BlendProblem& problem, std::span<const FacePair> pairs,
                          std::span<const std::uint32_t> penetrations, bool all, Positions& positions,
                          SelfIntersectionFinder& finder) {
  Zones zones(problem, positions, finder);
  if (all) {
    zones.seed_all();
  } else {
    zones.seed(pairs, penetrations);
  }
  return zones.solve_all();
}

}  // namespace pleat
