// Notices handles that would tear the cloth.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "services/simulation/scene.hpp"
#include "services/simulation/strain_limits.hpp"

namespace pleat::simulation {

/// Watches the faces at the handles' vertices of a garment: where a handle pulls, they stretch first and most.
class HandleWatch {
 public:
  HandleWatch(const Topology& garment, const Scene& scene);

  /// A line about the worst of the handles that are active at the time if the largest principal stretch of a face at it
  /// is beyond the scene's handle_stretch_warning; once only. positions: of the garment's vertices.
  std::optional<std::string> check(std::span<const Eigen::Vector3d> positions, double time_s);

 private:
  struct Face {
    std::uint32_t index;
    std::array<std::uint32_t, 3> v;
    ShapeGradients gradients;
  };
  struct Watched {
    std::string name;
    double start_s, end_s;
    std::vector<Face> faces;
  };
  std::vector<Watched> handles_;
  double limit_;
};

}  // namespace pleat::simulation
