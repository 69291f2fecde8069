// The stages behind the simulation, in a row: to_image -> superres -> to_mesh -> refinement. Frames overlap.
#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "common/mesh/subdivision.hpp"
#include "pleat/v1/superres.pb.h"
#include "services/coordinator/earlier_frames.hpp"
#include "services/coordinator/pipeline_frame.hpp"
#include "services/coordinator/remote_stage.hpp"

namespace pleat::coordinator {

/// One address or several (replicas) per service.
struct ServiceAddresses {
  std::vector<std::string> simulation, conversion, superres, refinement;
};

/// "a,b" -> {a, b}. Throws kInvalidArgument, naming the service, if none is left.
std::vector<std::string> split_addresses(const std::string& service, const std::string& list);

/// What the stages of one session agree on.
struct PipelineSession {
  v1::Topology coarse;
  v1::ModelDescription model;
  v1::Representation representation;  ///< of the model, or with another subdivision that was asked for
  v1::ConversionOpened conversion;    ///< what conversion says of it: describe_conversion()
  std::vector<v1::Frame> earlier;     ///< the frames before first_sequence that its window needs, the oldest first
  google::protobuf::RepeatedPtrField<v1::ObstacleShape> obstacles;
  std::optional<float> clearance_m;
  bool skip_refinement = false;
  std::uint32_t window = 4;          ///< frames in flight per stage and replica
  std::uint64_t first_sequence = 0;  ///< of the first frame
};

/// Before anything is made of a mesh: throws kResourceExhausted if `rounds` subdivisions of it have more than
/// `max_vertices` vertices (each multiplies them by four), and kInvalidArgument for more than kMaxSubdivisionRounds.
/// `what` goes before the message.
void admit(std::int64_t coarse_vertices, int rounds, std::int64_t max_vertices, const std::string& what);

/// Asks the super-resolution service what a bundle is, until it answers or the outage is too long. `name` empty: the
/// service's default. `cancelled` is asked between attempts. Errors: kNotFound, kUnavailable (naming the address), ...
v1::ModelDescription describe_model(const ServiceAddresses& addresses, const LinkOptions& link, const std::string& name,
                                    const std::function<bool()>& cancelled);

/// Asks the conversion service for what a session will get, as describe_model() asks for the bundle.
v1::ConversionOpened describe_conversion(const ServiceAddresses& addresses, const LinkOptions& link,
                                         const PipelineSession& session, const std::function<bool()>& cancelled);

/// The fine mesh of a session, and how it comes from the coarse one. Throws kInternal unless it is the one that
/// conversion has described.
Subdivision subdivision_of(const PipelineSession& session, const Topology& coarse);

/// Throws kFailedPrecondition, saying what differs, if frames of the bundle that describes itself as `now` must not
/// follow those of `before`. Where it runs (device, precision) may change.
void require_same_bundle(const v1::ModelDescription& before, const v1::ModelDescription& now);

/// Frames enter in sequence (without gaps) and come out in sequence, each exactly once: refined, or with `error` set.
/// Memory is bounded by the windows. A stage that dies is reconnected and gets its frames again; the answers are the
/// same, because stages keep no state between frames. Thread-safe.
class EnhancementPipeline {
 public:
  /// Called by one thread at a time. May block (then everything before it waits) and may throw (then the session
  /// fails).
  using Sink = std::function<void(std::unique_ptr<PipelineFrame>)>;

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
  void hand_on(std::size_t from, std::unique_ptr<PipelineFrame> frame);
  void stage_drained(std::size_t stage);

  const Sink sink_;
  const std::function<void()> failed_;
  const std::size_t fine_vertices_;
  EarlierFrames earlier_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<Error> failure_;
  std::size_t opened_ = 0;
  std::vector<bool> stage_opened_;
  bool done_ = false;
  std::vector<std::function<void(PipelineFrame&)>> prepare_;  ///< makes the request of each stage
  std::vector<std::unique_ptr<Stage>> stages_;                ///< complete before the first thread starts
};

}  // namespace pleat::coordinator
