#include "common/mesh/holes.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <unordered_map>

#include "common/mesh/connectivity.hpp"
#include "common/mesh/triangulate.hpp"

namespace pleat {
namespace {

constexpr double kThickness = 0.05;        ///< of a slab: of its extent, and metres at least
constexpr double kEnclosesNothing = 1e-4;  ///< volume over area^1.5; 0.094 for a sphere
constexpr std::size_t kLongLoop = 400;     ///< corners; longer ones are not cut by ears, which costs their cube

using Loop = std::vector<std::uint32_t>;
using Triangles = std::vector<std::array<std::uint32_t, 3>>;

/// The rims of holes, each in the direction that a face on its other side has there. Where a rim comes back to one of
/// its vertices it is cut into two, so that each passes a vertex once.
std::vector<Loop> find_loops(const Connectivity& connectivity) {
  std::multimap<std::uint32_t, std::uint32_t> next;
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 == kNone) next.emplace(edge.v1, edge.v0);
  }
  std::vector<Loop> loops;
  std::unordered_map<std::uint32_t, std::size_t> place;
  while (!next.empty()) {
    Loop path{next.begin()->first};
    place = {{path[0], 0}};
    for (auto step = next.begin(); step != next.end(); step = next.find(path.back())) {
      const std::uint32_t vertex = step->second;
      next.erase(step);
      const auto [seen, is_new] = place.try_emplace(vertex, path.size());
      if (is_new) {
        path.push_back(vertex);
        continue;
      }
      const auto begin = path.begin() + static_cast<std::ptrdiff_t>(seen->second);
      loops.emplace_back(begin, path.end());
      for (auto left = begin + 1; left != path.end(); ++left) place.erase(*left);
      path.erase(begin + 1, path.end());
    }
  }
  return loops;
}

/// Triangles over a rim whose inner edges are new to the mesh; nothing if there are none.
Triangles cover(const Loop& loop, const Positions& positions,
                const std::set<std::pair<std::uint32_t, std::uint32_t>>& edges) {
  const std::size_t n = loop.size();
  if (n < 3) return {};
  const auto usable = [&](const Triangles& triangles) {
    for (const auto& t : triangles) {
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t a = t[k], b = t[(k + 1) % 3];
        const bool rim = (a + 1) % n == b || (b + 1) % n == a;
        if (!rim && edges.contains(std::minmax(loop[a], loop[b]))) return false;
      }
    }
    return true;
  };
  std::vector<Triangles> candidates;
  if (n <= kLongLoop) {
    std::vector<Eigen::Vector3f> polygon;
    for (const std::uint32_t v : loop) polygon.emplace_back(positions.row(v).transpose());
    if (auto triangles = triangulate(polygon)) candidates.push_back(*std::move(triangles));
  }
  for (std::uint32_t first = 0; first < n && first < 16; ++first) {
    Triangles fan;
    for (std::uint32_t i = 1; i + 1 < n; ++i) {
      fan.push_back(
          {first, static_cast<std::uint32_t>((first + i) % n), static_cast<std::uint32_t>((first + i + 1) % n)});
    }
    candidates.push_back(std::move(fan));
  }
  for (Triangles& triangles : candidates) {
    if (!usable(triangles)) continue;
    for (auto& t : triangles) t = {loop[t[0]], loop[t[1]], loop[t[2]]};
    return std::move(triangles);
  }
  return {};
}

struct Measures {
  double volume = 0, area = 0;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< sum of area vectors
};

Measures measure(const Positions& positions, const Faces& faces) {
  Measures m;
  const Eigen::RowVector3d origin = positions.cast<double>().colwise().mean();
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Eigen::Vector3d a = (positions.row(faces(f, 0)).cast<double>() - origin).transpose();
    const Eigen::Vector3d b = (positions.row(faces(f, 1)).cast<double>() - origin).transpose();
    const Eigen::Vector3d c = (positions.row(faces(f, 2)).cast<double>() - origin).transpose();
    const Eigen::Vector3d vector = (b - a).cross(c - a) / 2;
    m.volume += a.dot(b.cross(c)) / 6;
    m.area += vector.norm();
    m.normal += vector;
  }
  return m;
}

Topology make_slab(const Topology& sheet, const Connectivity& connectivity) {
  Eigen::Vector3d back = -measure(sheet.rest_positions, sheet.faces).normal;
  if (back.norm() > 0) back.normalize();
  const bool flat = std::abs(back.y()) > 0.7;
  const bool upside_down = flat && back.y() > 0;
  if (upside_down) back = -back;
  const Eigen::Vector3f extent =
      (sheet.rest_positions.colwise().maxCoeff() - sheet.rest_positions.colwise().minCoeff()).transpose();
  const double thickness = std::max(kThickness, kThickness * static_cast<double>(extent.norm()));
  const auto n = static_cast<std::uint32_t>(sheet.vertex_count());
  Topology slab;
  slab.rest_positions.resize(2 * sheet.vertex_count(), 3);
  slab.rest_positions << sheet.rest_positions,
      sheet.rest_positions.rowwise() + (thickness * back).cast<float>().transpose();
  std::vector<std::array<std::uint32_t, 3>> faces;
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (upside_down) std::swap(b, c);
    faces.push_back({a, b, c});
  };
  for (Eigen::Index f = 0; f < sheet.face_count(); ++f) {
    const std::uint32_t a = sheet.faces(f, 0), b = sheet.faces(f, 1), c = sheet.faces(f, 2);
    add(a, b, c);
    add(a + n, c + n, b + n);
  }
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 != kNone) continue;
    add(edge.v1, edge.v0, edge.v0 + n);
    add(edge.v1, edge.v0 + n, edge.v1 + n);
  }
  slab.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k)
      slab.faces(static_cast<Eigen::Index>(f), static_cast<Eigen::Index>(k)) = faces[f][k];
  }
  return slab;
}

void turn_outwards(Topology& mesh, double volume, const std::string& name, std::vector<std::string>& notes) {
  if (!(volume < 0)) return;
  mesh.faces.col(1).swap(mesh.faces.col(2));
  if (mesh.uv_faces.rows() > 0) mesh.uv_faces.col(1).swap(mesh.uv_faces.col(2));
  notes.push_back(name + ": its faces look inwards; they were turned over");
}

}  // namespace

Topology close_holes(Topology mesh, bool keep_vertices, const std::string& name, std::vector<std::string>& notes) {
  const Connectivity connectivity = build_connectivity(mesh.vertex_count(), mesh.faces);
  const std::vector<Loop> loops = find_loops(connectivity);
  if (loops.empty()) {
    const bool closed = std::none_of(connectivity.edges.begin(), connectivity.edges.end(),
                                     [](const Edge& edge) { return edge.f1 == kNone; });
    if (closed) turn_outwards(mesh, measure(mesh.rest_positions, mesh.faces).volume, name, notes);
    return mesh;
  }
  std::set<std::pair<std::uint32_t, std::uint32_t>> edges;
  for (const Edge& edge : connectivity.edges) edges.insert(std::minmax(edge.v0, edge.v1));
  Triangles lids;
  std::size_t corners = 0;
  for (const Loop& loop : loops) {
    const Triangles lid = cover(loop, mesh.rest_positions, edges);
    for (const auto& t : lid) {
      for (std::size_t k = 0; k < 3; ++k) edges.insert(std::minmax(t[k], t[(k + 1) % 3]));
    }
    lids.insert(lids.end(), lid.begin(), lid.end());
    corners += loop.size();
  }
  Topology closed = mesh;
  closed.uv.resize(0, 2);
  closed.uv_faces.resize(0, 3);
  closed.faces.conservativeResize(mesh.face_count() + static_cast<Eigen::Index>(lids.size()), 3);
  for (std::size_t i = 0; i < lids.size(); ++i) {
    for (int k = 0; k < 3; ++k)
      closed.faces(mesh.face_count() + static_cast<Eigen::Index>(i), k) = lids[i][static_cast<std::size_t>(k)];
  }
  const Measures m = measure(closed.rest_positions, closed.faces);
  if (std::abs(m.volume) < kEnclosesNothing * std::pow(m.area, 1.5)) {
    if (keep_vertices) return mesh;
    notes.push_back(name + ": is a sheet; it was made a slab that is thick behind it");
    return make_slab(mesh, connectivity);
  }
  notes.push_back(name + ": " + std::to_string(loops.size()) + (loops.size() == 1 ? " hole" : " holes") + " of " +
                  std::to_string(corners) + " edges in all " + (loops.size() == 1 ? "was" : "were") + " closed");
  turn_outwards(closed, m.volume, name, notes);
  return closed;
}

}  // namespace pleat
