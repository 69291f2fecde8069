// A frame stream service for tests: Refinement whose answers are its requests, with some indices that misbehave.
#pragma once

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <thread>

#include "common/rpc/server.hpp"
#include "common/rpc/stream.hpp"
#include "pleat/v1/refinement.grpc.pb.h"
#include "pleat/v1/simulation.grpc.pb.h"

namespace pleat::rpc::testing {

class SampleRefinement final : public v1::Refinement::Service {
 public:
  static constexpr std::uint64_t kBadFrame = 1'000'000, kThrowingFrame = 1'000'001, kStuckFrame = 1'000'002;
  static constexpr std::uint64_t kSlowFrame = 1'000'003;  ///< the service is told to stop while it is in work

  explicit SampleRefinement(telemetry::Metrics* metrics = nullptr, std::size_t concurrency = 1)
      : metrics_(metrics), concurrency_(concurrency) {}

  grpc::Status Refine(grpc::ServerContext* context,
                      grpc::ServerReaderWriter<v1::RefineResponse, v1::RefineRequest>* stream) override {
    sessions_++;
    trace_id_ = trace_of(*context).trace_id;
    const grpc::Status status =
        serve_frames(context, stream, {"refinement", metrics_, &drain_, concurrency_, idle_timeout_, reader_timeout_},
                     [&](const v1::RefineOpen& open, v1::RefineOpened* opened) {
                       if (open.coarse().hash() == "bad") throw_invalid_argument("open.coarse: bad");
                       opened->set_fine_hash("fine of " + open.coarse().hash());
                       return [this, context](const v1::RefineFrame& frame, v1::RefinedFrame* refined) {
                         process(context, frame, refined);
                       };
                     });
    sessions_--;
    return status;
  }

  std::chrono::milliseconds idle_timeout_ = kIdleTimeout, reader_timeout_ = kReaderTimeout;
  std::atomic<int> sessions_ = 0;
  std::atomic<int> frames_ = 0;
  std::atomic<int> niceness_ = 0;  ///< of the thread that worked on the last frame
  Drain drain_;
  std::string trace_id_;  ///< of the last stream

 private:
  void process(grpc::ServerContext* context, const v1::RefineFrame& frame, v1::RefinedFrame* refined) {
    const std::uint64_t index = frame.coarse().index();
    frames_++;
    niceness_ = getpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)));
    if (index == kBadFrame) throw_invalid_argument("frame 1000000: bad");
    if (index == kThrowingFrame) throw std::runtime_error("an unexpected failure");
    if (index == kSlowFrame) {
      drain_.begin();
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    while (index == kStuckFrame && !context->IsCancelled()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    // Concurrent frames end in another order than they came.
    if (concurrency_ > 1 && index % 3 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(3));
    *refined->mutable_fine() = frame.fine();
    refined->mutable_fine()->set_index(index);
  }

  telemetry::Metrics* metrics_;
  std::size_t concurrency_;
};

/// Sends frames without end, as far as the client acknowledges.
class SampleSimulation final : public v1::Simulation::Service {
 public:
  grpc::Status Simulate(grpc::ServerContext* context,
                        grpc::ServerReaderWriter<v1::SimulateResponse, v1::SimulateRequest>* stream) override {
    return guard([&] {
      v1::SimulateRequest open;
      if (!stream->Read(&open)) return;
      v1::SimulateResponse response;
      response.mutable_opened()->set_next_index(open.open().checkpoint().size());
      stream->Write(response);
      const std::uint64_t first = open.open().checkpoint().size(), frames = open.open().scene().frames();
      PacedWriter<v1::SimulateRequest, v1::SimulateResponse> writer(
          context, stream, checked_window(open.open().window()), first, &drain_);
      for (std::uint64_t k = first; k < frames; ++k) {
        response.mutable_frame()->mutable_coarse()->set_index(k);
        if (!writer.write(k, response)) return;
        sent_ = k + 1;
      }
      writer.close();
    });
  }

  std::atomic<std::uint64_t> sent_ = 0;
  Drain drain_;
};

}  // namespace pleat::rpc::testing
