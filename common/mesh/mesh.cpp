#include "common/mesh/mesh.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <span>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3f;

std::string edge_name(std::uint32_t a, std::uint32_t b) { return std::to_string(a) + "-" + std::to_string(b); }

void check_faces(const Faces& faces, Eigen::Index limit, const std::string& what) {
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) {
      if (faces(f, c) >= limit) {
        throw_invalid_argument(what + ": face " + std::to_string(f) + " names index " + std::to_string(faces(f, c)) +
                               ", but there are " + std::to_string(limit));
      }
    }
  }
}

struct HalfEdge {
  std::uint64_t key;  // smaller vertex << 32 | larger vertex
  std::uint32_t face;
  bool forward;
};

double signed_uv_area(const Topology& t, Eigen::Index f) {
  const Eigen::Vector2d a = t.uv.row(t.uv_faces(f, 0)).cast<double>();
  const Eigen::Vector2d b = t.uv.row(t.uv_faces(f, 1)).cast<double>();
  const Eigen::Vector2d c = t.uv.row(t.uv_faces(f, 2)).cast<double>();
  const Eigen::Vector2d u = b - a, v = c - a;
  return 0.5 * (u.x() * v.y() - u.y() * v.x());
}

}  // namespace

Positions vertex_normals(const Positions& positions, const Faces& faces) {
  Positions normals;
  vertex_normals(positions, faces, normals);
  return normals;
}

void vertex_normals(const Positions& positions, const Faces& faces, Positions& normals) {
  normals.setZero(positions.rows(), 3);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Vec3 a = positions.row(faces(f, 0));
    const Vec3 b = positions.row(faces(f, 1));
    const Vec3 c = positions.row(faces(f, 2));
    const Vec3 doubled_area_normal = (b - a).cross(c - a);
    for (int k = 0; k < 3; ++k) normals.row(faces(f, k)) += doubled_area_normal.transpose();
  }
  for (Eigen::Index v = 0; v < normals.rows(); ++v) {
    const float length = normals.row(v).norm();
    if (length > std::numeric_limits<float>::min()) {
      normals.row(v) /= length;
    } else {
      normals.row(v) << 0, 1, 0;
    }
  }
}

void validate_topology(const Topology& t, const std::string& name) {
  if (t.vertex_count() == 0 || t.face_count() == 0)
    throw_invalid_argument(name + ": the mesh has no vertices or no faces");
  for (Eigen::Index v = 0; v < t.vertex_count(); ++v) {
    if (!t.rest_positions.row(v).allFinite()) {
      throw_invalid_argument(name + ": rest position of vertex " + std::to_string(v) + " is not finite");
    }
  }
  for (Eigen::Index u = 0; u < t.uv.rows(); ++u) {
    if (!t.uv.row(u).allFinite())
      throw_invalid_argument(name + ": material coordinate " + std::to_string(u) + " is not finite");
  }
  if (t.uv_faces.rows() != 0 && t.uv_faces.rows() != t.face_count()) {
    throw_invalid_argument(name + ": " + std::to_string(t.face_count()) + " faces, but " +
                           std::to_string(t.uv_faces.rows()) + " faces of material coordinates");
  }
  if ((t.uv.rows() == 0) != (t.uv_faces.rows() == 0))
    throw_invalid_argument(name + ": material coordinates without faces, or faces without them");
  check_faces(t.faces, t.vertex_count(), name);
  check_faces(t.uv_faces, t.uv.rows(), name + ", material coordinates");

  std::vector<HalfEdge> half_edges;
  half_edges.reserve(static_cast<std::size_t>(t.face_count()) * 3);
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = t.faces(f, k), b = t.faces(f, (k + 1) % 3);
      if (a == b) throw_invalid_argument(name + ": face " + std::to_string(f) + " repeats vertex " + std::to_string(a));
      half_edges.push_back(
          {(static_cast<std::uint64_t>(std::min(a, b)) << 32) | std::max(a, b), static_cast<std::uint32_t>(f), a < b});
    }
  }
  std::stable_sort(half_edges.begin(), half_edges.end(),
                   [](const HalfEdge& x, const HalfEdge& y) { return x.key < y.key; });
  for (std::size_t i = 0; i < half_edges.size();) {
    std::size_t j = i;
    while (j < half_edges.size() && half_edges[j].key == half_edges[i].key) ++j;
    const auto a = static_cast<std::uint32_t>(half_edges[i].key >> 32),
               b = static_cast<std::uint32_t>(half_edges[i].key);
    if (j - i > 2) {
      throw_invalid_argument(name + ": edge " + edge_name(a, b) + " is not manifold (" + std::to_string(j - i) +
                             " faces)");
    }
    if (j - i == 2 && half_edges[i].forward == half_edges[i + 1].forward) {
      throw_invalid_argument(name + ": faces " + std::to_string(half_edges[i].face) + " and " +
                             std::to_string(half_edges[i + 1].face) + " at edge " + edge_name(a, b) +
                             " are oriented differently");
    }
    i = j;
  }
}

void validate_material_coordinates(const Topology& t, const std::string& name) {
  if (t.uv_faces.rows() == 0) throw_invalid_argument(name + ": no material coordinates (`vt` in OBJ); they are needed");
  double total = 0;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) total += std::abs(signed_uv_area(t, f));
  const double smallest = 1e-6 * total / static_cast<double>(t.face_count());
  Eigen::Index first_negative = -1, first_positive = -1;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const double area = signed_uv_area(t, f);
    if (std::abs(area) <= smallest) {
      throw_invalid_argument(name + ": face " + std::to_string(f) + " has no area in material coordinates");
    }
    (area > 0 ? first_positive : first_negative) = f;
    if (first_negative >= 0 && first_positive >= 0) {
      throw_invalid_argument(name + ": material coordinates are folded: faces " + std::to_string(first_positive) +
                             " and " + std::to_string(first_negative) + " have opposite orientation");
    }
  }
  if (first_negative >= 0) {
    throw_invalid_argument(name + ": material coordinates are mirrored (all faces are clockwise in them)");
  }
}

std::string topology_hash(const Topology& t) {
  Hash hash;
  const auto add_matrix = [&hash](const auto& m) {
    const std::uint64_t rows = static_cast<std::uint64_t>(m.rows());
    hash.add(std::as_bytes(std::span(&rows, 1)));
    hash.add(std::as_bytes(std::span(m.data(), static_cast<std::size_t>(m.size()))));
  };
  add_matrix(t.faces);
  add_matrix(t.uv_faces);
  add_matrix(t.rest_positions);
  add_matrix(t.uv);
  return hash.hex();
}

}  // namespace pleat
