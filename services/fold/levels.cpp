#include "services/fold/levels.hpp"

#include <algorithm>
#include <unordered_map>

#include "common/mesh/connectivity.hpp"

namespace pleat::fold {
namespace {

std::uint64_t key(std::uint32_t a, std::uint32_t b) { return (std::uint64_t{std::min(a, b)} << 32) | std::max(a, b); }

}  // namespace

CoarserLevels::CoarserLevels(const Topology& coarse, const Subdivision& subdivision,
                             const simulation::Material& material)
    : parents_(static_cast<std::size_t>(subdivision.fine.vertex_count())), moved_(parents_.size()) {
  const auto nowhere = static_cast<std::uint32_t>(parents_.size());
  for (std::size_t round = 0; round + 1 < subdivision.level_sizes.size(); ++round) {
    const Topology mesh = round == 0 ? coarse : subdivide(coarse, static_cast<int>(round)).fine;
    Level& level = levels_.emplace_back();
    level.size = subdivision.level_sizes[round];
    for (const float mass : lumped_masses(mesh, material.density)) level.inverse_masses.push_back(1 / mass);
    level.faces = FacePacks(stretch_faces(mesh, material), nowhere);
    add_parents(mesh, subdivision, round);
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

void CoarserLevels::set_step(std::span<const char> fixed, float mobility, float step_s) {
  for (Level& level : levels_) {
    std::vector<float> mobile(level.inverse_masses);
    for (std::uint32_t v = 0; v < level.size; ++v) mobile[v] *= fixed[v] ? 0 : mobility;
    level.faces.set_step(mobile, step_s);
  }
}

void CoarserLevels::solve(std::span<Float4> x) {
  for (const Level& level : levels_) {
    for (std::uint32_t v = 0; v < level.size; ++v) moved_[v] = -x[v];
    level.faces.solve(x, true);
    for (std::uint32_t v = 0; v < level.size; ++v) moved_[v] += x[v];
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
