#include "services/conversion/chart_raster.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "common/base/error.hpp"

namespace pleat {
namespace {

using Vec2 = Eigen::Vector2d;

// A centre this little outside (in barycentric coordinates) is on the edge: float material coordinates are not better.
constexpr double kEdgeTolerance = 1e-5;
// A centre this deep in two faces means that the material coordinates overlap.
constexpr double kOverlapDepth = 1e-3;

struct UvTriangle {
  Vec2 a, b, c;
  UvTriangle(const Topology& t, Eigen::Index f)
      : a(t.uv.row(t.uv_faces(f, 0)).cast<double>()),
        b(t.uv.row(t.uv_faces(f, 1)).cast<double>()),
        c(t.uv.row(t.uv_faces(f, 2)).cast<double>()) {}

  Eigen::Vector3d barycentric(const Vec2& p) const {
    const Vec2 e1 = b - a, e2 = c - a, d = p - a;
    const double area = e1.x() * e2.y() - e1.y() * e2.x();
    const double wb = (d.x() * e2.y() - d.y() * e2.x()) / area;
    const double wc = (e1.x() * d.y() - e1.y() * d.x()) / area;
    return {1 - wb - wc, wb, wc};
  }

  // Weights of the point of the triangle nearest to p, and its squared distance.
  std::pair<Eigen::Vector3d, double> nearest(const Vec2& p) const {
    const Eigen::Vector3d inside = barycentric(p);
    if (inside.minCoeff() >= 0) return {inside, 0};
    const std::array<Vec2, 3> corner{a, b, c};
    Eigen::Vector3d best = Eigen::Vector3d::Zero();
    double best_distance = std::numeric_limits<double>::max();
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3;
      const Vec2 edge = corner[static_cast<std::size_t>(next)] - corner[static_cast<std::size_t>(k)];
      const Vec2 offset = p - corner[static_cast<std::size_t>(k)];
      const double s = std::clamp(offset.dot(edge) / edge.squaredNorm(), 0.0, 1.0);
      const double distance = (offset - s * edge).squaredNorm();
      if (distance < best_distance) {
        best_distance = distance;
        best.setZero();
        best(k) = 1 - s;
        best(next) = s;
      }
    }
    return {best, best_distance};
  }
};

std::uint32_t root_of(std::vector<std::uint32_t>& parent, std::uint32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

// The chart of each material coordinate, named by its smallest member.
std::vector<std::uint32_t> find_charts(const Topology& t) {
  std::vector<std::uint32_t> parent(static_cast<std::size_t>(t.uv.rows()));
  std::iota(parent.begin(), parent.end(), 0u);
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (int k = 1; k < 3; ++k) {
      const std::uint32_t a = root_of(parent, t.uv_faces(f, 0)), b = root_of(parent, t.uv_faces(f, k));
      parent[std::max(a, b)] = std::min(a, b);
    }
  }
  for (std::uint32_t i = 0; i < parent.size(); ++i) parent[i] = root_of(parent, i);
  return parent;
}

Vec2 center_of(const TexelGrid& grid, std::size_t texel) {
  const auto column = static_cast<double>(texel % static_cast<std::size_t>(grid.width));
  const std::size_t whole_row = texel / static_cast<std::size_t>(grid.width);
  const auto row = static_cast<double>(whole_row);
  return {grid.u0 + column * grid.du, grid.v0 + row * grid.dv};
}

TexelSource make_source(std::uint32_t face, Eigen::Vector3d weights) {
  weights = weights.cwiseMax(0.0);
  weights /= weights.sum();
  return {face, {static_cast<float>(weights(0)), static_cast<float>(weights(1)), static_cast<float>(weights(2))}};
}

// Texel centres inside faces.
void fill_interior(const Topology& t, const TexelGrid& grid, const std::vector<std::uint32_t>& charts,
                   const std::string& name, ChartRaster& raster) {
  std::vector<double> depth(grid.size(), -1);
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const UvTriangle triangle(t, f);
    const Vec2 low = triangle.a.cwiseMin(triangle.b).cwiseMin(triangle.c);
    const Vec2 high = triangle.a.cwiseMax(triangle.b).cwiseMax(triangle.c);
    const auto first = [](double x, double x0, double dx) {
      return std::max(0, static_cast<int>(std::ceil((x - x0) / dx - 1e-3)));
    };
    const auto last = [](double x, double x0, double dx, int n) {
      return std::min(n - 1, static_cast<int>(std::floor((x - x0) / dx + 1e-3)));
    };
    for (int row = first(low.y(), grid.v0, grid.dv); row <= last(high.y(), grid.v0, grid.dv, grid.height); ++row) {
      for (int column = first(low.x(), grid.u0, grid.du); column <= last(high.x(), grid.u0, grid.du, grid.width);
           ++column) {
        const std::size_t texel =
            static_cast<std::size_t>(row) * static_cast<std::size_t>(grid.width) + static_cast<std::size_t>(column);
        const Eigen::Vector3d weights = triangle.barycentric(center_of(grid, texel));
        const double inside = weights.minCoeff();
        if (inside < -kEdgeTolerance) continue;
        if (inside > kOverlapDepth && depth[texel] > kOverlapDepth) {
          throw_invalid_argument(name + ": faces " + std::to_string(raster.sources[texel].face) + " and " +
                                 std::to_string(f) + " overlap in material coordinates");
        }
        if (raster.sources[texel].face != kNone && inside <= depth[texel]) continue;
        depth[texel] = inside;
        raster.sources[texel] = make_source(static_cast<std::uint32_t>(f), weights);
        raster.chart[texel] = charts[t.uv_faces(f, 0)];
      }
    }
  }
}

// The four texels around each material coordinate with their bilinear weights.
std::vector<TexelRead> bilinear_reads(const Topology& t, const TexelGrid& grid) {
  std::vector<TexelRead> reads(static_cast<std::size_t>(t.uv.rows()));
  for (std::size_t u = 0; u < reads.size(); ++u) {
    const auto split = [](double position, int count) {
      const int cell = std::clamp(static_cast<int>(std::floor(position)), 0, count - 2);
      return std::pair<int, double>(cell, std::clamp(position - cell, 0.0, 1.0));
    };
    const auto index = static_cast<Eigen::Index>(u);
    const auto [column, s] = split((static_cast<double>(t.uv(index, 0)) - grid.u0) / grid.du, grid.width);
    const auto [row, r] = split((static_cast<double>(t.uv(index, 1)) - grid.v0) / grid.dv, grid.height);
    const auto texel = static_cast<std::uint32_t>(row * grid.width + column);
    const auto width = static_cast<std::uint32_t>(grid.width);
    reads[u].texel = {texel, texel + 1, texel + width, texel + width + 1};
    reads[u].weight = {static_cast<float>((1 - s) * (1 - r)), static_cast<float>(s * (1 - r)),
                       static_cast<float>((1 - s) * r), static_cast<float>(s * r)};
  }
  return reads;
}

// Makes the texels valid that vertices at a chart's rim read beyond it.
void fill_rims(const Topology& t, const TexelGrid& grid, const std::vector<std::uint32_t>& charts,
               ChartRaster& raster) {
  std::vector<double> distance(grid.size(), std::numeric_limits<double>::max());
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const UvTriangle triangle(t, f);
    for (int k = 0; k < 3; ++k) {
      const TexelRead& read = raster.reads[t.uv_faces(f, k)];
      for (std::size_t i = 0; i < 4; ++i) {
        const std::size_t texel = read.texel[i];
        // A texel with distance max and a source is inside a chart.
        const bool inside =
            raster.sources[texel].face != kNone && distance[texel] == std::numeric_limits<double>::max();
        if (inside || read.weight[i] < 1e-6f) continue;
        const auto [weights, squared] = triangle.nearest(center_of(grid, texel));
        if (squared >= distance[texel]) continue;
        distance[texel] = squared;
        raster.sources[texel] = make_source(static_cast<std::uint32_t>(f), weights);
        raster.chart[texel] = charts[t.uv_faces(f, 0)];
      }
    }
  }
}

// Restricts each read to texels of the vertex's own chart.
void own_chart_only(const Topology& t, const TexelGrid& grid, const std::vector<std::uint32_t>& charts,
                    const std::string& name, ChartRaster& raster) {
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t u = t.uv_faces(f, k);
      TexelRead& read = raster.reads[u];
      float total = 0;
      for (std::size_t i = 0; i < 4; ++i) {
        if (raster.chart[read.texel[i]] != charts[u]) read.weight[i] = 0;
        total += read.weight[i];
      }
      if (total > 1e-4f) {
        for (float& weight : read.weight) weight /= total;
        continue;
      }
      const Vec2 p = t.uv.row(u).cast<double>();
      double best = std::numeric_limits<double>::max();
      read.weight = {0, 0, 0, 0};
      for (std::size_t texel = 0; texel < grid.size(); ++texel) {
        const double squared = (center_of(grid, texel) - p).squaredNorm();
        if (raster.chart[texel] == charts[u] && squared < best) {
          best = squared;
          read.texel[0] = static_cast<std::uint32_t>(texel);
          read.weight[0] = 1;
        }
      }
      if (read.weight[0] == 0) {
        throw_invalid_argument(name + ": an image of " + std::to_string(grid.width) + " x " +
                               std::to_string(grid.height) + " texels is too small: the chart of face " +
                               std::to_string(f) + " gets no texel");
      }
    }
  }
}

// The nearest valid texel of each texel, by Euclidean distance in texels: first along columns, then across rows.
std::vector<std::uint32_t> nearest_valid(const TexelGrid& grid, const std::vector<TexelSource>& sources) {
  const int width = grid.width, height = grid.height;
  constexpr int kFar = std::numeric_limits<int>::max() / 4;
  std::vector<int> row_of(grid.size(), -1);
  for (int column = 0; column < width; ++column) {
    const auto at = [&](int row) {
      return static_cast<std::size_t>(row) * static_cast<std::size_t>(width) + static_cast<std::size_t>(column);
    };
    int above = -kFar;
    for (int row = 0; row < height; ++row) {
      if (sources[at(row)].face != kNone) above = row;
      row_of[at(row)] = above;
    }
    int below = kFar;
    for (int row = height - 1; row >= 0; --row) {
      if (sources[at(row)].face != kNone) below = row;
      if (below - row < row - row_of[at(row)]) row_of[at(row)] = below;
    }
  }
  std::vector<std::uint32_t> nearest(grid.size());
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const std::size_t line = static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
      std::int64_t best = std::numeric_limits<std::int64_t>::max();
      for (int reach = 0; reach < width && static_cast<std::int64_t>(reach) * reach < best; ++reach) {
        for (const int other : {column - reach, column + reach}) {
          if (other < 0 || other >= width) continue;
          const int found = row_of[line + static_cast<std::size_t>(other)];
          if (std::abs(found) >= kFar) continue;
          const std::int64_t dy = found - row;
          const std::int64_t squared = dy * dy + static_cast<std::int64_t>(reach) * reach;
          if (squared < best) {
            best = squared;
            nearest[line + static_cast<std::size_t>(column)] = static_cast<std::uint32_t>(found * width + other);
          }
        }
      }
    }
  }
  return nearest;
}

}  // namespace

ChartRaster rasterise_charts(const Topology& t, const TexelGrid& grid, bool with_rims, const std::string& name) {
  const std::vector<std::uint32_t> charts = find_charts(t);
  ChartRaster raster;
  raster.sources.resize(grid.size());
  raster.chart.assign(grid.size(), kNone);
  fill_interior(t, grid, charts, name, raster);
  if (with_rims) {
    raster.reads = bilinear_reads(t, grid);
    fill_rims(t, grid, charts, raster);
    own_chart_only(t, grid, charts, name, raster);
  }
  if (std::all_of(raster.sources.begin(), raster.sources.end(), [](const TexelSource& s) { return s.face == kNone; })) {
    throw_invalid_argument(name + ": an image of " + std::to_string(grid.width) + " x " + std::to_string(grid.height) +
                           " texels is too small: no texel centre lies on the mesh");
  }
  raster.padded_by = nearest_valid(grid, raster.sources);
  return raster;
}

}  // namespace pleat
