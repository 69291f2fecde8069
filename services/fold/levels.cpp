#include "services/fold/levels.hpp"

#include <algorithm>
#include <unordered_map>
#include <utility>

#include "common/mesh/connectivity.hpp"

namespace pleat::fold {
namespace {

constexpr int kSmoothRounds = 3;  // of the coarsest level's moves
// Of the coarser levels, in a cloth without handles: what bears it (an obstacle) does so in many places, and levels
// that carry the load of all below shorten the cloth between them, which then lies in ridges.
constexpr float kWornStiffness = 0.1f;

std::uint64_t key(std::uint32_t a, std::uint32_t b) { return (std::uint64_t{std::min(a, b)} << 32) | std::max(a, b); }

}  // namespace

CoarserLevels::CoarserLevels(const Topology& coarse, const Subdivision& subdivision,
                             const simulation::Material& material)
    : parents_(static_cast<std::size_t>(subdivision.fine.vertex_count())),
      moved_(parents_.size()),
      smoothed_(parents_.size()) {
  const auto nowhere = static_cast<std::uint32_t>(parents_.size());
  for (std::size_t round = 0; round + 1 < subdivision.level_sizes.size(); ++round) {
    const Topology mesh = round == 0 ? coarse : subdivide(coarse, static_cast<int>(round)).fine;
    Level& level = levels_.emplace_back();
    level.size = subdivision.level_sizes[round];
    for (const float mass : lumped_masses(mesh, material.density)) level.inverse_masses.push_back(1 / mass);
    level.faces = FacePacks(stretch_faces(mesh, material), nowhere);
    add_parents(mesh, subdivision, round);
    if (round == 0) rings_ = Rings(mesh);
  }
}

void CoarserLevels::add_parents(const Topology& mesh, const Subdivision& subdivision, std::size_t round) {
  std::unordered_map<std::uint64_t, const Edge*> edges;
  const Connectivity connectivity = build_connectivity(mesh.vertex_count(), mesh.faces);
  for (const Edge& edge : connectivity.edges) edges.emplace(key(edge.v0, edge.v1), &edge);
  for (std::uint32_t v = subdivision.level_sizes[round]; v < subdivision.level_sizes[round + 1]; ++v) {
    const auto ends = subdivision.halved_edges[v];
    const Edge& edge = *edges.at(key(ends[0], ends[1]));
    parents_[v] = {ends, ends};
    if (edge.f1 != kNone) parents_[v].opposite = {edge.opposite0, edge.opposite1};
  }
}

void CoarserLevels::set_step(std::span<const char> fixed, float step_s) {
  fixed_.assign(fixed.begin(), fixed.end());
  const bool hangs = std::any_of(fixed.begin(), fixed.end(), [](char f) { return f != 0; });
  for (Level& level : levels_) {
    std::vector<float> mobile(level.inverse_masses);
    for (std::uint32_t v = 0; v < level.size; ++v) mobile[v] *= fixed[v] ? 0 : 1;
    level.faces.set_step(mobile, step_s, hangs ? 1 : kWornStiffness);
  }
}

// One pass moves each vertex of the coarsest faces by what its own faces lack. Taken over as it is, that leaves lumps
// of the size of a face, which lie across the larger folds and break them up into small ones.
void CoarserLevels::smooth_moves() {
  const std::uint32_t size = levels_[0].size;
  for (int round = 0; round < kSmoothRounds; ++round) {
    for (std::uint32_t v = 0; v < size; ++v) {
      smoothed_[v] = Float4{};
      if (fixed_[v]) continue;
      const std::span<const std::uint32_t> ring = rings_.of(v);
      Float4 sum = moved_[v];
      for (const std::uint32_t r : ring) sum += moved_[r];
      smoothed_[v] = sum / static_cast<float>(1 + ring.size());
    }
    std::swap(moved_, smoothed_);
  }
}

void CoarserLevels::solve(std::span<Float4> x) {
  for (const Level& level : levels_) {
    const bool coarsest = &level == &levels_.front();
    for (std::uint32_t v = 0; v < level.size; ++v) moved_[v] = x[v];
    level.faces.solve(x, true);
    for (std::uint32_t v = 0; v < level.size; ++v) {
      const Float4 before = moved_[v];
      moved_[v] = x[v] - before;
      if (coarsest) x[v] = before;
    }
    if (coarsest) {
      smooth_moves();
      for (std::uint32_t v = 0; v < level.size; ++v) x[v] += moved_[v];
    }
    // With Loop's weights of new vertices: moved linearly, the cloth would get creases along the coarser edges.
    for (auto v = level.size; v < parents_.size(); ++v) {
      const Parents& p = parents_[v];
      moved_[v] =
          0.375f * (moved_[p.ends[0]] + moved_[p.ends[1]]) + 0.125f * (moved_[p.opposite[0]] + moved_[p.opposite[1]]);
      x[v] += moved_[v];
    }
  }
}

}  // namespace pleat::fold
