// A stream's work, message by message: what the service does between the streams and the library.
#pragma once

#include <cstdint>
#include <memory>

#include "pleat/v1/conversion.pb.h"
#include "services/conversion/image_map.hpp"
#include "services/conversion/map_cache.hpp"
#include "services/conversion/normalization.hpp"

namespace pleat::conversion {

struct SessionLimits {
  std::int64_t max_vertices = 1'000'000;  ///< of the fine mesh of a session
  std::int64_t max_texels = 4'000'000;    ///< of the fine image of a session
};

/// Not for several threads. Every member throws Error for input that is wrong, and stays usable.
class Session {
 public:
  Session(const v1::ConversionSetup& setup, const SessionLimits& limits, MapCache& cache);

  /// with_fine: the fine mesh and its feature vertices, too.
  void describe(bool with_fine, v1::ConversionOpened* opened) const;
  void to_image(const v1::Frame& request, v1::ImageFrame* response);
  void to_mesh(const v1::ImageFrame& request, v1::MeshFrame* response);

  /// Whether the maps came from the cache.
  bool maps_were_cached() const { return maps_were_cached_; }

 private:
  std::shared_ptr<const SessionMaps> maps_;
  bool maps_were_cached_ = false;
  Normalization normalization_;  // empty: values stay physical
  Normalization displacement_;   // its first three channels
  Eigen::Index coarse_vertices_;
  // Reused from frame to frame.
  Tensor image_;
  Positions positions_;
};

}  // namespace pleat::conversion
