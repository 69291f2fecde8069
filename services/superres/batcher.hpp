// Collects frames of several sessions into one inference.
#pragma once

#include <chrono>
#include <future>
#include <memory>
#include <vector>

#include "services/superres/engine.hpp"

namespace pleat::superres {

struct BatcherOptions {
  int largest_batch = 4;                                             ///< frames in one inference at most
  std::chrono::microseconds latency = std::chrono::milliseconds(1);  ///< how long the first frame waits for others
  int queue = 64;                                                    ///< frames waiting at most
};

/// Runs an Engine on one thread. submit() may be called from any thread. A lone session does not wait: the latency
/// bound counts only while at least two sessions are open (see open_session).
class Batcher {
 public:
  Batcher(std::shared_ptr<Engine> engine, const BatcherOptions& options);
  /// Finishes what is queued.
  ~Batcher();
  Batcher(const Batcher&) = delete;
  Batcher& operator=(const Batcher&) = delete;

  /// Queues a window of frames (T C, h, w) with the session's constants; the future holds the first `channels` of the
  /// answer (0: all), or the error of its inference. Throws kResourceExhausted if the queue is full, and as
  /// Engine::check(). A faulty image spoils only its own answer.
  std::future<Tensor> submit(Tensor frames, std::shared_ptr<const Tensor> constants, int channels = 0);

  /// A session counts until the returned token dies.
  std::shared_ptr<void> open_session();

  const Engine& engine() const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace pleat::superres
