// Writes a job's frames to its result file, in a thread of its own.
#pragma once

#include <condition_variable>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "common/base/error.hpp"
#include "common/frame/detail.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/result.hpp"
#include "services/coordinator/pipeline_frame.hpp"

namespace pleat::coordinator {

/// What result.h5 has of every frame of a job.
struct JobColumns {
  /// In the order of the pipeline. `store` is the time that writing the frame before took: a frame's own is not known
  /// before it is written.
  std::vector<std::string> stages;
  /// penetrations, self_intersections, frame_errors (1: the frame failed and has the upsampled coarse mesh),
  /// input_intersects (1: the coarse frame was not clean itself), and of the fold step fold_steps, fold_restarts.
  std::vector<std::string> counts;
};
/// detail: checked.
JobColumns job_columns(v1::Detail detail);

/// The frame as the result file has it. A frame with an error gets the barycentrically upsampled coarse mesh: it has no
/// wrinkles, but where the coarse mesh is free of intersections so is it.
ResultFrame to_result_frame(const PipelineFrame& frame, const Subdivision& subdivision, const Faces& coarse_faces,
                            const JobColumns& columns, float store_ms);

class Recorder {
 public:
  using FramePtr = std::shared_ptr<PipelineFrame>;

  struct Callbacks {
    std::function<void(const FramePtr&, std::uint64_t frames_complete)> stored;  ///< in the recorder's thread
    std::function<void(const Error&)> failed;                                    ///< once; nothing is written any more
  };

  /// Continues PATH.partial if it fits. options.stages and counts: those of job_columns(). `capacity`: frames waiting.
  /// Errors as ResultWriter.
  Recorder(const std::filesystem::path& path, const ResultOptions& options, const Subdivision& subdivision,
           std::size_t capacity, Callbacks callbacks);
  /// Stops after the frame in hand; what is written stays.
  ~Recorder();

  /// Frames on disk when it was made: the first frame to add has this index.
  std::uint64_t first_index() const { return first_index_; }

  /// Waits for room. False: writing has failed.
  bool add(FramePtr frame);

  /// Writes what waits, completes the file and gives it its final name. Throws what failed.
  void finish();

  /// After a failure: gives the complete frames their final name, where there are any and the disk allows it.
  void salvage() noexcept;

 private:
  void run();

  const Subdivision& subdivision_;
  const Faces coarse_faces_;
  const JobColumns columns_;
  const std::size_t capacity_;
  const Callbacks callbacks_;
  ResultWriter writer_;
  const std::uint64_t first_index_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<FramePtr> waiting_;
  bool closed_ = false, abandoned_ = false;
  std::optional<Error> failure_;
  std::thread thread_;
};

}  // namespace pleat::coordinator
