#include "services/superres/batcher.hpp"

#include <atomic>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>

#include "common/base/error.hpp"

namespace pleat::superres {

struct Batcher::State {
  struct Request {
    Tensor frames;
    std::shared_ptr<const Tensor> constants;
    int channels;
    std::promise<Tensor> answer;
    NetworkInput input() const { return {&frames, constants}; }
  };

  std::shared_ptr<Engine> engine;
  BatcherOptions options;
  std::atomic<int> sessions{0};
  std::mutex mutex;
  std::condition_variable wake;
  std::deque<Request> queue;
  bool stopping = false;
  std::thread worker;

  std::vector<Request> collect() {
    std::unique_lock lock(mutex);
    wake.wait(lock, [&] { return stopping || !queue.empty(); });
    const auto full = [&] { return stopping || queue.size() >= static_cast<std::size_t>(options.largest_batch); };
    if (sessions.load() > 1) wake.wait_for(lock, options.latency, full);
    std::vector<Request> batch;
    while (!queue.empty() && batch.size() < static_cast<std::size_t>(options.largest_batch)) {
      if (!batch.empty() && (queue.front().frames.shape != batch.front().frames.shape ||
                             queue.front().channels != batch.front().channels)) {
        break;
      }
      batch.push_back(std::move(queue.front()));
      queue.pop_front();
    }
    return batch;
  }

  void answer_one(Request& request) {
    try {
      request.answer.set_value(engine->upscale(request.input(), request.channels));
    } catch (...) {
      request.answer.set_exception(std::current_exception());
    }
  }

  void answer(std::vector<Request>& batch) {
    if (batch.size() == 1) return answer_one(batch.front());
    std::vector<NetworkInput> inputs;
    for (const Request& request : batch) inputs.push_back(request.input());
    std::vector<Tensor> results;
    try {
      results = engine->upscale(inputs, batch.front().channels);
    } catch (const std::exception&) {
      // One bad image must not spoil the others: each gets its own answer or error.
      for (Request& request : batch) answer_one(request);
      return;
    }
    for (std::size_t i = 0; i < batch.size(); ++i) batch[i].answer.set_value(std::move(results[i]));
  }

  void work() {
    for (;;) {
      auto batch = collect();
      if (batch.empty()) return;
      answer(batch);
    }
  }
};

Batcher::Batcher(std::shared_ptr<Engine> engine, const BatcherOptions& options) : state_(std::make_shared<State>()) {
  state_->engine = std::move(engine);
  state_->options = options;
  state_->worker = std::thread([state = state_.get()] { state->work(); });
}

Batcher::~Batcher() {
  {
    const std::lock_guard lock(state_->mutex);
    state_->stopping = true;
  }
  state_->wake.notify_all();
  state_->worker.join();
}

std::future<Tensor> Batcher::submit(Tensor frames, std::shared_ptr<const Tensor> constants, int channels) {
  State::Request request{std::move(frames), std::move(constants), channels, {}};
  state_->engine->check(request.input());
  auto future = request.answer.get_future();
  {
    const std::lock_guard lock(state_->mutex);
    if (state_->queue.size() >= static_cast<std::size_t>(state_->options.queue)) {
      throw Error(ErrorCode::kResourceExhausted,
                  "super-resolution: " + std::to_string(state_->options.queue) + " frames are waiting already");
    }
    state_->queue.push_back(std::move(request));
  }
  state_->wake.notify_all();
  return future;
}

std::shared_ptr<void> Batcher::open_session() {
  state_->sessions.fetch_add(1);
  return {nullptr, [state = state_](void*) { state->sessions.fetch_sub(1); }};
}

const Engine& Batcher::engine() const { return *state_->engine; }

}  // namespace pleat::superres
