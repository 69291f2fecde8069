#include "services/coordinator/simulation_source.hpp"

#include <spdlog/spdlog.h>

#include <utility>

namespace pleat::coordinator {

struct SimulationSource::Connection {
  explicit Connection(std::shared_ptr<ReplicaLoad> load) : share(std::move(load), &ReplicaLoad::sessions) {}

  const LoadShare share;
  std::unique_ptr<v1::Simulation::Stub> stub;
  std::unique_ptr<Stream> stream;
};

SimulationSource::SimulationSource(Options options)
    : options_(std::move(options)),
      outage_(options_.link.give_up),
      choice_(options_.link.replicas, options_.link.replicas ? options_.link.replicas->turn() : 0) {}

SimulationSource::~SimulationSource() = default;

v1::SimulateOpened SimulationSource::open() {
  while (true) {
    try {
      auto opened = connect();
      next_index_ = opened.next_index();
      return opened;
    } catch (const Error& e) {
      retry_after(e);
    }
  }
}

void SimulationSource::run(const Take& take) {
  while (true) {
    try {
      if (!connection_) {
        const auto opened = connect();
        if (opened.next_index() > next_index_) {
          throw_invalid_argument(peer() + " went on at frame " + std::to_string(opened.next_index()) + " instead of " +
                                 std::to_string(next_index_));
        }
      }
      receive(take);
      return;
    } catch (const Error& e) {
      retry_after(e);
    }
  }
}

void SimulationSource::cancel() {
  {
    const std::lock_guard lock(mutex_);
    cancelled_ = true;
    if (connection_ && connection_->stream) connection_->stream->cancel();
  }
  changed_.notify_all();
}

std::string SimulationSource::peer() const { return "simulation at " + address_; }

v1::SimulateOpened SimulationSource::connect() {
  address_ = choice_.next(replicas_behind(options_.link.replicas, options_.addresses));
  auto fresh =
      std::make_unique<Connection>(options_.link.replicas ? options_.link.replicas->load_of(address_) : nullptr);
  fresh->stub = v1::Simulation::NewStub(options_.link.connect(address_));
  fresh->stream = std::make_unique<Stream>(
      [&](auto* context, auto* call) {
        add_origin(*context, options_.link);
        fresh->stub->async()->Simulate(context, call);
      },
      rpc::FrameStreamOptions{.peer = peer(),
                              .window = options_.window,
                              .open_timeout = options_.link.open_timeout,
                              .frame_timeout = options_.link.answer_timeout,
                              .server_driven = true});
  {
    const std::lock_guard lock(mutex_);
    connection_ = std::move(fresh);
    if (cancelled_) connection_->stream->cancel();
  }
  v1::SimulateRequest request;
  v1::SimulateOpen& open = *request.mutable_open();
  *open.mutable_scene() = options_.scene;
  open.set_fine(options_.fine);
  open.set_window(options_.window);
  open.set_checkpoint_interval(options_.checkpoint_interval);
  open.set_checkpoint(options_.checkpoint);
  if (options_.animations == nullptr || options_.animations->empty()) return connection_->stream->open(request);
  // The service answers after the last part.
  for (const v1::AnimationPart& part : *options_.animations) {
    connection_->stream->send(request);
    *request.mutable_animation() = part;
  }
  return connection_->stream->open(request);
}

void SimulationSource::retry_after(const Error& cause) {
  std::unique_ptr<Connection> broken;
  {
    const std::lock_guard lock(mutex_);
    broken = std::move(connection_);
    if (cancelled_) throw Error(ErrorCode::kCancelled, "cancelled");
  }
  broken.reset();
  if (!may_pass(cause.code())) throw cause;
  if (outage_.too_long()) throw outage_.gave_up(cause);
  if (received_) spdlog::warn("{}; goes on elsewhere behind frame {}", cause.what(), next_index_);
  received_ = false;
  if (options_.link.metrics != nullptr) options_.link.metrics->count("reconnects");
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, backoff_.next(), [this] { return cancelled_; });
}

void SimulationSource::receive(const Take& take) {
  Stream& stream = *connection_->stream;
  v1::SimulateResponse response;
  v1::SimulateRequest acknowledgement;
  while (next_index_ < options_.scene.frames()) {
    if (!stream.pop(&response)) throw Error(ErrorCode::kUnavailable, peer() + " ended the stream too early");
    if (response.has_error()) {
      // Without a coarse frame there is nothing to enhance, and trying again gives the same.
      throw Error(ErrorCode::kFailedPrecondition,
                  peer() + ": frame " + std::to_string(response.error().index()) + ": " + response.error().message());
    }
    if (!response.has_frame()) throw Error(ErrorCode::kInternal, peer() + " sent a message that is no frame");
    v1::SimulatedFrame& frame = *response.mutable_frame();
    const std::uint64_t index = frame.coarse().index();
    if (index > next_index_) {
      throw Error(ErrorCode::kInternal,
                  peer() + " sent frame " + std::to_string(index) + " before frame " + std::to_string(next_index_));
    }
    if (!frame.checkpoint().empty()) options_.checkpoint = frame.checkpoint();
    if (index == next_index_) {
      if (!take(frame)) return;
      ++next_index_;
      outage_.serves();
      backoff_.reset();
      choice_.served();
      received_ = true;
    }
    if (next_index_ < options_.scene.frames()) {
      acknowledgement.set_ack_index(index);
      stream.send(acknowledgement);
    }
  }
  stream.close();
}

}  // namespace pleat::coordinator
