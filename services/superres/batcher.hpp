// Collects frames of several sessions into one inference.
#pragma once

#include <chrono>
#include <memory>

#include "services/superres/engine.hpp"

namespace pleat::superres {

struct BatcherOptions {
  int largest_batch = 4;                                             ///< frames in one inference at most
  std::chrono::microseconds latency = std::chrono::milliseconds(1);  ///< how long the first frame waits for others
  int queue = 64;                                                    ///< frames waiting at most
};

/// Runs an Engine in the threads of its callers: whoever comes while nobody infers does so, for those who wait as well.
/// So a lone frame is handed to no other thread. Nor does a lone session wait: the latency bound counts only while at
/// least two sessions are open (see open_session).
class Batcher {
 public:
  Batcher(std::shared_ptr<Engine> engine, const BatcherOptions& options);
  /// When nobody is in upscale() any more.
  ~Batcher();
  Batcher(const Batcher&) = delete;
  Batcher& operator=(const Batcher&) = delete;

  /// answer: the first `channels` (0: all) of the answer to a window of frames (T C, h, w) with the session's
  /// constants; its memory is used again. From any thread; waits for its turn. Throws kResourceExhausted if the queue
  /// is full, and as Engine::check() and Engine::upscale(). A faulty image spoils only its own answer.
  void upscale(const NetworkInput& input, int channels, Tensor& answer);

  /// A session counts until the returned token dies.
  std::shared_ptr<void> open_session();

  const Engine& engine() const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace pleat::superres
