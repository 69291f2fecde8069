#include "services/conversion/geometry_image/chart_raster.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "common/base/error.hpp"

namespace pleat::conversion {
namespace {

using Vec2 = Eigen::Vector2d;

// A centre this little outside (in barycentric coordinates) is on the edge: float material coordinates are not better.
constexpr double kEdgeTolerance = 1e-5;
// A centre this deep in two faces means that the material coordinates overlap.
constexpr double kOverlapDepth = 1e-3;

double cross(const Vec2& a, const Vec2& b) { return a.x() * b.y() - a.y() * b.x(); }

struct UvTriangle {
  Vec2 a, b, c;
  UvTriangle(const Topology& t, Eigen::Index f)
      : a(t.uv.row(t.uv_faces(f, 0)).cast<double>()),
        b(t.uv.row(t.uv_faces(f, 1)).cast<double>()),
        c(t.uv.row(t.uv_faces(f, 2)).cast<double>()) {}

  double doubled_area() const { return cross(b - a, c - a); }

  // Needs an area.
  Eigen::Vector3d barycentric(const Vec2& p) const {
    const Vec2 e1 = b - a, e2 = c - a, d = p - a;
    const double area = cross(e1, e2);
    const double wb = cross(d, e2) / area;
    const double wc = cross(e1, d) / area;
    return {1 - wb - wc, wb, wc};
  }

  // Weights of the point of the triangle nearest to p, and its squared distance.
  std::pair<Eigen::Vector3d, double> nearest(const Vec2& p, bool has_area) const {
    if (has_area) {
      const Eigen::Vector3d inside = barycentric(p);
      if (inside.minCoeff() >= 0) return {inside, 0};
    }
    const std::array<Vec2, 3> corner{a, b, c};
    Eigen::Vector3d best = Eigen::Vector3d::Zero();
    double best_distance = std::numeric_limits<double>::max();
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3;
      const Vec2 edge = corner[static_cast<std::size_t>(next)] - corner[static_cast<std::size_t>(k)];
      const Vec2 offset = p - corner[static_cast<std::size_t>(k)];
      const double length2 = edge.squaredNorm();
      const double s = length2 > 0 ? std::clamp(offset.dot(edge) / length2, 0.0, 1.0) : 0;
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

// Twice the area below which a face counts as one without: a millionth of the mean.
double smallest_doubled_area(const Topology& t) {
  double total = 0;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) total += std::abs(UvTriangle(t, f).doubled_area());
  return 1e-6 * total / static_cast<double>(t.face_count());
}

// The value below which half of the weight is.
double weighted_median(std::vector<std::pair<double, double>>& values) {
  std::sort(values.begin(), values.end());
  double total = 0, sum = 0;
  for (const auto& [value, weight] : values) total += weight;
  for (const auto& [value, weight] : values) {
    sum += weight;
    if (sum >= 0.5 * total) return value;
  }
  return values.back().first;
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
void fill_interior(const Topology& t, const TexelGrid& grid, const std::vector<std::uint32_t>& charts, double smallest,
                   const std::string& name, ChartRaster& raster) {
  std::vector<double> depth(grid.size(), -1);
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const UvTriangle triangle(t, f);
    if (std::abs(triangle.doubled_area()) <= smallest) continue;
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
      // Coordinates that no face uses may be anywhere.
      position = std::clamp(position, 0.0, static_cast<double>(count - 1));
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
void fill_rims(const Topology& t, const TexelGrid& grid, const std::vector<std::uint32_t>& charts, double smallest,
               ChartRaster& raster) {
  std::vector<double> distance(grid.size(), std::numeric_limits<double>::max());
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const UvTriangle triangle(t, f);
    const bool has_area = std::abs(triangle.doubled_area()) > smallest;
    for (int k = 0; k < 3; ++k) {
      const TexelRead& read = raster.reads[t.uv_faces(f, k)];
      for (std::size_t i = 0; i < 4; ++i) {
        const std::size_t texel = read.texel[i];
        // A texel with distance max and a source is inside a chart.
        const bool inside =
            raster.sources[texel].face != kNone && distance[texel] == std::numeric_limits<double>::max();
        if (inside || read.weight[i] < 1e-6f) continue;
        const auto [weights, squared] = triangle.nearest(center_of(grid, texel), has_area);
        if (squared >= distance[texel]) continue;
        distance[texel] = squared;
        raster.sources[texel] = make_source(static_cast<std::uint32_t>(f), weights);
        raster.chart[texel] = charts[t.uv_faces(f, 0)];
        raster.is_rim[texel] = 1;
      }
    }
  }
}

// The texels of each chart, in compressed rows by chart.
struct ChartTexels {
  std::vector<std::uint32_t> offsets, texels;
  ChartTexels(std::size_t charts, const std::vector<std::uint32_t>& chart_of) : offsets(charts + 1, 0) {
    for (const std::uint32_t chart : chart_of) {
      if (chart != kNone) ++offsets[chart + 1];
    }
    std::partial_sum(offsets.begin(), offsets.end(), offsets.begin());
    texels.resize(offsets.back());
    std::vector<std::uint32_t> next(offsets.begin(), offsets.end() - 1);
    for (std::uint32_t texel = 0; texel < chart_of.size(); ++texel) {
      if (chart_of[texel] != kNone) texels[next[chart_of[texel]]++] = texel;
    }
  }
};

// Restricts each read to texels of the vertex's own chart.
void own_chart_only(const Topology& t, const TexelGrid& grid, const std::vector<std::uint32_t>& charts,
                    const std::string& name, ChartRaster& raster) {
  const ChartTexels of_chart(charts.size(), raster.chart);
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
      for (std::uint32_t i = of_chart.offsets[charts[u]]; i < of_chart.offsets[charts[u] + 1]; ++i) {
        const std::uint32_t texel = of_chart.texels[i];
        const double squared = (center_of(grid, texel) - p).squaredNorm();
        if (squared >= best) continue;
        best = squared;
        read.texel[0] = texel;
        read.weight[0] = 1;
      }
      if (read.weight[0] == 0) {
        throw_invalid_argument(name + ": an image of " + std::to_string(grid.width) + " x " +
                               std::to_string(grid.height) + " texels is too small: the chart of face " +
                               std::to_string(f) + " gets no texel");
      }
    }
  }
}

}  // namespace

// First along columns, then across rows by the lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012).
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
  struct Parabola {
    std::int64_t column, height;
    std::int64_t first;  // column from which on it is the lowest
  };
  std::vector<Parabola> envelope;
  for (int row = 0; row < height; ++row) {
    const std::size_t line = static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
    envelope.clear();
    for (std::int64_t column = 0; column < width; ++column) {
      const int found = row_of[line + static_cast<std::size_t>(column)];
      if (std::abs(found) >= kFar) continue;
      Parabola next{column, static_cast<std::int64_t>(found - row) * (found - row), 0};
      while (!envelope.empty()) {
        const Parabola& last = envelope.back();
        // They meet at numerator / (2 span); where that is a column, the one whose column is nearer has it.
        const std::int64_t numerator =
            next.height + next.column * next.column - last.height - last.column * last.column;
        const std::int64_t span = 2 * (next.column - last.column);
        const std::int64_t floor = numerator >= 0 ? numerator / span : -((-numerator + span - 1) / span);
        next.first = floor + (floor * span == numerator && next.height > last.height ? 0 : 1);
        if (next.first > last.first) break;
        envelope.pop_back();
      }
      if (envelope.empty()) next.first = 0;
      if (next.first < width) envelope.push_back(next);
    }
    std::size_t lowest = 0;
    for (int column = 0; column < width && !envelope.empty(); ++column) {
      while (lowest + 1 < envelope.size() && envelope[lowest + 1].first <= column) ++lowest;
      const auto source = static_cast<std::size_t>(envelope[lowest].column);
      nearest[line + static_cast<std::size_t>(column)] =
          static_cast<std::uint32_t>(row_of[line + source]) * static_cast<std::uint32_t>(width) +
          static_cast<std::uint32_t>(source);
    }
  }
  return nearest;
}

void check_charts(const Topology& t, const std::string& name) {
  if (t.uv_faces.rows() == 0) throw_invalid_argument(name + ": no material coordinates (`vt` in OBJ); they are needed");
  const double smallest = smallest_doubled_area(t);
  const std::vector<std::uint32_t> charts = find_charts(t);
  std::vector<std::int64_t> positive(charts.size(), -1), negative(charts.size(), -1);
  bool any = false;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const double area = UvTriangle(t, f).doubled_area();
    if (!(std::abs(area) > smallest)) continue;
    any = true;
    const std::uint32_t chart = charts[t.uv_faces(f, 0)];
    (area > 0 ? positive : negative)[chart] = f;
    if (positive[chart] >= 0 && negative[chart] >= 0) {
      throw_invalid_argument(name + ": material coordinates are folded: faces " + std::to_string(positive[chart]) +
                             " and " + std::to_string(negative[chart]) + " of one chart have opposite orientation");
    }
  }
  if (!any) throw_invalid_argument(name + ": no face has area in material coordinates");
}

Vec2 recover_material_scale(const Topology& t) {
  const double smallest = smallest_doubled_area(t);
  std::vector<std::pair<double, double>> along_u, along_v;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const UvTriangle triangle(t, f);
    const double area = triangle.doubled_area();
    if (std::abs(area) <= smallest) continue;
    const auto rest = [&](int k) -> Eigen::Vector3d { return t.rest_positions.row(t.faces(f, k)).cast<double>(); };
    const Eigen::Vector3d x1 = rest(1) - rest(0), x2 = rest(2) - rest(0);
    const Vec2 u1 = triangle.b - triangle.a, u2 = triangle.c - triangle.a;
    // Derivatives of the rest positions by u and v.
    along_u.emplace_back(((u2.y() * x1 - u1.y() * x2) / area).norm(), std::abs(area));
    along_v.emplace_back(((u1.x() * x2 - u2.x() * x1) / area).norm(), std::abs(area));
  }
  Vec2 scale(weighted_median(along_u), weighted_median(along_v));
  constexpr double kMetres = 0.1;
  if (((scale.array() - 1).abs() < kMetres).all() || !(scale.minCoeff() > 0)) return Vec2::Ones();
  return scale;
}

ChartRaster rasterise_charts(const Topology& t, const TexelGrid& grid, bool with_rims, const std::string& name) {
  const std::vector<std::uint32_t> charts = find_charts(t);
  ChartRaster raster;
  raster.sources.resize(grid.size());
  raster.chart.assign(grid.size(), kNone);
  raster.is_rim.assign(grid.size(), 0);
  const double smallest = smallest_doubled_area(t);
  fill_interior(t, grid, charts, smallest, name, raster);
  if (with_rims) {
    raster.reads = bilinear_reads(t, grid);
    fill_rims(t, grid, charts, smallest, raster);
    own_chart_only(t, grid, charts, name, raster);
  }
  if (std::all_of(raster.sources.begin(), raster.sources.end(), [](const TexelSource& s) { return s.face == kNone; })) {
    throw_invalid_argument(name + ": an image of " + std::to_string(grid.width) + " x " + std::to_string(grid.height) +
                           " texels is too small: no texel centre lies on the mesh");
  }
  raster.padded_by = nearest_valid(grid, raster.sources);
  return raster;
}

}  // namespace pleat::conversion
