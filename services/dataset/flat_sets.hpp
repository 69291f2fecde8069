// Scenes of the sets SHEET and DISK ([DT-S]): a free fine simulation beside the coarse one. Internal to this room.
#pragma once

#include "services/dataset/random.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::dataset {

/// A square sheet, held by two corners of its upper edge: it hangs (even sequences) or starts level and falls; a ball
/// or a pole of one of three sizes goes back and forth through it, at 0.3 to 1 m/s and up to 0.15 m beside its middle.
/// It starts with bumps of 2 cm. index: counted over all sequences; which shape, size and start it has follows from it,
/// the rest from `random`.
simulation::Scene sheet_scene(const Topology& cloth, double duration_s, std::size_t index, Random& random);

/// A round cloth on an upright cylinder (radius 0.3 m, height 0.7 m), held within 0.2 m of its middle, in wind of 1 to
/// 8 m/s from anywhere. The speeds of any first few sequences cover that range.
simulation::Scene disk_scene(const Topology& cloth, std::size_t index, Random& random);

/// An upright cylinder of 48 sides on y = 0, radius 0.3 m, height 0.7 m, normals outwards.
Topology cylinder();

/// A box about the origin, its sides' lengths in metres, normals outwards.
Topology box(const Eigen::Vector3d& sides);

}  // namespace pleat::dataset
