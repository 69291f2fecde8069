// The obstacles of one frame: distances, closest points outside, and which faces reach in.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/bvh.hpp"

namespace pleat {

/// The resolution below which a penetration is not one: about that of float positions at a few metres.
inline constexpr double kPenetrationTolerance = 1e-6;

/// Where a point is with respect to the nearest obstacle.
struct ObstacleContact {
  double distance;         ///< metres, negative inside
  Eigen::Vector3d normal;  ///< unit, outwards: point + (d - distance) normal is at distance d for small moves
};

/// A closed triangle mesh as an obstacle. Signs come from angle-weighted normals at the closest feature (Baerentzen and
/// Aanaes 2005), which is exact for closed meshes.
class MeshObstacle {
 public:
  /// Throws kInvalidArgument unless the faces are closed, manifold and consistently oriented.
  MeshObstacle(const Faces& faces, Eigen::Index vertex_count, const std::string& name);

  void update(const Positions& positions);
  const Box& bounds() const { return tree_.bounds(); }
  const Positions& positions() const { return positions_; }

  /// The contact of p if p is inside or nearer than `reach` to the surface.
  std::optional<ObstacleContact> contact(const Eigen::Vector3d& p, double reach) const;

  /// Whether a face of the obstacle intersects the triangle.
  bool intersects(const std::array<Eigen::Vector3f, 3>& triangle) const;
  /// The obstacle's vertices on faces that intersect the triangle, ascending.
  std::vector<std::uint32_t> intersecting_vertices(const std::array<Eigen::Vector3f, 3>& triangle) const;
  Eigen::Vector3d vertex_normal(std::uint32_t vertex) const { return vertex_normals_[vertex]; }

 private:
  template <typename Visit>
  void visit_intersecting(const std::array<Eigen::Vector3f, 3>& triangle, const Visit& visit) const;

  Faces faces_;
  std::vector<std::array<std::uint32_t, 3>> face_edges_;
  std::size_t edge_count_ = 0;
  Positions positions_;
  Bvh tree_;
  std::vector<Box> boxes_;
  std::vector<Eigen::Vector3d> face_normals_, edge_normals_, vertex_normals_;
};

/// All obstacles of a session. One per stream; not for several threads.
class ObstacleField {
 public:
  /// Throws kInvalidArgument for a name that is empty or twice there, or a mesh that is not closed and manifold.
  explicit ObstacleField(std::span<const ObstacleShape> shapes);
  ~ObstacleField();
  ObstacleField(ObstacleField&&) noexcept;
  ObstacleField& operator=(ObstacleField&&) noexcept;

  /// The obstacles of a frame; a sphere needs no shape. Throws kInvalidArgument for a mesh without shape or with
  /// another vertex count, a shape without frame, a negative radius, values that are not finite.
  void update(std::span<const ObstacleFrame> frames);

  bool empty() const;

  /// A box around each obstacle and everything nearer to it than `margin`: what is outside all of them is clean.
  std::vector<Box> bounds(double margin) const;

  /// The deepest contact of p among the obstacles that p is inside of or nearer to than `reach`.
  std::optional<ObstacleContact> contact(const Eigen::Vector3d& p, double reach) const;

  /// Whether a face reaches into an obstacle (see find_penetrations).
  bool penetrates(const Positions& positions, const Faces& faces, std::uint32_t face) const;

  /// All such faces, ascending.
  std::vector<std::uint32_t> find(const Positions& positions, const Faces& faces) const;

  /// Moves the corners of a face so that it leaves the obstacles that it reaches into, by `clearance` where that is
  /// known; returns whether it moved any.
  bool push_face_out(Positions& positions, const Faces& faces, std::uint32_t face, double clearance) const;

 private:
  struct Part;
  std::vector<Part> parts_;
};

}  // namespace pleat
