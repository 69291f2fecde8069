// Fuzzers of whole streams: a service of this process behind gRPC; an input is what a client sends it.
#pragma once

#include <grpcpp/grpcpp.h>
#include <spdlog/spdlog.h>

#include <cstdio>
#include <cstdlib>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "common/rpc/channel.hpp"

namespace pleat::fuzz {

/// A server with one service, reached without a socket.
class ServedInProcess {
 public:
  explicit ServedInProcess(grpc::Service* service) {
    spdlog::set_level(spdlog::level::off);
    grpc::ServerBuilder builder;
    builder.SetMaxReceiveMessageSize(rpc::kMaxMessageBytes);
    builder.RegisterService(service);
    server_ = builder.BuildAndStart();
    channel_ = server_->InProcessChannel({});
  }
  const std::shared_ptr<grpc::Channel>& channel() const { return channel_; }

 private:
  std::unique_ptr<grpc::Server> server_;
  std::shared_ptr<grpc::Channel> channel_;
};

/// What a client may be told: that what it sent is no good or too much. Anything else is a fault of the service, and so
/// is a message that is empty or not one short line.
inline void check_end(const grpc::Status& status, bool cancelled) {
  switch (status.error_code()) {
    case grpc::StatusCode::OK:
      return;
    case grpc::StatusCode::CANCELLED:
      if (cancelled) return;
      break;
    case grpc::StatusCode::INVALID_ARGUMENT:
    case grpc::StatusCode::FAILED_PRECONDITION:
    case grpc::StatusCode::NOT_FOUND:
    case grpc::StatusCode::RESOURCE_EXHAUSTED:
    case grpc::StatusCode::DATA_LOSS: {
      const std::string& message = status.error_message();
      if (!message.empty() && message.size() < 1000 && message.find('\n') == std::string::npos) return;
      break;
    }
    default:
      break;
  }
  std::fprintf(stderr, "the stream ended with %d: %s\n", static_cast<int>(status.error_code()),
               status.error_message().c_str());
  std::abort();
}

/// Sends the messages, closes, and shows every answer to `see` until the stream ends or `see` has had enough (false).
template <typename Request, typename Response>
void run_stream(const std::function<
                    std::unique_ptr<grpc::ClientReaderWriter<Request, Response>>(grpc::ClientContext* context)>& start,
                const std::vector<Request>& messages, const std::function<bool(const Response& answer)>& see) {
  grpc::ClientContext context;
  const auto stream = start(&context);
  std::thread sender([&] {
    for (const Request& message : messages) {
      if (!stream->Write(message)) return;
    }
    stream->WritesDone();
  });
  bool cancelled = false;
  Response answer;
  while (!cancelled && stream->Read(&answer)) {
    if (see(answer)) continue;
    cancelled = true;
    context.TryCancel();
  }
  while (cancelled && stream->Read(&answer)) {
  }
  sender.join();
  check_end(stream->Finish(), cancelled);
}

}  // namespace pleat::fuzz
