#include "common/mesh/polygons.hpp"

#include <algorithm>
#include <span>

#include "common/base/error.hpp"
#include "common/mesh/triangulate.hpp"

namespace pleat {
namespace {

using Corner = PolygonMesh::Corner;

std::string place(const PolygonMesh& mesh, std::size_t polygon, const std::string& name) {
  return name + ":" + std::to_string(mesh.places[polygon]) + ": ";
}

/// The corners of all polygons' triangles.
std::vector<Corner> cut_polygons(const PolygonMesh& mesh, const std::string& name) {
  const std::size_t vertices = mesh.positions.size() / 3;
  std::vector<Corner> corners;
  std::vector<Eigen::Vector3f> points;
  std::size_t begin = 0;
  for (std::size_t p = 0; p < mesh.ends.size(); begin = mesh.ends[p++]) {
    const std::span<const Corner> polygon(mesh.corners.data() + begin, mesh.ends[p] - begin);
    if (polygon.size() == 3) {
      corners.insert(corners.end(), polygon.begin(), polygon.end());
      continue;
    }
    points.clear();
    for (const Corner& corner : polygon) {
      if (corner.vertex >= vertices) {
        throw_invalid_argument(place(mesh, p, name) + "a face names index " + std::to_string(corner.vertex) +
                               ", but there are " + std::to_string(vertices) + " vertices");
      }
      points.emplace_back(mesh.positions.data() + 3 * std::size_t{corner.vertex});
    }
    const auto triangles = triangulate(points);
    if (!triangles) {
      throw_invalid_argument(place(mesh, p, name) + "the polygon of " + std::to_string(polygon.size()) +
                             " corners crosses itself");
    }
    for (const auto& triangle : *triangles) {
      for (const std::uint32_t k : triangle) corners.push_back(polygon[k]);
    }
  }
  return corners;
}

/// Whether the polygon's corners are those of the triangles [first, first + n - 2).
bool covers(std::span<const Corner> polygon, const Faces& triangles, Eigen::Index first) {
  const auto count = static_cast<Eigen::Index>(polygon.size()) - 2;
  if (count > triangles.rows() - first) return false;
  if (count == 1) {
    // Any of the three corners may come first.
    for (std::size_t shift = 0; shift < 3; ++shift) {
      bool equal = true;
      for (std::size_t k = 0; k < 3; ++k) {
        equal = equal && polygon[(k + shift) % 3].vertex == triangles(first, static_cast<Eigen::Index>(k));
      }
      if (equal) return true;
    }
    return false;
  }
  std::vector<std::uint32_t> left, right;
  for (const Corner& corner : polygon) left.push_back(corner.vertex);
  for (Eigen::Index f = first; f < first + count; ++f) {
    for (int k = 0; k < 3; ++k) right.push_back(triangles(f, k));
  }
  for (auto* list : {&left, &right}) {
    std::sort(list->begin(), list->end());
    list->erase(std::unique(list->begin(), list->end()), list->end());
  }
  return left == right;
}

}  // namespace

Topology to_topology(PolygonMesh mesh, const std::string& name, MeshUse use) {
  const auto has_uv = [](const Corner& corner) { return corner.uv != PolygonMesh::kNoUv; };
  const bool with_uv = use == MeshUse::kGarment && std::any_of(mesh.corners.begin(), mesh.corners.end(), has_uv);
  if (with_uv && !mesh.without_uv.empty()) {
    throw_invalid_argument(
        name + ": some face corners have material coordinates (`vt`) and some do not, the first at " + mesh.without_uv);
  }
  const std::vector<Corner> corners = cut_polygons(mesh, name);
  Topology t;
  const auto faces = static_cast<Eigen::Index>(corners.size() / 3);
  t.rest_positions =
      Eigen::Map<Positions>(mesh.positions.data(), static_cast<Eigen::Index>(mesh.positions.size() / 3), 3);
  t.faces.resize(faces, 3);
  if (with_uv) {
    t.uv = Eigen::Map<Uv>(mesh.uv.data(), static_cast<Eigen::Index>(mesh.uv.size() / 2), 2);
    t.uv_faces.resize(faces, 3);
  }
  for (std::size_t i = 0; i < corners.size(); ++i) {
    t.faces.data()[i] = corners[i].vertex;
    if (with_uv) t.uv_faces.data()[i] = corners[i].uv;
  }
  validate_topology(t, name);
  return t;
}

Positions to_frame(const PolygonMesh& mesh, const Topology& rest, const std::string& name) {
  const auto vertices = static_cast<Eigen::Index>(mesh.positions.size() / 3);
  if (vertices != rest.vertex_count()) {
    throw_invalid_argument(name + " has " + std::to_string(vertices) + " vertices, the rest mesh " +
                           std::to_string(rest.vertex_count()));
  }
  std::size_t begin = 0;
  Eigen::Index face = 0;
  for (std::size_t p = 0; p < mesh.ends.size(); begin = mesh.ends[p++]) {
    const std::span<const Corner> polygon(mesh.corners.data() + begin, mesh.ends[p] - begin);
    if (!covers(polygon, rest.faces, face)) {
      throw_invalid_argument(place(mesh, p, name) + "its faces are not those of the rest mesh");
    }
    face += static_cast<Eigen::Index>(polygon.size()) - 2;
  }
  if (face != rest.face_count()) throw_invalid_argument(name + ": its faces are not those of the rest mesh");
  return Eigen::Map<const Positions>(mesh.positions.data(), vertices, 3);
}

}  // namespace pleat
