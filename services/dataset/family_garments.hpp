// The garments of the set FAMILY. Internal to this room.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/dataset/random.hpp"

namespace pleat::dataset {

struct FamilyGarment {
  Topology mesh;      ///< flat in x and z with its faces up, or a ring around the y axis, faces outwards
  bool ring = false;  ///< a tube or a skirt, of one or more panels
  std::string shape;  ///< "rectangle", "ellipse", ..., "tube", "skirt", and the pattern of the triangles: for people
  double edge = 0;    ///< metres, what its edges were wanted to be
  /// Vertices of the borders in their order around the cloth: of flat ones the outline, of rings the upper and the
  /// lower rim.
  std::vector<std::vector<std::uint32_t>> borders;
};

/// How many kinds of garments there are; the kind of garment i is i modulo that.
inline constexpr std::size_t kFamilyKinds = 12;

/// A garment of a kind: flat outlines (rectangles up to three times as long as wide, ellipses, polygons, flowers,
/// L-shapes, trapezoids, half discs), tubes, skirts of up to a full circle and more, in one to four panels with seams.
/// 120 to 450 vertices, edges of 15 to 60 mm, regular and irregular triangles, the grain in any direction (or straight,
/// in a third of them). Deterministic for the state of `random`. Material coordinates are metres; panels lie side by
/// side.
FamilyGarment family_garment(std::size_t kind, Random& random);

}  // namespace pleat::dataset
