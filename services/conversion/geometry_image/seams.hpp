// The cloth beyond a seam: what lies where a chart ends, if it went on. Internal to this room.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/mesh/connectivity.hpp"
#include "common/mesh/mesh.hpp"
#include "services/conversion/geometry_image/chart_raster.hpp"

namespace pleat::conversion {

/// Walks over a mesh in its material coordinates. A seam is an edge of two faces whose material coordinates differ: the
/// walk goes on in those of the other side, laid beside this one's without a gap, as panels lie before they are sewn.
class SeamWalk {
 public:
  /// scale: metres per unit of the material coordinates (recover_material_scale). The topology must outlive the walk
  /// and pass validate_topology and check_charts.
  SeamWalk(const Topology& topology, const Eigen::Vector2d& scale);

  /// The point of the cloth at `place`, in the material coordinates of a face's chart, if a way from that face to there
  /// leads over seams. None: the place is in the chart itself, or the cloth ends before. O(faces on the way).
  std::optional<TexelSource> find(std::uint32_t face, const Eigen::Vector2d& place) const;

  /// Where the cloth beyond the seams is: `reach` texels outwards from the ends of all of them, of both sides, in
  /// material coordinates. step: of a texel.
  std::vector<Eigen::Vector2d> beyond_ends(const Eigen::Vector2d& step, double reach) const;

 private:
  /// From the plane of one chart into that of another, in metres.
  struct Placement {
    Eigen::Matrix2d turn = Eigen::Matrix2d::Identity();
    Eigen::Vector2d shift = Eigen::Vector2d::Zero();
    Eigen::Vector2d operator()(const Eigen::Vector2d& p) const { return turn * p + shift; }
  };

  Eigen::Vector2d corner(std::uint32_t face, int k) const;
  double doubled_area(std::uint32_t face) const;
  Eigen::Vector3d barycentric(std::uint32_t face, const Eigen::Vector2d& p) const;
  std::uint32_t across(std::uint32_t face, int k) const;
  /// The corners of a neighbour at the ends of edge k.
  std::array<int, 2> shared_corners(std::uint32_t face, int k, std::uint32_t neighbour) const;
  bool is_seam(std::uint32_t face, int k, std::uint32_t neighbour) const;
  std::optional<Placement> over(std::uint32_t face, int k, std::uint32_t neighbour) const;

  const Topology& topology_;
  Eigen::Vector2d scale_;
  Connectivity connectivity_;
};

/// Padding that is at most `reach` texels from a chart and beyond a seam of it becomes part of that chart, with the
/// cloth on the other side. Returns these texels. O(padding within reach).
std::vector<std::uint32_t> continue_over_seams(const SeamWalk& walk, const TexelGrid& grid, int reach,
                                               ChartRaster& raster);

}  // namespace pleat::conversion
