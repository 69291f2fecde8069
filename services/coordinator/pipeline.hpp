// The stages behind the simulation, in a row: to_image -> superres -> to_mesh, or fold, or both -> refinement. Frames
// overlap. Without any detail the pipeline upsamples itself; simulated fine frames come with theirs and are judged.
#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "services/coordinator/earlier_frames.hpp"
#include "services/coordinator/pipeline_frame.hpp"
#include "services/coordinator/pipeline_session.hpp"
#include "services/coordinator/remote_stage.hpp"

namespace pleat::coordinator {

/// Frames enter in sequence (without gaps) and come out in sequence, each exactly once: refined, or with `error` set.
/// Memory is bounded by the windows. A stage that dies is reconnected and gets its frames again; the answers are the
/// same, because stages keep no state between frames, and what the fold step and networks keep is here too.
/// Thread-safe.
class EnhancementPipeline {
 public:
  /// Called by one thread at a time. May block (then everything before it waits) and may throw (then the session
  /// fails).
  using Sink = std::function<void(std::unique_ptr<PipelineFrame>)>;

  /// Throws kInvalidArgument for a session in which no stage has anything to do.
  /// A super-resolution service that opens with another bundle than session.model fails the session
  /// (require_same_bundle).
  /// failed: called once when the session fails or is given up, in the thread where that happens; must not block.
  EnhancementPipeline(const ServiceAddresses& addresses, const LinkOptions& link, const PipelineSession& session,
                      std::size_t fine_vertices, const std::string& fine_hash, Sink sink,
                      std::function<void()> failed = {});
  /// Cancels what is not done.
  ~EnhancementPipeline();

  /// Waits until every stage has answered `opened`, or throws what failed.
  void wait_open();

  /// Blocks while the first stage is full. False: the session failed or was cancelled.
  bool push(std::unique_ptr<PipelineFrame> frame);
  /// No more frames will come.
  void close();
  /// After close(): waits until the sink has had every frame, or throws what failed.
  void wait();

  /// Ends the session from any thread, at once. The first cause is the one that is thrown.
  void fail(const Error& cause);
  bool failed() const;

 private:
  /// What every stage has in common with the others.
  template <typename Rpc, typename Opened>
  void add_stage(typename RemoteStage<Rpc>::Options options, const PipelineSession& session, Opened opened);
  void stage_is_open(std::size_t stage);
  void hand_on(std::size_t from, std::unique_ptr<PipelineFrame> frame);
  void stage_drained(std::size_t stage);

  const Sink sink_;
  const std::function<void()> failed_;
  const std::size_t fine_vertices_;
  EarlierFrames earlier_;
  const std::shared_ptr<const SmoothUpsampling> upsampling_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<Error> failure_;
  std::size_t opened_ = 0;
  std::vector<bool> stage_opened_;
  bool done_ = false;
  struct Kind {
    std::string name;
    bool makes_fine_mesh = false;
    void (*prepare)(PipelineFrame&) = nullptr;  ///< makes its request
  };
  std::vector<Kind> kinds_;                     ///< of the stages
  std::vector<std::unique_ptr<Stage>> stages_;  ///< complete before the first thread starts
};

}  // namespace pleat::coordinator
