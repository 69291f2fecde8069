// Enhanced frames from a coordinator, into result.h5.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "common/client/cpp/values.hpp"
#include "common/frame/detail.hpp"
#include "common/frame/frame.hpp"
#include "common/store/result.hpp"

namespace pleat::cli {

/// What a recording needs before its first frame.
struct RecordingOptions {
  std::filesystem::path path;  ///< result.h5
  MeshPair topology;
  std::uint64_t frames = 0;  ///< planned
  double frame_time_s = 0;
  std::string model;
  std::string scene;  ///< JSON, may be empty
  std::vector<ObstacleShape> obstacles;
  v1::Detail detail = v1::DETAIL_NETWORK;  ///< asked for, checked
};

/// Frames must come in order from 0, as streams deliver them. Not thread-safe.
class ResultRecorder {
 public:
  explicit ResultRecorder(RecordingOptions options) : options_(std::move(options)) {}

  /// The stages of the first frame become those of the file, if it has any. A frame with an error is one of
  /// `frame_errors`, and needs positions all the same. Throws kInternal (order), kResourceExhausted (disk).
  void add(const client::EnhancedFrame& frame, Positions coarse, std::vector<ObstacleFrame> obstacles);
  /// Ends with what there is: result.h5.partial becomes result.h5. Throws kFailedPrecondition without a frame.
  void finish();

  std::uint64_t frames() const { return frames_; }
  std::uint64_t penetrations() const { return penetrations_; }
  std::uint64_t self_intersections() const { return self_intersections_; }
  std::uint64_t frame_errors() const { return frame_errors_; }

 private:
  void open(const client::EnhancedFrame& first, const std::vector<ObstacleFrame>& obstacles);

  RecordingOptions options_;
  std::optional<ResultWriter> writer_;
  std::vector<std::string> stages_;
  bool folds_ = false;  ///< the fold step is among them
  std::uint64_t frames_ = 0, penetrations_ = 0, self_intersections_ = 0, frame_errors_ = 0;
};

}  // namespace pleat::cli
