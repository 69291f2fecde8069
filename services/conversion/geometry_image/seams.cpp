#include "services/conversion/geometry_image/seams.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <complex>
#include <utility>

namespace pleat::conversion {
namespace {

constexpr int kMostSteps = 1000;     // of a walk: it must end
constexpr double kOnEdge = 1e-9;     // barycentric
constexpr double kNoLength = 1e-12;  // m
constexpr double kMostStretch = 4;   // of an edge over that to which it is sewn

}  // namespace

SeamWalk::SeamWalk(const Topology& topology, const Eigen::Vector2d& scale)
    : topology_(topology), scale_(scale), connectivity_(build_connectivity(topology.vertex_count(), topology.faces)) {}

Eigen::Vector2d SeamWalk::corner(std::uint32_t face, int k) const {
  return topology_.uv.row(topology_.uv_faces(face, k)).cast<double>().transpose().cwiseProduct(scale_);
}

double SeamWalk::doubled_area(std::uint32_t face) const {
  Eigen::Matrix2d sides;
  sides << corner(face, 1) - corner(face, 0), corner(face, 2) - corner(face, 0);
  return sides.determinant();
}

Eigen::Vector3d SeamWalk::barycentric(std::uint32_t face, const Eigen::Vector2d& p) const {
  const auto area = [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); };
  const Eigen::Vector2d a = corner(face, 0), b = corner(face, 1) - a, c = corner(face, 2) - a, d = p - a;
  const double whole = area(b, c), second = area(d, c) / whole, third = area(b, d) / whole;
  return {1 - second - third, second, third};
}

std::uint32_t SeamWalk::across(std::uint32_t face, int k) const {
  const Edge& edge = connectivity_.edges[connectivity_.face_edges[face][static_cast<std::size_t>(k)]];
  return edge.f0 == face ? edge.f1 : edge.f0;
}

std::array<int, 2> SeamWalk::shared_corners(std::uint32_t face, int k, std::uint32_t neighbour) const {
  std::array<int, 2> corners{};
  for (int i = 0; i < 3; ++i) {
    if (topology_.faces(neighbour, i) == topology_.faces(face, k)) corners[0] = i;
    if (topology_.faces(neighbour, i) == topology_.faces(face, (k + 1) % 3)) corners[1] = i;
  }
  return corners;
}

bool SeamWalk::is_seam(std::uint32_t face, int k, std::uint32_t neighbour) const {
  const std::array<int, 2> other = shared_corners(face, k, neighbour);
  return topology_.uv_faces(face, k) != topology_.uv_faces(neighbour, other[0]) ||
         topology_.uv_faces(face, (k + 1) % 3) != topology_.uv_faces(neighbour, other[1]);
}

// The similarity that lays the edge here on the edge there; mirrored where one of the charts is.
std::optional<SeamWalk::Placement> SeamWalk::over(std::uint32_t face, int k, std::uint32_t neighbour) const {
  using Complex = std::complex<double>;
  const std::array<int, 2> other = shared_corners(face, k, neighbour);
  const Eigen::Vector2d from = corner(face, k), here = corner(face, (k + 1) % 3) - from;
  const Eigen::Vector2d to = corner(neighbour, other[0]), there = corner(neighbour, other[1]) - to;
  const double stretch = there.norm() / std::max(here.norm(), kNoLength);
  if (!(stretch > 1 / kMostStretch && stretch < kMostStretch)) return std::nullopt;
  const bool mirrored = doubled_area(face) * doubled_area(neighbour) < 0;
  const Complex edge(here.x(), mirrored ? -here.y() : here.y());
  const Complex turn = Complex(there.x(), there.y()) / edge;
  Placement placement;
  placement.turn << turn.real(), mirrored ? turn.imag() : -turn.imag(), turn.imag(),
      mirrored ? -turn.real() : turn.real();
  placement.shift = to - placement.turn * from;
  return placement;
}

std::optional<TexelSource> SeamWalk::find(std::uint32_t face, const Eigen::Vector2d& place) const {
  const Eigen::Vector2d start = place.cwiseProduct(scale_);
  Placement placement;
  bool beyond = false;
  for (int step = 0; step < kMostSteps; ++step) {
    if (std::abs(doubled_area(face)) < kNoLength * kNoLength) return std::nullopt;
    const Eigen::Vector3d weights = barycentric(face, placement(start));
    if (weights.minCoeff() >= -kOnEdge) {
      if (!beyond) return std::nullopt;
      const Eigen::Vector3f inside = (weights.cwiseMax(0.0) / weights.cwiseMax(0.0).sum()).cast<float>();
      return TexelSource{face, {inside[0], inside[1], inside[2]}};
    }
    // Out over the edge that is farthest behind, or another one where the cloth ends there.
    std::array<int, 3> order{0, 1, 2};
    std::sort(order.begin(), order.end(), [&](int a, int b) { return weights[a] < weights[b]; });
    bool went = false;
    for (const int away : order) {
      if (weights[away] >= -kOnEdge) break;
      const int k = (away + 1) % 3;
      const std::uint32_t next = across(face, k);
      if (next == kNone) continue;
      if (is_seam(face, k, next)) {
        const auto leap = over(face, k, next);
        if (!leap) continue;
        placement = {leap->turn * placement.turn, (*leap)(placement.shift)};
        beyond = true;
      }
      face = next;
      went = true;
      break;
    }
    if (!went) return std::nullopt;
  }
  return std::nullopt;
}

std::vector<Eigen::Vector2d> SeamWalk::beyond_ends(const Eigen::Vector2d& step, double reach) const {
  std::vector<Eigen::Vector2d> places;
  for (std::uint32_t face = 0; face < static_cast<std::uint32_t>(topology_.face_count()); ++face) {
    const auto texel = [&](int k) -> Eigen::Vector2d {
      return topology_.uv.row(topology_.uv_faces(face, k)).cast<double>().transpose().cwiseQuotient(step);
    };
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t other = across(face, k);
      if (other == kNone || !is_seam(face, k, other)) continue;
      const Eigen::Vector2d from = texel(k), to = texel((k + 1) % 3), along = to - from;
      Eigen::Vector2d outwards = Eigen::Vector2d(along.y(), -along.x()).stableNormalized();
      if (outwards.dot(texel((k + 2) % 3) - from) > 0) outwards = -outwards;
      for (const Eigen::Vector2d& end : {from, to}) places.emplace_back((end + reach * outwards).cwiseProduct(step));
    }
  }
  return places;
}

std::vector<std::uint32_t> continue_over_seams(const SeamWalk& walk, const TexelGrid& grid, int reach,
                                               ChartRaster& raster) {
  const auto width = static_cast<std::size_t>(grid.width);
  std::vector<std::uint32_t> beyond;
  std::vector<TexelSource> sources;
  for (std::size_t texel = 0; texel < grid.size(); ++texel) {
    if (raster.sources[texel].face != kNone) continue;
    const std::size_t nearest = raster.padded_by[texel];
    const auto column = static_cast<std::int64_t>(texel % width), row = static_cast<std::int64_t>(texel / width);
    const std::int64_t dx = column - static_cast<std::int64_t>(nearest % width);
    const std::int64_t dy = row - static_cast<std::int64_t>(nearest / width);
    if (dx * dx + dy * dy > std::int64_t{reach} * reach) continue;
    const Eigen::Vector2d place(grid.u0 + static_cast<double>(column) * grid.du,
                                grid.v0 + static_cast<double>(row) * grid.dv);
    const auto source = walk.find(raster.sources[nearest].face, place);
    if (!source) continue;
    beyond.push_back(static_cast<std::uint32_t>(texel));
    sources.push_back(*source);
  }
  for (std::size_t i = 0; i < beyond.size(); ++i) {
    raster.sources[beyond[i]] = sources[i];
    raster.chart[beyond[i]] = raster.chart[raster.padded_by[beyond[i]]];
  }
  if (!beyond.empty()) raster.padded_by = nearest_valid(grid, raster.sources);
  return beyond;
}

}  // namespace pleat::conversion
