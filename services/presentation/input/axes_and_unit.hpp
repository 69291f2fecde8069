// Files in another unit or with another axis up than ours.
#pragma once

#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

struct AxesAndUnit {
  double scale = 1;   ///< metres per unit
  bool z_up = false;  ///< (x, y, z) is (x, z, -y) with Y up

  /// In metres, Y up.
  Positions operator()(Positions positions) const {
    if (scale != 1) positions *= static_cast<float>(scale);
    if (z_up) {
      positions.col(1).swap(positions.col(2));
      positions.col(2) *= -1;
    }
    return positions;
  }
};

}  // namespace pleat::presentation
