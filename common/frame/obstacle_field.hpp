// The obstacles of one frame: distances, closest points outside, and which faces of the cloth reach in.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/bvh.hpp"
#include "common/mesh/closest_points8.hpp"
#include "common/mesh/connectivity.hpp"

namespace pleat {

/// The resolution below which a penetration is not one: about that of float positions at a few metres.
inline constexpr double kPenetrationTolerance = 1e-6;

/// Where a point is with respect to the nearest obstacle.
struct ObstacleContact {
  double distance;         ///< metres, negative inside
  Eigen::Vector3d normal;  ///< unit, outwards: point + (d - distance) normal is at distance d for small moves
};

/// Everything nearer than `radius` to the segment a-b. A sphere has a == b.
struct Capsule {
  Eigen::Vector3d a, b;
  double radius;
};

/// The contact of a point with a capsule, however far. On the axis, where every direction is as good, the normal is
/// perpendicular to the segment (for a sphere, up).
ObstacleContact capsule_contact(const Capsule& capsule, const Eigen::Vector3d& p);

/// The point of a triangle that is nearest to a capsule's axis: its barycentric coordinates, and the contact there.
struct TriangleContact {
  Eigen::Vector3d weights;
  ObstacleContact contact;
};
TriangleContact capsule_contact(const Capsule& capsule, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                const Eigen::Vector3d& c);

/// Whether a face reaches into a capsule by more than kPenetrationTolerance.
bool reaches_in(const Capsule& capsule, const Positions& positions, const Faces& faces, std::uint32_t face);

/// A closed triangle mesh as an obstacle. Signs come from angle-weighted normals at the closest feature (Baerentzen and
/// Aanaes 2005), which is exact for closed meshes. Results depend on the frame alone, not on earlier ones.
class MeshObstacle {
 public:
  /// Throws kInvalidArgument unless the faces are closed, manifold and consistently oriented.
  MeshObstacle(const Faces& faces, Eigen::Index vertex_count, const std::string& name);

  /// positions: (V x 3). O(F), and a tree at the first call.
  void update(const Positions& positions);
  const Box& bounds() const { return tree_.bounds(); }
  const Faces& faces() const { return faces_; }
  const Positions& positions() const { return positions_; }

  /// The contact of p if p is inside or nearer than `reach` to the surface. Finding out that a point deep inside or far
  /// away is one or the other costs a search for the nearest face.
  std::optional<ObstacleContact> contact(const Eigen::Vector3d& p, double reach) const;
  /// The contact of p if the surface is nearer than `reach` on either side: cheap where it is not. hint: a face that
  /// may be the nearest one, kNone if none is known; afterwards the one that was found. Right hints make the search
  /// cheaper, none of them makes another result.
  std::optional<ObstacleContact> contact_near(const Eigen::Vector3d& p, double reach, std::uint32_t& hint) const;

  /// Packs of eight faces, of which those with a face in the box are among those that are appended: for the searches
  /// below, around points and triangles that are next to each other.
  void find_packs(const Box& box, std::vector<std::uint32_t>& packs) const;
  /// contact_near() where find_packs() has been asked for a box that contains everything nearer than `reach` to p.
  std::optional<ObstacleContact> contact_near(const Eigen::Vector3d& p, double reach,
                                              std::span<const std::uint32_t> packs) const;
  /// intersects() where find_packs() has been asked for a box around the triangle.
  bool intersects(const std::array<Eigen::Vector3f, 3>& triangle, std::span<const std::uint32_t> packs) const;

  /// Whether a face of the obstacle intersects the triangle.
  bool intersects(const std::array<Eigen::Vector3f, 3>& triangle) const;
  /// The obstacle's vertices on faces that intersect the triangle, ascending, appended.
  void intersecting_vertices(const std::array<Eigen::Vector3f, 3>& triangle, std::vector<std::uint32_t>& out) const;
  /// Weighted by the angles of the faces; unit.
  Eigen::Vector3d vertex_normal(std::uint32_t vertex) const;

 private:
  static constexpr std::size_t kWidth = 8;
  // Faces side by side, one per lane; the last one again in lanes that are left over.
  struct Pack {
    std::array<Points8, 3> corners;
    Float8 error;  // rounding() of the corners
    std::array<std::uint32_t, kWidth> faces;
  };
  // The nearest point of the surface so far.
  struct Nearest {
    double squared;
    std::uint32_t face = kNone;
    Eigen::Vector3d weights = Eigen::Vector3d::Zero();
  };
  void build_packs();
  void consider(const Eigen::Vector3d& p, std::uint32_t face, Nearest& best) const;
  void consider_pack(const Eigen::Vector3d& p, const Pack& pack, Nearest& best) const;
  std::optional<ObstacleContact> contact_at(const Eigen::Vector3d& p, const Nearest& nearest) const;
  template <typename Visit>
  void visit_intersecting(const Pack& pack, const Box& box, const std::array<Eigen::Vector3f, 3>& triangle,
                          const Visit& visit) const;
  std::optional<ObstacleContact> nearest(const Eigen::Vector3d& p, double squared_reach, std::uint32_t& hint) const;
  Eigen::Vector3d face_normal(std::uint32_t face) const;

  Faces faces_;
  Connectivity connectivity_;
  Positions positions_;
  std::vector<Pack> packs_;  // in the tree's order
  Bvh tree_;                 // over packs
  std::vector<Box> boxes_;
};

/// All obstacles of a session. One per stream; not for several threads.
class ObstacleField {
 public:
  /// Throws kInvalidArgument for a name that is empty or twice there, or a mesh that is not closed and manifold.
  explicit ObstacleField(std::span<const ObstacleShape> shapes);
  ~ObstacleField();
  ObstacleField(ObstacleField&&) noexcept;
  ObstacleField& operator=(ObstacleField&&) noexcept;

  /// The obstacles of a frame; spheres and capsule sets need no shape. Throws kInvalidArgument for a mesh without shape
  /// or with another vertex count, a shape without frame, a radius that is not above 0, values that are not finite.
  void update(std::span<const ObstacleFrame> frames);

  bool empty() const;

  /// Appends boxes around each obstacle and everything nearer to it than `margin`: what is outside all of them is
  /// clean.
  void append_bounds(double margin, std::vector<Box>& boxes) const;

  /// The deepest contact of p among the obstacles that p is inside of or nearer to than `reach`.
  std::optional<ObstacleContact> contact(const Eigen::Vector3d& p, double reach) const;
  /// The same, but inside of meshes no deeper than `depth`: the less that is, the cheaper. For many points that are
  /// next to each other: a search begins where the last one ended.
  std::optional<ObstacleContact> contact_near(const Eigen::Vector3d& p, double reach, double depth);

  /// Whether a face reaches into an obstacle (see find_penetrations).
  bool penetrates(const Positions& positions, const Faces& faces, std::uint32_t face) const;

  /// All such faces, ascending.
  std::vector<std::uint32_t> find(const Positions& positions, const Faces& faces) const;

  /// Moves the corners of a face so that it leaves the obstacles that it reaches into, by half of `clearance` where
  /// that is known; returns whether it moved any.
  bool push_face_out(Positions& positions, const Faces& faces, std::uint32_t face, double clearance);

  struct Part;
  const std::vector<Part>& parts() const { return parts_; }

 private:
  Part& part_named(const std::string& name);

  std::vector<Part> parts_;
  std::vector<std::uint32_t> corners_;
};

/// One obstacle: capsules (a sphere is one), or a mesh.
struct ObstacleField::Part {
  std::string name;
  Faces faces;                         ///< of a mesh
  std::unique_ptr<MeshObstacle> mesh;  ///< made by the first frame, which tells the vertex count
  std::vector<Capsule> capsules;
  bool present = false;           ///< in this frame
  std::uint32_t nearest = kNone;  ///< face of the mesh that the last contact_near() found
};

}  // namespace pleat
