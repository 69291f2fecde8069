// A stream's work, message by message: what the service does between the streams and the library.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "common/base/limits.hpp"
#include "common/features/channel_ranges.hpp"
#include "pleat/v1/conversion.pb.h"
#include "services/conversion/representation.hpp"
#include "services/conversion/representation_cache.hpp"

namespace pleat::conversion {

struct SessionLimits {
  std::int64_t max_vertices = kDefaultMaxFineVertices;  ///< of the fine mesh of a session
  std::int64_t max_texels = 4'000'000;                  ///< of the fine image of a session
};

/// Not for several threads. Every member throws Error for input that is wrong, and stays usable.
class Session {
 public:
  /// dtype: of the values that encode() answers.
  Session(const v1::ConversionSetup& setup, const SessionLimits& limits, RepresentationCache& cache,
          v1::Tensor::DType dtype = v1::Tensor::DTYPE_FLOAT32);

  /// Sizes, constants, and with_fine: the fine mesh and its feature vertices, too.
  void describe(bool with_fine, v1::ConversionOpened* opened) const;
  /// What the frames to encode have around them. Read where the representation does, else ignored.
  void add_obstacles(const google::protobuf::RepeatedPtrField<v1::ObstacleShape>& shapes);
  /// What the network reads of a window of coarse frames, normalised.
  void encode(const v1::ToImageRequest& request, v1::ImageFrame* response);
  /// The fine frame that the network's answer means.
  void decode(const v1::ImageFrame& request, v1::MeshFrame* response);

  /// Whether the representation came from the cache.
  bool was_cached() const { return was_cached_; }

 private:
  std::shared_ptr<const Representation> representation_;
  bool was_cached_ = false;
  ChannelRanges input_, output_;  ///< input_: of all frames of the window
  v1::Tensor::DType dtype_;
  std::vector<ObstacleShape> obstacles_;
  std::optional<ObstacleField> field_;  ///< of the representation that reads obstacles
  // Reused from frame to frame.
  std::vector<Frame> frames_;
  Tensor input_tensor_, answer_;
  Positions positions_;
};

}  // namespace pleat::conversion
