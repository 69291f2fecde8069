// The rotation about the vertical axis that cloth under gravity does not care for.
#pragma once

#include "common/mesh/mesh.hpp"

namespace pleat::conversion {

/// The angle about Y (radians) that turns the rest positions nearest to these ones:
/// atan2(sum a_z b_x - a_x b_z, sum a_x b_x + a_z b_z), a and b the positions about their centroids; the one nearest to
/// `previous`, so that it grows on through whole turns. `previous` itself where the positions have no heading: that
/// vector is shorter than a tenth of sum a_x^2 + a_z^2. Both: (V x 3).
float heading(const Positions& rest_positions, const Positions& positions, float previous);

/// The mean of the positions; zero for none.
Eigen::Vector3f centroid(const Positions& positions);

}  // namespace pleat::conversion
