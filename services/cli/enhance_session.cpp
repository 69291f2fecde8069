#include "services/cli/enhance_session.hpp"

#include <deque>

#include "common/base/signals.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/stream.hpp"

namespace pleat::cli {

struct EnhanceSession::Stream : rpc::FrameStream<v1::EnhanceRequest, v1::EnhanceResponse> {
  using FrameStream::FrameStream;
};

EnhanceSession::EnhanceSession(const std::shared_ptr<grpc::Channel>& channel, const std::string& address,
                               const EnhanceSessionOptions& options)
    : stub_(v1::Coordinator::NewStub(channel)), frame_time_s_(options.frame_time_s) {
  rpc::FrameStreamOptions stream;
  stream.peer = "coordinator at " + address;
  stream.window = rpc::checked_window(options.window);
  stream_ = std::make_unique<Stream>([this](grpc::ClientContext* context) { return stub_->Enhance(context); }, stream);

  v1::EnhanceRequest request;
  v1::EnhanceOpen& open = *request.mutable_open();
  *open.mutable_coarse() = to_message(options.coarse);
  open.set_model(options.model);
  open.set_frame_time_s(options.frame_time_s);
  for (const ObstacleShape& shape : options.obstacles) *open.add_obstacles() = to_message(shape);
  open.set_window(stream.window);
  open.set_skip_refinement(options.skip_refinement);
  if (options.subdivision_rounds) open.set_subdivision_rounds(*options.subdivision_rounds);
  const v1::EnhanceOpened opened = stream_->open(request);
  topology_.coarse = options.coarse;
  topology_.fine = from_message(opened.fine());
  topology_.feature_vertices.assign(opened.feature_vertices().begin(), opened.feature_vertices().end());
  model_ = opened.model();
  device_ = opened.device();
  precision_ = opened.precision();
}

EnhanceSession::~EnhanceSession() = default;

void EnhanceSession::run(std::uint64_t count, const std::function<CoarseInput(std::uint64_t)>& input,
                         const std::function<void(const v1::EnhancedFrame&, const CoarseInput&)>& sink) {
  std::deque<CoarseInput> waiting;  // inputs without an answer, bounded by the window
  v1::EnhanceRequest request;
  v1::EnhanceResponse response;
  std::uint64_t next = 0, answered = 0;
  bool pushed = true;
  while (answered < count) {
    if (interrupted())
      throw Error(ErrorCode::kCancelled,
                  "interrupted after frame " + std::to_string(answered) + " of " + std::to_string(count));
    while (next < count) {
      if (pushed) {
        waiting.push_back(input(next));
        v1::EnhanceFrame& frame = *request.mutable_frame();
        frame.Clear();
        frame.mutable_coarse()->set_index(next);
        frame.mutable_coarse()->set_time_s(frame_time_s_ * static_cast<double>(next));
        const Positions& positions = waiting.back().positions;
        frame.mutable_coarse()->mutable_positions()->Assign(positions.data(), positions.data() + positions.size());
        for (const ObstacleFrame& obstacle : waiting.back().obstacles) *frame.add_obstacles() = to_message(obstacle);
      }
      pushed = stream_->try_push(request);
      if (!pushed) break;
      ++next;
    }
    if (next == count) stream_->close();
    if (!stream_->pop(&response))
      throw Error(ErrorCode::kUnavailable, "the coordinator ended the session after " + std::to_string(answered) +
                                               " of " + std::to_string(count) + " frames");
    if (response.has_error()) {
      const v1::FrameError& error = response.error();
      throw Error(rpc::to_error_code(static_cast<grpc::StatusCode>(error.code())),
                  "frame " + std::to_string(error.index()) + ": " + error.message());
    }
    sink(response.frame(), waiting.front());
    waiting.pop_front();
    ++answered;
  }
  // The session ends well on both sides before it goes.
  if (stream_->pop(&response)) throw_internal("the coordinator sent more frames than it was asked for");
}

}  // namespace pleat::cli
