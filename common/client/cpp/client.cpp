#include "common/client/cpp/client.hpp"

#include <deque>
#include <random>
#include <thread>

#include "common/client/cpp/call_metadata.hpp"
#include "common/client/cpp/messages.hpp"
#include "common/client/cpp/session_stream.hpp"
#include "common/rpc/caller.hpp"
#include "common/rpc/status.hpp"
#include "common/scene/animation_parts.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"

namespace pleat::client {
namespace {

using namespace std::chrono_literals;

constexpr auto kCallTimeout = 30s;
constexpr auto kPartTimeout = 1s;  // more for every part of an animation
constexpr auto kFirstBackoff = 100ms;
constexpr int kAttempts = 3;

constexpr std::size_t kNameInId = 40;

std::string random_id(const std::string& scene) {
  std::random_device device;
  std::string id = (scene.empty() ? "job" : scene.substr(0, kNameInId)) + "-";
  for (int i = 0; i < 16; ++i) id += "0123456789abcdef"[device() % 16];
  return id;
}

}  // namespace

struct EnhanceSession::State {
  std::string peer;
  std::shared_ptr<v1::Coordinator::Stub> stub;
  std::unique_ptr<SessionStream> stream;
  SessionInfo info;
  v1::EnhanceResponse response;  ///< reused by the popping thread

  SessionStream::Request request_of(const CoarseFrame& frame) const {
    SessionStream::Request request = stream->spare();
    to_message(frame, request->mutable_frame());
    return request;
  }
};

EnhanceSession::EnhanceSession(std::unique_ptr<State> state) : state_(std::move(state)) {}
EnhanceSession::EnhanceSession(EnhanceSession&&) noexcept = default;
EnhanceSession& EnhanceSession::operator=(EnhanceSession&&) noexcept = default;
EnhanceSession::~EnhanceSession() = default;

const SessionInfo& EnhanceSession::info() const { return state_->info; }

void EnhanceSession::push(const CoarseFrame& frame) { state_->stream->push(state_->request_of(frame)); }

bool EnhanceSession::try_push(const CoarseFrame& frame) {
  SessionStream::Request request = state_->request_of(frame);
  return state_->stream->try_push(request);
}

std::optional<EnhancedFrame> EnhanceSession::pop() {
  const v1::EnhanceResponse& response = state_->response;
  if (!state_->stream->pop(&state_->response)) return std::nullopt;
  if (response.has_error()) return from_message(response.error());
  return from_message(response.frame(), state_->info.fine.vertex_count());
}

void EnhanceSession::close() { state_->stream->close(); }
void EnhanceSession::cancel() { state_->stream->cancel(); }

void EnhanceSession::run(std::uint64_t count, const Input& input, const Sink& sink) {
  std::deque<CoarseFrame> waiting;  // inputs without an answer, bounded by the window
  std::uint64_t sent = 0;
  SessionStream::Request request;  // frame `sent`, if it did not fit into the window
  for (std::uint64_t answered = 0; answered < count; ++answered) {
    while (sent < count) {
      if (!request) {
        waiting.push_back(input(sent));
        request = state_->request_of(waiting.back());
      }
      if (!state_->stream->try_push(request)) break;
      ++sent;
    }
    if (sent == count) close();
    const std::optional<EnhancedFrame> answer = pop();
    if (!answer) {
      throw Error(ErrorCode::kUnavailable, state_->peer + " ended the session after " + std::to_string(answered) +
                                               " of " + std::to_string(count) + " frames");
    }
    sink(*answer, waiting.front());
    waiting.pop_front();
  }
  close();
  // The session ends well on both sides before it goes.
  if (pop()) throw_internal(state_->peer + " sent more frames than it was asked for");
}

struct Client::State {
  std::string address;
  std::string peer;
  std::shared_ptr<grpc::Channel> channel;
  std::shared_ptr<v1::Coordinator::Stub> stub;
  CallMetadata metadata;  ///< of every call

  /// One unary call, repeated with growing pauses while nobody answers.
  template <typename Call>
  void call(Call&& make, std::chrono::seconds timeout = kCallTimeout) const {
    auto pause = std::chrono::milliseconds(kFirstBackoff);
    for (int attempt = 1;; ++attempt) {
      grpc::ClientContext context;
      context.set_deadline(std::chrono::system_clock::now() + timeout);
      metadata.add_to(context);
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

Client::Client(std::string address, const rpc::TlsOptions& tls, const std::string& traceparent)
    : state_(std::make_unique<State>()) {
  state_->peer = "coordinator at " + address;
  state_->channel = rpc::create_channel(address, tls);
  state_->stub = v1::Coordinator::NewStub(state_->channel);
  if (!tls.token_file.empty()) state_->metadata.authorization = rpc::kTokenPrefix + rpc::read_token(tls.token_file);
  if (!traceparent.empty()) {
    const auto trace = telemetry::parse_traceparent(traceparent);
    if (!trace) throw_invalid_argument("traceparent '" + traceparent + "': is none of the W3C trace context");
    state_->metadata.trace = *trace;
  }
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
  if (request.job_id().empty()) request.set_job_id(random_id(request.scene().name()));
  v1::Job job;
  const std::vector<v1::AnimationPart> parts = take_animations(*request.mutable_scene());
  if (parts.empty()) {
    state_->call([&](grpc::ClientContext* context) { return state_->stub->CreateJob(context, request, &job); });
    return job;
  }
  const auto create = [&](grpc::ClientContext* context) {
    const auto writer = state_->stub->CreateJobInParts(context, &job);
    v1::CreateJobPart part;
    *part.mutable_request() = request;
    bool sent = writer->Write(part);
    for (std::size_t i = 0; sent && i < parts.size(); ++i) {
      *part.mutable_animation() = parts[i];
      sent = writer->Write(part);
    }
    if (sent) writer->WritesDone();
    return writer->Finish();
  };
  state_->call(create, kCallTimeout + kPartTimeout * static_cast<long>(parts.size()));
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

v1::Job Client::remove_job(const std::string& id) const {
  v1::RemoveJobRequest request;
  request.set_id(id);
  v1::Job job;
  state_->call([&](grpc::ClientContext* context) { return state_->stub->RemoveJob(context, request, &job); });
  return job;
}

std::vector<v1::Job> Client::list_jobs(bool live_sessions) const {
  v1::ListJobsRequest request;
  request.set_live_sessions(live_sessions);
  v1::ListJobsResponse response;
  state_->call([&](grpc::ClientContext* context) { return state_->stub->ListJobs(context, request, &response); });
  return {response.jobs().begin(), response.jobs().end()};
}

JobWatcher Client::watch_job(const std::string& id, JobSinks sinks, const JobWatchOptions& options) const {
  return JobWatcher(state_->channel, state_->peer, state_->metadata, id, std::move(sinks), options);
}

EnhanceSession Client::enhance(const EnhanceOptions& options) const {
  v1::EnhanceRequest request;
  v1::EnhanceOpen* open = request.mutable_open();
  to_message(options.coarse, open->mutable_coarse());
  open->set_model(options.model);
  open->set_frame_time_s(options.frame_time_s);
  for (const ObstacleShape& shape : options.obstacles) to_message(shape, open->add_obstacles());
  if (options.clearance_m) open->set_clearance_m(*options.clearance_m);
  open->set_window(rpc::checked_window(options.window));
  open->set_skip_refinement(options.skip_refinement);
  if (options.subdivision_rounds) open->set_subdivision_rounds(*options.subdivision_rounds);
  open->set_detail(options.detail);
  if (!options.material_json.empty()) open->mutable_material()->set_json(options.material_json);
  if (!options.held.empty()) {
    open->add_handles()->mutable_vertices()->Assign(options.held.begin(), options.held.end());
  }
  if (options.wind_m_s != std::array<double, 3>{}) {
    open->mutable_wind()->mutable_velocity()->Assign(options.wind_m_s.begin(), options.wind_m_s.end());
  }

  auto session = std::make_unique<EnhanceSession::State>();
  session->peer = state_->peer;
  session->stub = state_->stub;
  SessionStream::Options stream;
  stream.stream.peer = state_->peer;
  stream.stream.window = open->window();
  stream.stream.same_host = rpc::is_unix_address(state_->address);
  stream.patience = options.patience;
  stream.away = options.away;
  const std::uint32_t window = open->window();
  session->stream = std::make_unique<SessionStream>(
      [stub = state_->stub, metadata = state_->metadata](auto* context, auto* call) {
        metadata.add_to(*context);
        stub->async()->Enhance(context, call);
      },
      std::move(stream), std::move(request));
  const v1::EnhanceOpened& opened = session->stream->opened();
  if (opened.window() > 0 && opened.window() < window) {
    throw_internal(state_->peer + ": the session's window is smaller than asked for");
  }
  session->info = {from_message(opened.fine(), "opened.fine"),
                   {opened.feature_vertices().begin(), opened.feature_vertices().end()},
                   opened.model(),
                   opened.device(),
                   opened.precision(),
                   // An older coordinator says nothing, and has a network.
                   opened.detail() == v1::DETAIL_UNSPECIFIED ? v1::DETAIL_NETWORK : opened.detail()};
  return EnhanceSession(std::move(session));
}

}  // namespace pleat::client
