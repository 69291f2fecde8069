// Notices handles that would tear the cloth, or can't go where their script takes them.
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

  /// A line about a hard handle that lags behind its script by more than a millimetre; once only.
  std::optional<std::string> check_lag(std::size_t handle, double lag_m, double time_s);

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
  std::vector<std::string> names_;
  bool lag_told_ = false;
};

}  // namespace pleat::simulation
