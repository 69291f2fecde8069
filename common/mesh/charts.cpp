#include "common/mesh/charts.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <unordered_map>

#include "common/base/error.hpp"

namespace pleat {
namespace {

constexpr double kGap = 0.05;                   ///< between charts, of the largest extent
constexpr double kFarApart = 0.15;              ///< the same: from here on they are moved together
constexpr Eigen::Index kMostFaces = 1'000'000;  ///< beyond, overlaps are left to the rasteriser

using Point = Eigen::Vector2d;
using Triangle = std::array<Point, 3>;

Triangle corners(const Topology& t, Eigen::Index face) {
  Triangle triangle;
  for (int k = 0; k < 3; ++k) {
    triangle[static_cast<std::size_t>(k)] = t.uv.row(t.uv_faces(face, k)).cast<double>().transpose();
  }
  return triangle;
}

double area2(const Point& a, const Point& b, const Point& c) {
  return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
}

struct Extent {
  Point lower = Point::Constant(1e300), upper = Point::Constant(-1e300);
  void add(const Point& p) {
    lower = lower.cwiseMin(p);
    upper = upper.cwiseMax(p);
  }
  Point size() const { return upper - lower; }
};

std::vector<Extent> extents(const Topology& t, const std::vector<std::uint32_t>& charts) {
  const std::uint32_t count = charts.empty() ? 0 : *std::max_element(charts.begin(), charts.end()) + 1;
  std::vector<Extent> result(count);
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (const Point& p : corners(t, f)) result[charts[static_cast<std::size_t>(f)]].add(p);
  }
  return result;
}

/// The chart of each material coordinate; the number of charts for one that no face uses.
std::vector<std::uint32_t> uv_charts(const Topology& t, const std::vector<std::uint32_t>& charts, std::size_t count) {
  std::vector<std::uint32_t> result(static_cast<std::size_t>(t.uv.rows()), static_cast<std::uint32_t>(count));
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) result[t.uv_faces(f, k)] = charts[static_cast<std::size_t>(f)];
  }
  return result;
}

/// Whether triangles (counter-clockwise) share more than a sliver of area: no edge of one separates them.
bool overlap(const Triangle& a, const Triangle& b) {
  const auto separated = [](const Triangle& s, const Triangle& t) {
    for (std::size_t k = 0; k < 3; ++k) {
      const Point &p = s[k], &q = s[(k + 1) % 3];
      const double slack = 1e-5 * (q - p).squaredNorm();
      if (std::all_of(t.begin(), t.end(), [&](const Point& r) { return area2(p, q, r) <= slack; })) return true;
    }
    return false;
  };
  return !separated(a, b) && !separated(b, a);
}

}  // namespace

std::vector<std::uint32_t> face_charts(const Topology& t) {
  std::vector<std::uint32_t> parent(static_cast<std::size_t>(t.uv.rows()));
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&parent](std::uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (int k = 1; k < 3; ++k) parent[root(t.uv_faces(f, k))] = root(t.uv_faces(f, 0));
  }
  std::unordered_map<std::uint32_t, std::uint32_t> number;
  std::vector<std::uint32_t> charts;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const auto next = static_cast<std::uint32_t>(number.size());
    charts.push_back(number.try_emplace(root(t.uv_faces(f, 0)), next).first->second);
  }
  return charts;
}

std::size_t turn_mirrored_charts(Topology& t) {
  const std::vector<std::uint32_t> charts = face_charts(t);
  const std::vector<Extent> extent = extents(t, charts);
  std::vector<bool> mirrored(extent.size(), true);
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const Triangle c = corners(t, f);
    if (area2(c[0], c[1], c[2]) >= 0) mirrored[charts[static_cast<std::size_t>(f)]] = false;
  }
  const std::vector<std::uint32_t> chart_of = uv_charts(t, charts, extent.size());
  for (Eigen::Index u = 0; u < t.uv.rows(); ++u) {
    const std::uint32_t chart = chart_of[static_cast<std::size_t>(u)];
    if (chart >= extent.size() || !mirrored[chart]) continue;
    t.uv(u, 0) =
        static_cast<float>(extent[chart].lower.x() + extent[chart].upper.x() - static_cast<double>(t.uv(u, 0)));
  }
  return static_cast<std::size_t>(std::count(mirrored.begin(), mirrored.end(), true));
}

std::optional<std::pair<Eigen::Index, Eigen::Index>> find_overlap(const Topology& t, bool of_one_chart) {
  if (t.face_count() > kMostFaces) return std::nullopt;
  const std::vector<std::uint32_t> charts = face_charts(t);
  // Faces by the cells of a grid that their boxes touch; cells are about as large as faces.
  Extent whole;
  double sum = 0;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const Triangle c = corners(t, f);
    for (const Point& p : c) whole.add(p);
    sum += std::sqrt(std::abs(area2(c[0], c[1], c[2])));
  }
  const double cell = std::max(2 * sum / static_cast<double>(t.face_count()), whole.size().maxCoeff() / 4096);
  if (!(cell > 0)) return std::nullopt;
  std::unordered_map<std::uint64_t, std::vector<Eigen::Index>> grid;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const Triangle c = corners(t, f);
    Extent box;
    for (const Point& p : c) box.add(p);
    const auto low = ((box.lower - whole.lower) / cell).array().floor().cast<int>().eval();
    const auto high = ((box.upper - whole.lower) / cell).array().floor().cast<int>().eval();
    for (int y = low[1]; y <= high[1]; ++y) {
      for (int x = low[0]; x <= high[0]; ++x) {
        std::vector<Eigen::Index>& others =
            grid[(static_cast<std::uint64_t>(static_cast<std::uint32_t>(y)) << 32) | static_cast<std::uint32_t>(x)];
        for (const Eigen::Index g : others) {
          const bool same = charts[static_cast<std::size_t>(f)] == charts[static_cast<std::size_t>(g)];
          if (same == of_one_chart && overlap(c, corners(t, g))) return std::pair{g, f};
        }
        others.push_back(f);
      }
    }
  }
  return std::nullopt;
}

bool lay_out_charts(Topology& t) {
  const std::vector<std::uint32_t> charts = face_charts(t);
  const std::vector<Extent> extent = extents(t, charts);
  if (extent.size() < 2) return false;
  double largest = 0;
  for (const Extent& e : extent) largest = std::max(largest, e.size().maxCoeff());
  const auto is_alone = [&](const Extent& e) {
    return std::none_of(extent.begin(), extent.end(), [&](const Extent& other) {
      if (&other == &e) return false;
      const Point apart = (other.lower - e.upper).cwiseMax(e.lower - other.upper).cwiseMax(0);
      return apart.norm() <= kFarApart * largest;
    });
  };
  if (std::none_of(extent.begin(), extent.end(), is_alone) && !find_overlap(t, false)) return false;

  // Shelves of about the width of a square, the tallest first.
  std::vector<std::uint32_t> order(extent.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return extent[a].size().y() > extent[b].size().y(); });
  const double gap = kGap * largest;
  double area = 0;
  for (const Extent& e : extent) area += (e.size().x() + gap) * (e.size().y() + gap);
  const double width = std::max(largest, std::sqrt(area));
  std::vector<Point> move(extent.size());
  Point pen = Point::Zero();
  double shelf = 0;
  for (const std::uint32_t chart : order) {
    const Point size = extent[chart].size();
    if (pen.x() > 0 && pen.x() + size.x() > width) {
      pen = {0, pen.y() + shelf + gap};
      shelf = 0;
    }
    move[chart] = pen - extent[chart].lower;
    pen.x() += size.x() + gap;
    shelf = std::max(shelf, size.y());
  }
  const std::vector<std::uint32_t> chart_of = uv_charts(t, charts, extent.size());
  for (Eigen::Index u = 0; u < t.uv.rows(); ++u) {
    const std::uint32_t chart = chart_of[static_cast<std::size_t>(u)];
    if (chart < extent.size()) t.uv.row(u) = (t.uv.row(u).cast<double>() + move[chart].transpose()).cast<float>();
  }
  return true;
}

void prepare_garment(Topology& t, const std::string& name, std::vector<std::string>& notes) {
  if (t.uv_faces.rows() > 0) {
    if (const std::size_t turned = turn_mirrored_charts(t); turned > 0) {
      notes.push_back(name + ": " + std::to_string(turned) +
                      " mirrored islands of the material coordinates were turned over");
    }
  }
  validate_material_coordinates(t, name);
  if (const auto faces = find_overlap(t, true)) {
    throw_invalid_argument(name + ": faces " + std::to_string(faces->first) + " and " + std::to_string(faces->second) +
                           " of one island overlap in material coordinates; cut the island between them");
  }
  if (lay_out_charts(t)) {
    notes.push_back(name + ": the islands of the material coordinates overlap or lie far apart and were laid out anew");
  }
}

}  // namespace pleat
