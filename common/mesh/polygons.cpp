#include "common/mesh/polygons.hpp"

#include <algorithm>

#include "common/base/error.hpp"
#include "common/base/limits.hpp"
#include "common/mesh/triangulate.hpp"

namespace pleat {
namespace {

using Corner = PolygonMesh::Corner;

std::string place(const PolygonMesh& mesh, std::size_t polygon, const std::string& name) {
  return name + ":" + std::to_string(mesh.places[polygon]) + ": ";
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

/// Files that have a material coordinate for each corner leave no two faces together: what a vertex has several times,
/// but for rounding, becomes one. A mesh without such stays as it is.
void weld_uv(Topology& t) {
  constexpr float kRounding = 1e-5F;  // of the extent
  constexpr int kMostPlaces = 16;     // of one vertex; a pole may have one for each face
  if ((t.uv_faces.array() >= static_cast<std::uint32_t>(t.uv.rows())).any() ||
      (t.faces.array() >= static_cast<std::uint32_t>(t.vertex_count())).any())
    return;  // validate_topology says so
  const float same = kRounding * (t.uv.colwise().maxCoeff() - t.uv.colwise().minCoeff()).maxCoeff();
  struct Place {
    std::uint32_t uv, next;
  };
  std::vector<Place> places;
  std::vector<std::uint32_t> first(static_cast<std::size_t>(t.vertex_count()), PolygonMesh::kNoUv);
  Faces welded = t.uv_faces;
  for (Eigen::Index i = 0; i < welded.size(); ++i) {
    std::uint32_t& uv = welded.data()[i];
    std::uint32_t* end = &first[t.faces.data()[i]];
    int seen = 0;
    while (*end != PolygonMesh::kNoUv && seen++ < kMostPlaces &&
           !((t.uv.row(places[*end].uv) - t.uv.row(uv)).cwiseAbs().maxCoeff() <= same))
      end = &places[*end].next;
    if (seen > kMostPlaces) continue;
    if (*end != PolygonMesh::kNoUv) {
      uv = places[*end].uv;
    } else {
      *end = static_cast<std::uint32_t>(places.size());
      places.push_back({uv, PolygonMesh::kNoUv});
    }
  }
  if (welded == t.uv_faces) return;
  // What nobody names any more goes.
  std::vector<std::uint32_t> number(static_cast<std::size_t>(t.uv.rows()), PolygonMesh::kNoUv);
  for (const std::uint32_t uv : welded.reshaped()) number[uv] = 0;
  Eigen::Index count = 0;
  for (Eigen::Index u = 0; u < t.uv.rows(); ++u) {
    if (number[static_cast<std::size_t>(u)] == PolygonMesh::kNoUv) continue;
    number[static_cast<std::size_t>(u)] = static_cast<std::uint32_t>(count);
    t.uv.row(count++) = t.uv.row(u);
  }
  t.uv.conservativeResize(count, Eigen::NoChange);
  t.uv_faces = welded.unaryExpr([&](std::uint32_t uv) { return number[uv]; });
}

}  // namespace

void append_faces(PolygonMesh& mesh, const FaceList& list, std::size_t first) {
  const auto fail = [&](const std::string& message) {
    throw_invalid_argument(list.file + ": " + list.mesh + ": " + message);
  };
  if (mesh.corners.size() + list.vertices.size() > 4 * kMaxFaces)
    throw Error(ErrorCode::kResourceExhausted, list.file + ": too many faces");
  if (list.uv.empty() && mesh.without_uv.empty()) mesh.without_uv = list.mesh;
  const auto uv_base = static_cast<std::uint32_t>(mesh.uv.size() / 2);
  std::size_t at = 0;
  std::vector<Corner> face;
  for (std::size_t f = 0; f < list.sizes.size(); ++f) {
    const std::uint32_t size = list.sizes[f];
    if (size < 3 || size > list.vertices.size() - at)
      fail("face " + std::to_string(f) + " has " + std::to_string(size) + " corners");
    face.clear();
    for (std::uint32_t k = 0; k < size; ++k, ++at) {
      const std::uint32_t vertex = list.vertices[at];
      if (vertex >= list.vertex_count)
        fail("a face names point " + std::to_string(vertex) + " of " + std::to_string(list.vertex_count));
      Corner corner{static_cast<std::uint32_t>(first + vertex), PolygonMesh::kNoUv};
      if (!list.uv.empty()) {
        const std::size_t place = list.uv_by_vertex ? vertex : at;
        if (!list.uv_indices.empty() && place >= list.uv_indices.size())
          fail("its material coordinates have too few indices");
        const std::size_t index = list.uv_indices.empty() ? place : list.uv_indices[place];
        if (2 * index + 1 >= list.uv.size()) fail("it has no material coordinate " + std::to_string(index));
        corner.uv = uv_base + static_cast<std::uint32_t>(index);
      }
      if (face.empty() || face.back().vertex != corner.vertex) face.push_back(corner);
    }
    if (face.size() > 1 && face.front().vertex == face.back().vertex) face.pop_back();
    if (face.size() < 3) fail("face " + std::to_string(f) + " has fewer than 3 different corners");
    if (list.clockwise) std::reverse(face.begin(), face.end());
    mesh.corners.insert(mesh.corners.end(), face.begin(), face.end());
    mesh.ends.push_back(mesh.corners.size());
    mesh.places.push_back(static_cast<std::uint32_t>(f));
  }
  if (at != list.vertices.size())
    fail("its faces have " + std::to_string(list.vertices.size()) + " corners, not " + std::to_string(at));
  mesh.uv.insert(mesh.uv.end(), list.uv.begin(), list.uv.end());
}

std::vector<Corner> triangle_corners(const PolygonMesh& mesh, const std::string& name) {
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

Topology to_topology(PolygonMesh mesh, const std::string& name, MeshUse use) {
  const auto has_uv = [](const Corner& corner) { return corner.uv != PolygonMesh::kNoUv; };
  const bool with_uv = use == MeshUse::kGarment && std::any_of(mesh.corners.begin(), mesh.corners.end(), has_uv);
  if (with_uv && !mesh.without_uv.empty()) {
    throw_invalid_argument(
        name + ": some face corners have material coordinates (`vt`) and some do not, the first at " + mesh.without_uv);
  }
  const std::vector<Corner> corners = triangle_corners(mesh, name);
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
  if (with_uv) weld_uv(t);
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
