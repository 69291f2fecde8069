#include "services/fold/rings.hpp"

#include "common/mesh/connectivity.hpp"

namespace pleat::fold {

Rings::Rings(const Topology& mesh, Border border) {
  const auto count = static_cast<std::size_t>(mesh.vertex_count());
  const std::vector<Edge> edges = build_connectivity(mesh.vertex_count(), mesh.faces).edges;
  std::vector<char> on_border(count, 0);
  if (border == kAlongBorders) {
    for (const Edge& edge : edges) {
      if (edge.f1 == kNone) on_border[edge.v0] = on_border[edge.v1] = 1;
    }
  }
  std::vector<std::vector<std::uint32_t>> lists(count);
  const auto add = [&](const Edge& edge, std::uint32_t from, std::uint32_t to) {
    if (!on_border[from] || edge.f1 == kNone) lists[from].push_back(to);
  };
  for (const Edge& edge : edges) {
    add(edge, edge.v0, edge.v1);
    add(edge, edge.v1, edge.v0);
  }
  begin_.push_back(0);
  for (const auto& list : lists) {
    neighbours_.insert(neighbours_.end(), list.begin(), list.end());
    begin_.push_back(static_cast<std::uint32_t>(neighbours_.size()));
  }
}

}  // namespace pleat::fold
