#include "services/superres/batcher.hpp"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <utility>
#include <vector>

#include "common/base/error.hpp"

namespace pleat::superres {

struct Batcher::State {
  struct Request {
    const NetworkInput& input;
    int channels;
    Tensor& answer;
    std::exception_ptr error = {};
    bool done = false;
    const std::vector<std::int64_t>& shape() const { return input.frames->shape; }
  };
  using Batch = std::vector<Request*>;

  std::shared_ptr<Engine> engine;
  BatcherOptions options;
  std::atomic<int> sessions{0};
  std::mutex mutex;
  std::condition_variable arrived, answered;
  std::deque<Request*> queue;
  bool inferring = false;

  /// The next ones of the queue. With the lock.
  void collect(std::unique_lock<std::mutex>& lock, Batch& batch) {
    const auto full = [&] { return queue.size() >= static_cast<std::size_t>(options.largest_batch); };
    if (sessions.load() > 1) arrived.wait_for(lock, options.latency, full);
    while (!queue.empty() && batch.size() < static_cast<std::size_t>(options.largest_batch)) {
      if (!batch.empty() &&
          (queue.front()->shape() != batch.front()->shape() || queue.front()->channels != batch.front()->channels)) {
        break;
      }
      batch.push_back(queue.front());
      queue.pop_front();
    }
  }

  void answer_one(Request& request) const {
    try {
      Tensor* const answer = &request.answer;
      engine->upscale({&request.input, 1}, request.channels, {&answer, 1});
    } catch (...) {
      request.error = std::current_exception();
    }
  }

  void answer(const Batch& batch) const {
    if (batch.size() == 1) return answer_one(*batch.front());
    try {
      std::vector<NetworkInput> inputs;
      std::vector<Tensor*> answers;
      for (Request* request : batch) {
        inputs.push_back(request->input);
        answers.push_back(&request->answer);
      }
      engine->upscale(inputs, batch.front()->channels, answers);
    } catch (...) {
      // One bad image must not spoil the others: each gets its own answer or error.
      for (Request* request : batch) answer_one(*request);
    }
  }
};

Batcher::Batcher(std::shared_ptr<Engine> engine, const BatcherOptions& options) : state_(std::make_shared<State>()) {
  state_->engine = std::move(engine);
  state_->options = options;
  state_->options.largest_batch = std::max(1, options.largest_batch);
}

Batcher::~Batcher() = default;

void Batcher::upscale(const NetworkInput& input, int channels, Tensor& answer) {
  State& state = *state_;
  State::Request request{input, channels, answer};
  state.engine->check(input);
  State::Batch batch;
  batch.reserve(static_cast<std::size_t>(state.options.largest_batch));
  std::unique_lock lock(state.mutex);
  if (state.queue.size() >= static_cast<std::size_t>(state.options.queue)) {
    throw Error(ErrorCode::kResourceExhausted,
                "super-resolution: " + std::to_string(state.options.queue) + " frames are waiting already");
  }
  state.queue.push_back(&request);
  state.arrived.notify_one();
  while (!request.done) {
    if (state.inferring) {
      state.answered.wait(lock);
      continue;
    }
    state.inferring = true;
    state.collect(lock, batch);
    lock.unlock();
    state.answer(batch);
    lock.lock();
    for (State::Request* answered : batch) answered->done = true;
    batch.clear();
    state.inferring = false;
    state.answered.notify_all();
  }
  if (request.error) std::rethrow_exception(request.error);
}

std::shared_ptr<void> Batcher::open_session() {
  state_->sessions.fetch_add(1);
  return {nullptr, [state = state_](void*) { state->sessions.fetch_sub(1); }};
}

const Engine& Batcher::engine() const { return *state_->engine; }

}  // namespace pleat::superres
