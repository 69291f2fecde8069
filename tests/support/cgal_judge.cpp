#include "tests/support/cgal_judge.hpp"

#include <CGAL/Exact_predicates_exact_constructions_kernel.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/self_intersections.h>
#include <CGAL/Side_of_triangle_mesh.h>
#include <CGAL/Surface_mesh.h>

#include <stdexcept>
#include <utility>
#include <vector>

namespace pleat::test {
namespace {

using Predicates = CGAL::Exact_predicates_inexact_constructions_kernel;
using Exact = CGAL::Exact_predicates_exact_constructions_kernel;
using Mesh = CGAL::Surface_mesh<Predicates::Point_3>;

template <typename Kernel>
typename Kernel::Point_3 point(const Positions& x, Eigen::Index v) {
  return {static_cast<double>(x(v, 0)), static_cast<double>(x(v, 1)), static_cast<double>(x(v, 2))};
}

// Appends a mesh; its faces get the next indices, in order.
void append(Mesh& mesh, const Positions& x, const Faces& faces) {
  std::vector<Mesh::Vertex_index> vertices;
  for (Eigen::Index v = 0; v < x.rows(); ++v) vertices.push_back(mesh.add_vertex(point<Predicates>(x, v)));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const auto added = mesh.add_face(vertices[faces(f, 0)], vertices[faces(f, 1)], vertices[faces(f, 2)]);
    if (added == Mesh::null_face()) throw std::invalid_argument("the judge needs manifold meshes");
  }
}

// The faces of the cloth that come nearer to a segment (two rows of `ends`) than the radius: exact distances, of the
// faces near it only.
template <typename Found>
void judge_capsule(const Positions& x, const Faces& faces, const Positions& ends, float radius, const Found& found) {
  const Eigen::RowVector3f margin = Eigen::RowVector3f::Constant(1.01f * radius);
  const Eigen::RowVector3f lowest = ends.colwise().minCoeff() - margin, highest = ends.colwise().maxCoeff() + margin;
  const Exact::Point_3 p = point<Exact>(ends, 0), q = point<Exact>(ends, 1);
  const Exact::FT square = Exact::FT(static_cast<double>(radius)) * Exact::FT(static_cast<double>(radius));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Eigen::RowVector3f a = x.row(faces(f, 0)), b = x.row(faces(f, 1)), c = x.row(faces(f, 2));
    const Eigen::RowVector3f low = a.cwiseMin(b).cwiseMin(c), high = a.cwiseMax(b).cwiseMax(c);
    if ((low.array() > highest.array()).any() || (high.array() < lowest.array()).any()) continue;
    const Exact::Triangle_3 triangle(point<Exact>(x, faces(f, 0)), point<Exact>(x, faces(f, 1)),
                                     point<Exact>(x, faces(f, 2)));
    bool inside = CGAL::squared_distance(p, triangle) < square;
    if (!inside && p != q) {
      const Exact::Segment_3 axis(p, q);
      inside = CGAL::squared_distance(q, triangle) < square || CGAL::do_intersect(axis, triangle);
      for (int k = 0; k < 3 && !inside; ++k) {
        inside = CGAL::squared_distance(axis, Exact::Segment_3(triangle[k], triangle[k + 1])) < square;
      }
    }
    if (inside) found(f);
  }
}

}  // namespace

Judgement judge(const Positions& cloth, const Faces& faces, std::span<const ObstacleShape> shapes,
                std::span<const ObstacleFrame> obstacles) {
  Judgement result;
  const auto note = [&](std::size_t& count, const std::string& what) {
    ++count;
    if (result.first.empty()) result.first = what;
  };
  const auto name = [](Eigen::Index f) { return "face " + std::to_string(f); };

  Mesh mesh;
  append(mesh, cloth, faces);
  const auto cloth_faces = static_cast<Eigen::Index>(mesh.number_of_faces());
  for (std::size_t o = 0; o < obstacles.size(); ++o) {
    if (obstacles[o].positions.rows() > 0) append(mesh, obstacles[o].positions, shapes[o].faces);
  }
  std::vector<std::pair<Mesh::Face_index, Mesh::Face_index>> pairs;
  CGAL::Polygon_mesh_processing::self_intersections(mesh, std::back_inserter(pairs));
  for (const auto& [a, b] : pairs) {
    const auto f = static_cast<Eigen::Index>(std::min(a, b)), g = static_cast<Eigen::Index>(std::max(a, b));
    if (f >= cloth_faces) continue;
    if (g < cloth_faces) {
      note(result.self_intersections, name(f) + " and " + name(g));
    } else {
      note(result.penetrations, name(f) + " cuts an obstacle mesh");
    }
  }

  for (std::size_t o = 0; o < obstacles.size(); ++o) {
    const ObstacleFrame& frame = obstacles[o];
    const auto reaches_in = [&](Eigen::Index f) { note(result.penetrations, name(f) + " is in '" + frame.name + "'"); };
    if (frame.radius > 0) {
      judge_capsule(cloth, faces, frame.center.transpose().replicate<2, 1>(), frame.radius, reaches_in);
    }
    for (std::size_t c = 0; c < frame.capsule_radii.size(); ++c) {
      const Positions ends = frame.capsule_ends.middleRows(2 * static_cast<Eigen::Index>(c), 2);
      judge_capsule(cloth, faces, ends, frame.capsule_radii[c], reaches_in);
    }
    if (frame.positions.rows() == 0) continue;
    Mesh obstacle;
    append(obstacle, frame.positions, shapes[o].faces);
    const CGAL::Side_of_triangle_mesh<Mesh, Predicates> side(obstacle);
    for (Eigen::Index v = 0; v < cloth.rows(); ++v) {
      if (side(point<Predicates>(cloth, v)) != CGAL::ON_UNBOUNDED_SIDE)
        note(result.penetrations, "vertex " + std::to_string(v) + " is in '" + frame.name + "'");
    }
  }
  return result;
}

}  // namespace pleat::test
