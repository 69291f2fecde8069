#include "services/simulation/handle_watch.hpp"

#include <cstdio>

namespace pleat::simulation {
namespace {

std::string short_number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

}  // namespace

HandleWatch::HandleWatch(const Topology& garment, const Scene& scene) : limit_(scene.handle_stretch_warning) {
  std::vector<char> handled(static_cast<std::size_t>(garment.vertex_count()));
  for (std::size_t h = 0; h < scene.handles.size(); ++h) {
    const Handle& handle = scene.handles[h];
    names_.push_back("handle " + (handle.name.empty() ? std::to_string(h) : "'" + handle.name + "'"));
    Watched watched{names_.back(), handle.start_s, handle.end_s, {}};
    handled.assign(handled.size(), 0);
    for (const std::uint32_t v : handle.vertices) handled[v] = 1;
    for (Eigen::Index f = 0; f < garment.face_count(); ++f) {
      const std::array<std::uint32_t, 3> v{garment.faces(f, 0), garment.faces(f, 1), garment.faces(f, 2)};
      if (!handled[v[0]] && !handled[v[1]] && !handled[v[2]]) continue;
      watched.faces.push_back({static_cast<std::uint32_t>(f), v, shape_gradients(garment, f)});
    }
    handles_.push_back(std::move(watched));
  }
}

std::optional<std::string> HandleWatch::check(std::span<const Eigen::Vector3d> positions, double time_s) {
  double worst = limit_;
  const Watched* worst_handle = nullptr;
  std::uint32_t worst_face = 0;
  for (const Watched& handle : handles_) {
    if (time_s < handle.start_s || time_s >= handle.end_s) continue;
    for (const Face& face : handle.faces) {
      Eigen::Matrix3d corners;
      for (int k = 0; k < 3; ++k) corners.col(k) = positions[face.v[static_cast<std::size_t>(k)]];
      const double stretch = principal_stretches(face.gradients, corners).stretch[0];
      if (stretch <= worst) continue;
      worst = stretch;
      worst_handle = &handle;
      worst_face = face.index;
    }
  }
  if (worst_handle == nullptr) return std::nullopt;
  std::string warning = worst_handle->name + " stretches the cloth to " + short_number(worst) +
                        " times its rest length at " + short_number(time_s) + " s (face " + std::to_string(worst_face) +
                        "); beyond " + short_number(limit_) + " real cloth may tear";
  handles_.clear();
  return warning;
}

std::optional<std::string> HandleWatch::check_lag(std::size_t handle, double lag_m, double time_s) {
  if (lag_told_ || lag_m < 1e-3) return std::nullopt;
  lag_told_ = true;
  return names_[handle] + " can't follow its script: something stands in its way (" + short_number(1e3 * lag_m) +
         " mm behind at " + short_number(time_s) + " s)";
}

}  // namespace pleat::simulation
