#include "common/mesh/connectivity.hpp"

#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#include <algorithm>
#include <numeric>
#include <unordered_map>

#include "common/base/error.hpp"

namespace pleat {
namespace {

using OpenTriMesh = OpenMesh::TriMesh_ArrayKernelT<>;

// OpenMesh's half-edge structure wants manifold vertices too (one fan of faces each). Garments may touch in a vertex,
// so that each fan gets its own OpenMesh vertex when the plain insertion is refused.
OpenTriMesh to_open_mesh(Eigen::Index vertex_count, const Faces& faces) {
  OpenTriMesh mesh;
  mesh.reserve(static_cast<std::size_t>(vertex_count), static_cast<std::size_t>(faces.rows()) * 2,
               static_cast<std::size_t>(faces.rows()));
  for (Eigen::Index v = 0; v < vertex_count; ++v) mesh.add_vertex(OpenTriMesh::Point(0, 0, 0));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const auto handle = [&](int k) { return mesh.vertex_handle(faces(f, k)); };
    if (!mesh.add_face(handle(0), handle(1), handle(2)).is_valid()) return {};
  }
  return mesh;
}

Connectivity from_open_mesh(const OpenTriMesh& mesh, const Faces& faces) {
  Connectivity c;
  c.face_edges.resize(static_cast<std::size_t>(faces.rows()));
  std::vector<std::uint32_t> index_of(mesh.n_edges(), kNone);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const auto from = mesh.vertex_handle(faces(f, k)), to = mesh.vertex_handle(faces(f, (k + 1) % 3));
      const auto half = mesh.find_halfedge(from, to);
      const auto edge = static_cast<std::size_t>(mesh.edge_handle(half).idx());
      if (index_of[edge] == kNone) {
        index_of[edge] = static_cast<std::uint32_t>(c.edges.size());
        Edge e{faces(f, k), faces(f, (k + 1) % 3), static_cast<std::uint32_t>(f), kNone, faces(f, (k + 2) % 3), kNone};
        const auto twin = mesh.opposite_halfedge_handle(half);
        if (!mesh.is_boundary(twin)) {
          e.f1 = static_cast<std::uint32_t>(mesh.face_handle(twin).idx());
          e.opposite1 = static_cast<std::uint32_t>(mesh.to_vertex_handle(mesh.next_halfedge_handle(twin)).idx());
        }
        c.edges.push_back(e);
      }
      c.face_edges[static_cast<std::size_t>(f)][static_cast<std::size_t>(k)] = index_of[edge];
    }
  }
  return c;
}

// For meshes whose vertices are not manifold: the same answer by hashing.
Connectivity from_hash(const Faces& faces) {
  Connectivity c;
  c.face_edges.resize(static_cast<std::size_t>(faces.rows()));
  std::unordered_map<std::uint64_t, std::uint32_t> index_of;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = faces(f, k), b = faces(f, (k + 1) % 3), opposite = faces(f, (k + 2) % 3);
      const std::uint64_t key = (static_cast<std::uint64_t>(std::min(a, b)) << 32) | std::max(a, b);
      const auto [it, inserted] = index_of.try_emplace(key, static_cast<std::uint32_t>(c.edges.size()));
      if (inserted) {
        c.edges.push_back({a, b, static_cast<std::uint32_t>(f), kNone, opposite, kNone});
      } else {
        Edge& e = c.edges[it->second];
        if (e.f1 != kNone)
          throw_invalid_argument("edge " + std::to_string(a) + "-" + std::to_string(b) + " has more than two faces");
        e.f1 = static_cast<std::uint32_t>(f);
        e.opposite1 = opposite;
      }
      c.face_edges[static_cast<std::size_t>(f)][static_cast<std::size_t>(k)] = it->second;
    }
  }
  return c;
}

}  // namespace

Connectivity build_connectivity(Eigen::Index vertex_count, const Faces& faces) {
  const OpenTriMesh mesh = to_open_mesh(vertex_count, faces);
  Connectivity c =
      mesh.n_faces() == static_cast<std::size_t>(faces.rows()) ? from_open_mesh(mesh, faces) : from_hash(faces);

  c.vertex_face_offsets.assign(static_cast<std::size_t>(vertex_count) + 1, 0);
  for (Eigen::Index i = 0; i < faces.size(); ++i) ++c.vertex_face_offsets[faces.data()[i] + 1];
  std::partial_sum(c.vertex_face_offsets.begin(), c.vertex_face_offsets.end(), c.vertex_face_offsets.begin());
  c.vertex_faces.resize(static_cast<std::size_t>(faces.size()));
  std::vector<std::uint32_t> next(c.vertex_face_offsets.begin(), c.vertex_face_offsets.end() - 1);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) c.vertex_faces[next[faces(f, k)]++] = static_cast<std::uint32_t>(f);
  }
  return c;
}

double mean_edge_length(const Topology& topology) {
  double sum = 0;
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      sum += static_cast<double>((topology.rest_positions.row(topology.faces(f, k)) -
                                  topology.rest_positions.row(topology.faces(f, (k + 1) % 3)))
                                     .norm());
    }
  }
  return topology.face_count() == 0 ? 0 : sum / static_cast<double>(3 * topology.face_count());
}

int count_components(Eigen::Index vertex_count, const Faces& faces) {
  std::vector<std::uint32_t> parent(static_cast<std::size_t>(vertex_count));
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&parent](std::uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  std::vector<bool> used(parent.size(), false);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      used[faces(f, k)] = true;
      parent[root(faces(f, k))] = root(faces(f, 0));
    }
  }
  int components = 0;
  for (std::uint32_t v = 0; v < parent.size(); ++v) components += used[v] && root(v) == v;
  return components;
}

}  // namespace pleat
