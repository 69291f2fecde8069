#include "services/fold/viscosity.hpp"

#include "common/mesh/connectivity.hpp"

namespace pleat::fold {
namespace {

// m^2/s. Implicit steps h take omega^2 h / 2 a second from a wave of frequency omega. Waves of wave number k in the
// middle of a cloth that hangs by its length L have omega^2 = g L / 2 k^2, so that they lose what nu = g L h / 4 takes:
// 0.0125 for a tablecloth of a metre and the simulation's 5 ms.
constexpr double kViscosity = 0.0125;

}  // namespace

Viscosity::Viscosity(const Topology& mesh) : rings_(mesh, Rings::kAlongBorders) {
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(mesh.vertex_count()); ++v) {
    weights_.push_back(1 / static_cast<float>(std::max<std::size_t>(rings_.of(v).size(), 1)));
  }
  double sum = 0;
  const std::vector<Edge> edges = build_connectivity(mesh.vertex_count(), mesh.faces).edges;
  for (const Edge& edge : edges) {
    sum += static_cast<double>((mesh.rest_positions.row(edge.v1) - mesh.rest_positions.row(edge.v0)).squaredNorm());
  }
  if (sum > 0) rate_ = static_cast<float>(4 * kViscosity * static_cast<double>(edges.size()) / sum);
}

}  // namespace pleat::fold
