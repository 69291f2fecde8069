#include "services/coordinator/live_session.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <random>
#include <set>
#include <span>
#include <system_error>
#include <thread>
#include <utility>

#include "common/base/checks.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "services/coordinator/fold_stage.hpp"
#include "services/coordinator/session_memory.hpp"
#include "services/coordinator/velocity_filler.hpp"

namespace pleat::coordinator {
namespace {

constexpr int kInvalidArgument = static_cast<int>(grpc::StatusCode::INVALID_ARGUMENT);

void check_obstacles(const v1::EnhanceOpen& open) {
  std::set<std::string> names;
  for (const auto& obstacle : open.obstacles()) {
    if (obstacle.name().empty()) throw_invalid_argument("open.obstacles: an obstacle without a name");
    if (!names.insert(obstacle.name()).second) {
      throw_invalid_argument("open.obstacles: '" + obstacle.name() + "' is there twice");
    }
  }
}

bool is_finite(const google::protobuf::RepeatedField<float>& values) {
  return all_finite(std::span<const float>(values.data(), static_cast<std::size_t>(values.size())));
}

/// What is wrong with a client's frame; empty if nothing.
std::string fault_of(const v1::Frame& frame, Eigen::Index vertices) {
  const auto size = static_cast<int>(3 * vertices);
  const auto expected = std::to_string(vertices) + " vertices (" + std::to_string(size) + " values)";
  if (frame.positions_size() != size) {
    return "positions: " + std::to_string(frame.positions_size()) + " values given, the session has " + expected;
  }
  if (frame.velocities_size() != 0 && frame.velocities_size() != size) {
    return "velocities: " + std::to_string(frame.velocities_size()) + " values given, the session has " + expected;
  }
  if (!is_finite(frame.positions())) return "positions: a value is not finite";
  if (!is_finite(frame.velocities())) return "velocities: a value is not finite";
  return {};
}

/// What a session looks like as a job. The id is random: that of a session before a restart must not be found again.
JobRecord record_of(const std::string& owner, const telemetry::TraceContext& trace) {
  std::random_device device;
  JobRecord record;
  record.id = kLivePrefix;
  for (int i = 0; i < 12; ++i) record.id += "0123456789abcdef"[device() % 16];
  record.state = JobState::kRunning;
  record.owner = owner;
  record.trace = trace;
  record.created_s = std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
  return record;
}

}  // namespace

/// What the frames of a session in flight may take of the memory for all, while it lives.
class LiveSessions::Share {
 public:
  /// Throws kResourceExhausted if there is not so much left.
  Share(LiveSessions& owner, std::uint32_t window, std::int64_t fine_vertices)
      : owner_(owner), bytes_(kCopies * window * static_cast<double>(fine_vertices) * kBytesPerVertex) {
    const std::lock_guard lock(owner_.mutex_);
    const double all = owner_.settings_.max_live_gb * 1e9;
    if (owner_.admitted_bytes_ + bytes_ > all) {
      throw Error(ErrorCode::kResourceExhausted,
                  "open: " + std::to_string(window) + " frames of " + std::to_string(fine_vertices) +
                      " fine vertices in flight are more than this coordinator has memory for now; ask for a smaller "
                      "window");
    }
    owner_.admitted_bytes_ += bytes_;
  }
  ~Share() {
    const std::lock_guard lock(owner_.mutex_);
    owner_.admitted_bytes_ -= bytes_;
  }
  Share(const Share&) = delete;
  Share& operator=(const Share&) = delete;

 private:
  static constexpr double kCopies = 5;           // frames per window: one between any two stages
  static constexpr double kBytesPerVertex = 24;  // positions, and velocities or an image of about that size
  LiveSessions& owner_;
  const double bytes_;
};

class LiveSessions::Session : public std::enable_shared_from_this<Session> {
 public:
  /// turn: which of several fold services it asks first.
  Session(LiveSessions& owner, grpc::CallbackServerContext* context, std::size_t turn, const std::string& client,
          const telemetry::TraceContext& trace)
      : owner_(owner),
        link_(owner.link_),
        turn_(turn),
        reactor_(Reactor::make(context)),
        feed_(std::make_shared<SessionFeed>(record_of(client, trace))),
        began_(std::chrono::steady_clock::now()) {
    link_.trace = trace;
  }

  Reactor* reactor() const { return reactor_.get(); }
  const std::shared_ptr<SessionFeed>& feed() const { return feed_; }

  /// The whole session, in its own thread.
  void run() {
    const telemetry::TraceScope trace(link_.trace);
    // A client may be found gone long after the session has ended.
    reactor_->on_gone([session = this->weak_from_this()] {
      if (const auto alive = session.lock()) alive->client_gone();
    });
    auto* metrics = link_.metrics;
    if (metrics != nullptr) metrics->add_sessions(1);
    const grpc::Status status = rpc::guard([&] { serve(); });
    const JobRecord last = feed_->record();
    if (!status.ok() && !is_gone()) {
      spdlog::warn("session {}: ended after {} frames: {}", last.id, last.frames_complete, status.error_message());
    } else {
      spdlog::info("session {}: ended after {} frames{}", last.id, last.frames_complete,
                   is_gone() ? ", the client has gone" : "");
    }
    feed_->update([&](JobRecord& record) {
      record.state = status.ok() ? JobState::kDone : is_gone() ? JobState::kCancelled : JobState::kFailed;
      if (record.state == JobState::kFailed) record.error = status.error_message();
    });
    reactor_->finish(status);
    if (metrics != nullptr) metrics->add_sessions(-1);
  }

  void drain() {
    set(draining_);
    reactor_->interrupt();
  }

 private:
  void serve() {
    const v1::EnhanceRequest* first = reactor_->read(milliseconds(owner_.settings_.open_timeout_s));
    if (first == nullptr) {
      if (reactor_->timed_out()) fail_slow("sent no `open`", owner_.settings_.open_timeout_s);
      if (reactor_->undecodable()) throw_invalid_argument(rpc::undecodable().error_message());
      return;
    }
    if (!first->has_open()) throw_invalid_argument("the first message of a stream must be `open`");
    const v1::EnhanceOpen open = first->open();
    window_ = rpc::checked_window(open.window());
    if (open.frame_time_s() < 0 || !std::isfinite(open.frame_time_s())) {
      throw_invalid_argument("open.frame_time_s: must be above 0");
    }
    if (open.has_clearance_m() && !(open.clearance_m() >= 0 && std::isfinite(open.clearance_m()))) {
      throw_invalid_argument("open.clearance_m: must be 0 or more");
    }
    if (open.has_subdivision_rounds() &&
        open.subdivision_rounds() > static_cast<std::uint32_t>(kMaxSubdivisionRounds)) {
      throw_invalid_argument("open.subdivision_rounds: at most " + std::to_string(kMaxSubdivisionRounds));
    }
    check_obstacles(open);
    const Topology coarse = from_message(open.coarse(), "open.coarse");
    validate_material_coordinates(coarse, "open.coarse");
    coarse_vertices_ = coarse.vertex_count();

    PipelineSession session;
    session.coarse = open.coarse();
    session.coarse.set_hash(topology_hash(coarse));
    session.detail = checked_detail(open.detail(), open.model(), "open.detail");
    if (is_simulated(session.detail)) {
      throw_invalid_argument("open.detail: '" + std::string(name_of(session.detail)) + "' is for jobs");
    }
    if (uses_network(session.detail)) {
      session.model = describe_model(owner_.addresses_, link_, open.model(), [this] { return is_gone(); });
      session.representation = session.model.representation();
      session.network_coarse = coarse_for_network(session.model, coarse);
    } else {
      session.model = without_model();
    }
    if (uses_fold(session.detail)) session.fold = fold_open_of(open);
    session.fold_turn = turn_;
    if (open.has_subdivision_rounds()) session.representation.set_subdivision_rounds(open.subdivision_rounds());
    if (open.has_subdivision_rule()) session.representation.set_subdivision_rule(open.subdivision_rule());
    const std::int64_t fine_vertices = admit(coarse_vertices_, subdivision_from(session.representation).rounds,
                                             owner_.settings_.max_vertices, "open.coarse");
    const Share share(owner_, window_, fine_vertices);
    session.obstacles = open.obstacles();
    if (open.has_clearance_m()) session.clearance_m = open.clearance_m();
    memory_.emplace(session, open.checkpoint_interval());
    if (!open.checkpoint().empty()) go_on(open.checkpoint(), session);
    session.skip_refinement = open.skip_refinement();
    session.window = window_;
    const Subdivision subdivision = subdivision_of(session, coarse, [&] {
      if (!uses_network(session.detail)) return;
      session.conversion = describe_conversion(owner_.addresses_, link_, session, [this] { return is_gone(); });
    });

    if (session.detail == v1::DETAIL_NONE) {
      session.upsampling = std::make_shared<const SmoothUpsampling>(coarse, subdivision);
    }
    EnhancementPipeline pipeline(
        owner_.addresses_, link_, session, static_cast<std::size_t>(subdivision.fine.vertex_count()),
        topology_hash(subdivision.fine), [this](std::unique_ptr<PipelineFrame> frame) { answer(*frame); },
        [this] { pipeline_failed(); });
    const Attachment attachment(*this, pipeline);
    pipeline.wait_open();
    write_opened(subdivision, session);
    feed_->update([&](JobRecord& record) {
      record.detail = name_of(session.detail);
      record.model = session.model.model();
      record.device = session.model.device();
      record.precision = session.model.precision();
      record.coarse_vertices = static_cast<std::uint32_t>(coarse_vertices_);
      record.fine_vertices = static_cast<std::uint32_t>(subdivision.fine.vertex_count());
    });
    spdlog::info("session {}: {} coarse and {} fine vertices, detail {}, from frame {}", feed_->record().id,
                 coarse_vertices_, subdivision.fine.vertex_count(), name_of(session.detail), session.first_sequence);
    const SessionFeed::Opened opened(*feed_, [&] { return opened_event(open, subdivision); });
    take_frames(pipeline, open.frame_time_s() > 0 ? open.frame_time_s() : kDefaultFrameTime, session);
    pipeline.close();
    pipeline.wait();
    if (reactor_->left_untaken()) fail_slow("did not take an answer", owner_.settings_.reader_timeout_s);
    if (silent_) fail_slow("sent no frame", owner_.settings_.idle_timeout_s);
    if (reactor_->undecodable()) throw_invalid_argument(rpc::undecodable().error_message());
    if (broken_sequence_) throw_invalid_argument("after `open` only frames may follow");
    if (is_draining()) throw Error(ErrorCode::kUnavailable, "the coordinator is stopping");
  }

  void write_opened(const Subdivision& subdivision, const PipelineSession& session) {
    v1::EnhanceResponse response;
    v1::EnhanceOpened& opened = *response.mutable_opened();
    *opened.mutable_fine() = to_message(subdivision.fine);
    opened.mutable_feature_vertices()->Assign(subdivision.feature_vertices.begin(), subdivision.feature_vertices.end());
    opened.set_model(session.model.model());
    opened.set_device(session.model.device());
    opened.set_precision(session.model.precision());
    opened.set_window(window_);
    opened.set_detail(session.detail);
    reactor_->share_memory(window_, milliseconds(owner_.settings_.reader_timeout_s));
    reactor_->write(response, milliseconds(owner_.settings_.reader_timeout_s));
  }

  static EventPtr opened_event(const v1::EnhanceOpen& open, const Subdivision& subdivision) {
    auto event = std::make_shared<v1::JobEvent>();
    v1::JobOpened& opened = *event->mutable_opened();
    *opened.mutable_coarse() = open.coarse();
    *opened.mutable_fine() = to_message(subdivision.fine);
    *opened.mutable_obstacles() = open.obstacles();
    return event;
  }

  static std::chrono::milliseconds milliseconds(double seconds) {
    return std::chrono::milliseconds(std::llround(seconds * 1e3));
  }
  [[noreturn]] static void fail_slow(const std::string& what, double seconds) {
    throw Error(ErrorCode::kDeadlineExceeded, "the client " + what + " for " + in_words(milliseconds(seconds)));
  }

  /// Takes up what an earlier session of the same kind left.
  void go_on(const std::string& checkpoint, PipelineSession& session) const {
    v1::SessionCheckpoint before = parse_checkpoint(checkpoint, session);
    for (const v1::Frame& frame : before.earlier()) {
      const std::string fault = fault_of(frame, coarse_vertices_);
      if (!fault.empty() || frame.velocities().empty())
        throw_invalid_argument("open.checkpoint: its frames are damaged");
      session.earlier.push_back(frame);
    }
    session.first_sequence = before.frames();
    if (!before.network_state().empty()) {
      auto left = std::make_shared<NetworkMemory>();
      left->sequence = before.frames() - 1;
      left->state.swap(*before.mutable_network_state());
      session.network_memory = std::move(left);
    }
    if (!before.has_fold()) return;
    auto left = std::make_shared<FoldMemory>();
    left->sequence = before.frames() - 1;
    left->state.Swap(before.mutable_fold());
    session.fold_memory = std::move(left);
  }

  /// Reads until the client has no more. At most `window` frames are unanswered. With the fold step the velocities are
  /// backward differences, whatever the client says.
  void take_frames(EnhancementPipeline& pipeline, double frame_time_s, const PipelineSession& session) {
    const bool differences = uses_fold(session.detail);
    VelocityFiller velocities(frame_time_s);
    for (const v1::Frame& frame : session.earlier) {
      velocities.fill(frame.index(), frame.positions().data(), static_cast<std::size_t>(frame.positions_size()));
    }
    for (std::uint64_t sequence = session.first_sequence; wait_for_room(); ++sequence) {
      const v1::EnhanceRequest* request = reactor_->read(milliseconds(owner_.settings_.idle_timeout_s));
      if (request == nullptr) {
        silent_ = reactor_->timed_out();
        return;
      }
      if (!request->has_frame()) {
        broken_sequence_ = true;
        return;
      }
      auto frame = std::make_unique<PipelineFrame>();
      frame->sequence = sequence;
      frame->coarse = request->frame().coarse();
      frame->index = frame->coarse.index();
      frame->obstacles = request->frame().obstacles();
      const std::string fault = fault_of(frame->coarse, coarse_vertices_);
      if (!fault.empty()) {
        frame->fail(kInvalidArgument, fault);
      } else {
        const auto& positions = frame->coarse.positions();
        const auto filled = velocities.fill(frame->index, positions.data(), static_cast<std::size_t>(positions.size()));
        if (differences || frame->coarse.velocities().empty())
          frame->coarse.mutable_velocities()->Assign(filled.begin(), filled.end());
        memory_->remember(sequence, frame->coarse);
      }
      if (!pipeline.push(std::move(frame))) return;
    }
  }

  bool wait_for_room() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return in_flight_ < window_ || gone_ || draining_ || failed_; });
    if (gone_ || draining_ || failed_) return false;
    ++in_flight_;
    return true;
  }

  void answer(PipelineFrame& frame) {
    v1::EnhanceResponse response;
    response.set_checkpoint(memory_->checkpoint(frame));
    if (frame.error) {
      *response.mutable_error() = *frame.error;
    } else {
      v1::EnhancedFrame& enhanced = *response.mutable_frame();
      enhanced.mutable_fine()->Swap(&frame.fine);
      enhanced.mutable_fine()->set_index(frame.index);
      enhanced.mutable_fine()->set_time_s(frame.coarse.time_s());
      enhanced.mutable_report()->Swap(&frame.report);
      if (frame.fold.steps() > 0) enhanced.mutable_fold()->Swap(&frame.fold);
      enhanced.mutable_stage_times()->Swap(&frame.stage_times);
    }
    const bool written = reactor_->write(response, milliseconds(owner_.settings_.reader_timeout_s));
    if (!written && reactor_->timed_out()) {
      fail_slow("did not take an answer", owner_.settings_.reader_timeout_s);
    }
    show(frame, response);
    {
      const std::lock_guard lock(mutex_);
      --in_flight_;
    }
    changed_.notify_all();
    if (!written) throw Error(ErrorCode::kCancelled, "the client has gone");
  }

  /// An answered frame to those who watch. Here alone: one answer at a time.
  void show(PipelineFrame& frame, const v1::EnhanceResponse& response) {
    if (feed_->is_watched()) {
      auto event = std::make_shared<v1::JobEvent>();
      if (response.has_error()) {
        *event->mutable_error() = response.error();
        event->mutable_error()->set_index(frame.sequence);
      } else {
        v1::EnhancedFrame& enhanced = *event->mutable_frame();
        enhanced = response.frame();
        enhanced.mutable_coarse()->Swap(&frame.coarse);
        enhanced.mutable_coarse()->clear_velocities();
        // Clients number as they like; for those who watch it is the place in the session.
        enhanced.mutable_fine()->set_index(frame.sequence);
        enhanced.mutable_coarse()->set_index(frame.sequence);
        enhanced.mutable_obstacles()->Swap(&frame.obstacles);
      }
      feed_->publish(std::move(event));
    }
    const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - began_;
    feed_->update([&](JobRecord& record) {
      ++record.frames_complete;
      record.wall_s = wall.count();
      if (response.has_error()) ++record.frame_errors;
      record.penetrations += response.frame().report().penetrations_after();
      record.self_intersections += response.frame().report().self_intersections_after();
    });
  }

  void client_gone() {
    set(gone_);
    {
      const std::lock_guard lock(attachment_mutex_);
      if (pipeline_ != nullptr) pipeline_->fail(Error(ErrorCode::kCancelled, "the client has gone"));
    }
    reactor_->interrupt();
  }

  void pipeline_failed() {
    set(failed_);
    reactor_->interrupt();
  }

  void set(bool& flag) {
    {
      const std::lock_guard lock(mutex_);
      flag = true;
    }
    changed_.notify_all();
  }

  bool is_gone() {
    const std::lock_guard lock(mutex_);
    return gone_;
  }
  bool is_draining() {
    const std::lock_guard lock(mutex_);
    return draining_;
  }

  /// While it lives, a client that goes ends the pipeline.
  class Attachment {
   public:
    Attachment(Session& session, EnhancementPipeline& pipeline) : session_(session) {
      const std::lock_guard lock(session_.attachment_mutex_);
      session_.pipeline_ = &pipeline;
      if (session_.is_gone()) pipeline.fail(Error(ErrorCode::kCancelled, "the client has gone"));
    }
    ~Attachment() {
      const std::lock_guard lock(session_.attachment_mutex_);
      session_.pipeline_ = nullptr;
    }
    Attachment(const Attachment&) = delete;
    Attachment& operator=(const Attachment&) = delete;

   private:
    Session& session_;
  };

  LiveSessions& owner_;
  LinkOptions link_;  ///< with the session's trace
  const std::size_t turn_;
  std::shared_ptr<Reactor> reactor_;
  const std::shared_ptr<SessionFeed> feed_;
  const std::chrono::steady_clock::time_point began_;
  std::uint32_t window_ = rpc::kDefaultWindow;
  Eigen::Index coarse_vertices_ = 0;
  std::optional<SessionMemory> memory_;  ///< before the pipeline's first frame
  bool broken_sequence_ = false, silent_ = false;
  std::mutex attachment_mutex_;  ///< before mutex_
  EnhancementPipeline* pipeline_ = nullptr;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::uint32_t in_flight_ = 0;
  bool gone_ = false, draining_ = false, failed_ = false;
};

LiveSessions::LiveSessions(ServiceAddresses addresses, LinkOptions link, LiveSettings settings)
    : addresses_(std::move(addresses)),
      link_(std::move(link)),
      settings_(settings),
      quota_("live sessions", settings.max_sessions, settings.max_sessions_each) {}

LiveSessions::~LiveSessions() {
  drain();
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return sessions_.empty(); });
}

bool LiveSessions::has_room() const {
  const std::lock_guard lock(mutex_);
  return sessions_.size() < settings_.max_sessions;
}

std::vector<std::shared_ptr<SessionFeed>> LiveSessions::feeds() const {
  std::vector<std::shared_ptr<SessionFeed>> feeds;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& session : sessions_) feeds.push_back(session->feed());
  }
  std::sort(feeds.begin(), feeds.end(),
            [](const auto& a, const auto& b) { return a->record().created_s > b->record().created_s; });
  return feeds;
}

std::shared_ptr<SessionFeed> LiveSessions::feed(const std::string& id) const {
  for (auto& feed : feeds()) {
    if (feed->record().id == id) return std::move(feed);
  }
  throw_not_found("no live session '" + id + "'");
}

LiveSessions::Reactor* LiveSessions::start(grpc::CallbackServerContext* context, const std::string& client,
                                           const telemetry::TraceContext& trace) {
  const std::lock_guard lock(mutex_);
  const grpc::Status admitted = rpc::guard([&] {
    if (draining_) throw Error(ErrorCode::kUnavailable, "the coordinator is stopping");
    quota_.enter(client);
  });
  if (!admitted.ok()) {
    auto refused = Reactor::make(context);
    refused->refuse(admitted);
    return refused.get();
  }
  auto session = std::make_shared<Session>(*this, context, started_++, client, trace);
  sessions_.insert(session);
  Reactor* reactor = session->reactor();
  try {
    std::thread([this, session, client]() mutable {
      session->run();
      const std::lock_guard ended(mutex_);
      quota_.leave(client);
      sessions_.erase(session);
      session.reset();
      changed_.notify_all();
    }).detach();
  } catch (const std::system_error&) {
    quota_.leave(client);
    sessions_.erase(session);
    reactor->refuse({grpc::StatusCode::UNAVAILABLE, "this host has no thread to spare"});
  }
  return reactor;
}

void LiveSessions::drain() {
  const std::lock_guard lock(mutex_);
  draining_ = true;
  for (const auto& session : sessions_) session->drain();
}

}  // namespace pleat::coordinator
