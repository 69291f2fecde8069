// Coarse frames from the simulation service, without gaps, whatever happens to the service.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "pleat/v1/simulation.grpc.pb.h"
#include "services/coordinator/remote_stage.hpp"

namespace pleat::coordinator {

/// Parts that several sources share: they may be large.
using Animations = std::shared_ptr<const std::vector<v1::AnimationPart>>;

/// One simulation of one scene. When the stream breaks it is opened again, at the newest check-point; frames that come
/// a second time are dropped. The simulation is deterministic, so that the frames are those of an undisturbed run.
class SimulationSource {
 public:
  struct Options {
    std::vector<std::string> addresses;  ///< the next one is tried when one fails; with a directory any comes first
    v1::Scene scene;                     ///< with its `frames`
    Animations animations;               ///< what the scene announces (take_animations); null: nothing
    v1::SimulateOpen::Fine fine = v1::SimulateOpen::FINE_NONE;
    std::uint32_t window = 4;
    std::uint32_t checkpoint_interval = 25;
    std::string checkpoint;  ///< to start from; empty: from the beginning
    LinkOptions link;
  };
  /// Takes a frame; false ends the run. May block: the simulation waits. May change the frame.
  using Take = std::function<bool(v1::SimulatedFrame&)>;

  explicit SimulationSource(Options options);
  ~SimulationSource();

  /// Opens the scene. Errors: what the service says of the scene, kUnavailable naming the address after the outage.
  v1::SimulateOpened open();

  /// After open(): hands every frame from opened.next_index on to `take`, in the caller's thread. Returns at the last
  /// frame or when take returns false. Throws as open(), and for a frame that could not be simulated.
  void run(const Take& take);

  /// From any thread: open() and run() throw kCancelled soon.
  void cancel();

 private:
  using Stream = rpc::FrameStream<v1::SimulateRequest, v1::SimulateResponse>;
  struct Connection;

  v1::SimulateOpened connect();
  void retry_after(const Error& cause);
  void receive(const Take& take);
  std::string peer() const;

  Options options_;
  Outage outage_;
  Backoff backoff_;
  ReplicaChoice choice_;
  std::string address_;  ///< of the one that is asked
  std::uint64_t next_index_ = 0;
  std::unique_ptr<Connection> connection_;
  std::mutex mutex_;  ///< guards the pointer above and the flag
  std::condition_variable changed_;
  bool cancelled_ = false;
  bool received_ = false;  ///< a frame from the replica that is asked
};

}  // namespace pleat::coordinator
