#include "common/client/client.hpp"

#include <random>
#include <thread>

#include "common/frame/messages.hpp"
#include "common/rpc/status.hpp"
#include "common/rpc/stream.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"

namespace pleat {
namespace {

using namespace std::chrono_literals;

constexpr auto kCallTimeout = 5s;
constexpr auto kFirstBackoff = 100ms;
constexpr int kAttempts = 3;

std::string random_id() {
  std::random_device device;
  std::string id = "job-";
  for (int i = 0; i < 16; ++i) id += "0123456789abcdef"[device() % 16];
  return id;
}

}  // namespace

struct EnhanceSession::State {
  using Stream = rpc::FrameStream<v1::EnhanceRequest, v1::EnhanceResponse>;

  std::shared_ptr<v1::Coordinator::Stub> stub;
  std::unique_ptr<Stream> stream;
  v1::EnhanceOpened opened;
  Topology fine;
  v1::EnhanceRequest request;    ///< reused by the pushing thread
  v1::EnhanceResponse response;  ///< reused by the popping thread

  void fill(const Frame& coarse, const std::vector<ObstacleFrame>& obstacles) {
    auto* frame = request.mutable_frame();
    to_message(coarse, frame->mutable_coarse());
    frame->clear_obstacles();
    for (const ObstacleFrame& obstacle : obstacles) *frame->add_obstacles() = to_message(obstacle);
  }
};

EnhanceSession::EnhanceSession(std::unique_ptr<State> state) : state_(std::move(state)) {}
EnhanceSession::EnhanceSession(EnhanceSession&&) noexcept = default;
EnhanceSession& EnhanceSession::operator=(EnhanceSession&&) noexcept = default;
EnhanceSession::~EnhanceSession() = default;

const Topology& EnhanceSession::fine() const { return state_->fine; }
const v1::EnhanceOpened& EnhanceSession::opened() const { return state_->opened; }

void EnhanceSession::push(const Frame& coarse, const std::vector<ObstacleFrame>& obstacles) {
  state_->fill(coarse, obstacles);
  state_->stream->push(state_->request);
}

bool EnhanceSession::try_push(const Frame& coarse, const std::vector<ObstacleFrame>& obstacles) {
  state_->fill(coarse, obstacles);
  return state_->stream->try_push(state_->request);
}

std::optional<EnhancedResult> EnhanceSession::pop() {
  v1::EnhanceResponse& response = state_->response;
  if (!state_->stream->pop(&response)) return std::nullopt;
  EnhancedResult result;
  if (response.has_error()) {
    const v1::FrameError& error = response.error();
    result.index = error.index();
    result.error.emplace(rpc::to_error_code(static_cast<grpc::StatusCode>(error.code())),
                         "frame " + std::to_string(error.index()) + ": " + error.message());
    return result;
  }
  const v1::EnhancedFrame& frame = response.frame();
  result.index = frame.fine().index();
  result.fine = from_message(frame.fine(), state_->fine.vertex_count(), "fine");
  result.report = frame.report();
  result.stage_times.assign(frame.stage_times().begin(), frame.stage_times().end());
  return result;
}

void EnhanceSession::close() { state_->stream->close(); }
void EnhanceSession::cancel() { state_->stream->cancel(); }

struct Client::State {
  std::string address;
  std::string peer;
  std::shared_ptr<grpc::Channel> channel;
  std::shared_ptr<v1::Coordinator::Stub> stub;

  /// One unary call, repeated with growing pauses while nobody answers.
  template <typename Call>
  void call(Call&& make) const {
    auto pause = std::chrono::milliseconds(kFirstBackoff);
    for (int attempt = 1;; ++attempt) {
      grpc::ClientContext context;
      context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
      const grpc::Status status = make(&context);
      if (status.error_code() != grpc::StatusCode::UNAVAILABLE || attempt == kAttempts) {
        rpc::throw_if_failed(status, peer);
        return;
      }
      std::this_thread::sleep_for(pause);
      pause *= 3;
    }
  }
};

Client::Client(std::string address, const rpc::TlsOptions& tls) : state_(std::make_unique<State>()) {
  state_->peer = "coordinator at " + address;
  state_->channel = rpc::create_channel(address, tls);
  state_->stub = v1::Coordinator::NewStub(state_->channel);
  state_->address = std::move(address);
}
Client::~Client() = default;
Client::Client(Client&&) noexcept = default;
Client& Client::operator=(Client&&) noexcept = default;

const std::string& Client::address() const { return state_->address; }

void Client::wait_ready(std::chrono::milliseconds timeout) const {
  rpc::wait_healthy(state_->channel, "pleat.v1.Coordinator", state_->address, timeout);
}

v1::Job Client::create_job(v1::CreateJobRequest request) const {
  if (request.job_id().empty()) request.set_job_id(random_id());
  v1::Job job;
  state_->call([&](grpc::ClientContext* context) { return state_->stub->CreateJob(context, request, &job); });
  return job;
}

v1::Job Client::get_job(const std::string& id) const {
  v1::GetJobRequest request;
  request.set_id(id);
  v1::Job job;
  state_->call([&](grpc::ClientContext* context) { return state_->stub->GetJob(context, request, &job); });
  return job;
}

v1::Job Client::cancel_job(const std::string& id) const {
  v1::CancelJobRequest request;
  request.set_id(id);
  v1::Job job;
  state_->call([&](grpc::ClientContext* context) { return state_->stub->CancelJob(context, request, &job); });
  return job;
}

std::vector<v1::Job> Client::list_jobs() const {
  v1::ListJobsResponse response;
  state_->call(
      [&](grpc::ClientContext* context) { return state_->stub->ListJobs(context, v1::ListJobsRequest(), &response); });
  return {response.jobs().begin(), response.jobs().end()};
}

bool Client::watch_job(const std::string& id, std::uint64_t from_index, bool include_frames,
                       const std::function<bool(const v1::JobEvent&)>& on_event) const {
  v1::WatchJobRequest request;
  request.set_id(id);
  request.set_from_index(from_index);
  request.set_include_frames(include_frames);
  grpc::ClientContext context;
  const auto reader = state_->stub->WatchJob(&context, request);
  v1::JobEvent event;
  while (reader->Read(&event)) {
    if (on_event(event)) continue;
    context.TryCancel();
    while (reader->Read(&event)) {
    }
    reader->Finish();
    return false;
  }
  rpc::throw_if_failed(reader->Finish(), state_->peer);
  return true;
}

EnhanceSession Client::enhance(const EnhanceOptions& options) const {
  v1::EnhanceRequest request;
  v1::EnhanceOpen* open = request.mutable_open();
  *open->mutable_coarse() = to_message(options.coarse);
  open->set_model(options.model);
  open->set_frame_time_s(options.frame_time_s);
  for (const ObstacleShape& shape : options.obstacles) *open->add_obstacles() = to_message(shape);
  if (options.clearance_m) open->set_clearance_m(*options.clearance_m);
  open->set_window(rpc::checked_window(options.window));
  open->set_skip_refinement(options.skip_refinement);
  open->set_subdivision_rounds(options.subdivision_rounds);

  auto session = std::make_unique<EnhanceSession::State>();
  session->stub = state_->stub;
  rpc::FrameStreamOptions stream;
  stream.peer = state_->peer;
  stream.window = rpc::checked_window(options.window);
  session->stream = std::make_unique<EnhanceSession::State::Stream>(
      [&](grpc::ClientContext* context) { return session->stub->Enhance(context); }, stream);
  session->opened = session->stream->open(request);
  if (session->opened.window() > 0 && session->opened.window() < stream.window) {
    throw_internal(state_->peer + ": the session's window is smaller than asked for");
  }
  session->fine = from_message(session->opened.fine(), "opened.fine");
  return EnhanceSession(std::move(session));
}

}  // namespace pleat
