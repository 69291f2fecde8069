// A stage that runs in other processes: one frame stream per replica, reconnected when it breaks, its frames sent
// again.
#pragma once

#include <grpcpp/channel.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "common/base/error.hpp"
#include "common/rpc/channel.hpp"
#include "common/rpc/priority.hpp"
#include "common/rpc/status.hpp"
#include "common/rpc/stream.hpp"
#include "common/rpc/trace.hpp"
#include "common/telemetry/metrics.hpp"
#include "services/coordinator/backoff.hpp"
#include "services/coordinator/pipeline_frame.hpp"
#include "services/coordinator/replica_choice.hpp"
#include "services/coordinator/replica_directory.hpp"
#include "services/coordinator/stage_scheduler.hpp"

namespace pleat::coordinator {

/// How to reach services, and how long to try.
struct LinkOptions {
  std::function<std::shared_ptr<grpc::Channel>(const std::string& address)> connect;
  std::chrono::milliseconds give_up{30'000};               ///< a service that is away this long fails its sessions
  std::chrono::milliseconds open_timeout{60'000};          ///< for `opened`; maps and factorisations are made then
  std::chrono::milliseconds answer_timeout{60'000};        ///< for one frame; afterwards the stream counts as broken
  telemetry::Metrics* metrics = nullptr;                   ///< may be null
  std::shared_ptr<ReplicaDirectory> replicas = {};         ///< behind names; null: addresses are what they are
  std::shared_ptr<const std::atomic<bool>> stopping = {};  ///< then what breaks off is not tried again; may be null
  telemetry::TraceContext trace = {};                      ///< that all calls belong to
  bool background = false;                                 ///< work that may wait for others'
};

/// What the services are told of a call's origin.
inline void add_origin(grpc::ClientContext& context, const LinkOptions& link) {
  rpc::add_trace(context, link.trace);
  if (link.background) rpc::add_background(context);
}

using rpc::may_pass;

/// "30 s", or "1500 ms" where seconds would lie.
inline std::string in_words(std::chrono::milliseconds time) {
  return time.count() % 1000 == 0 ? std::to_string(time.count() / 1000) + " s" : std::to_string(time.count()) + " ms";
}

/// Decides when a service that fails has failed for too long: from the first failure after it last served. Thread-safe.
class Outage {
 public:
  using Clock = std::chrono::steady_clock;
  explicit Outage(std::chrono::milliseconds give_up) : give_up_(give_up) {}

  void serves() { since_ = kNever; }
  /// To be asked at every failure.
  bool too_long() {
    const Clock::rep now = Clock::now().time_since_epoch().count();
    Clock::rep since = kNever;
    if (since_.compare_exchange_strong(since, now)) since = now;
    return Clock::duration(now - since) > give_up_;
  }
  /// The error to fail with: the last cause (it names service and address), and how long was tried.
  Error gave_up(const Error& cause) const {
    return Error(ErrorCode::kUnavailable, std::string(cause.what()) + "; gave up after " + in_words(give_up_));
  }

 private:
  static constexpr Clock::rep kNever = 0;
  std::chrono::milliseconds give_up_;
  std::atomic<Clock::rep> since_{kNever};
};

class Stage {
 public:
  virtual ~Stage() = default;
  virtual bool push(std::unique_ptr<PipelineFrame> frame) = 0;  ///< with work, or with an error to pass on
  virtual void close() = 0;
  virtual void start() = 0;  ///< connects; callbacks come from now on
  virtual void stop() = 0;   ///< returns at once; everything in flight is dropped
  virtual void join() = 0;   ///< after stop() or when drained: waits until no callback can come any more
};

/// A stage whose frames depend on the one before: Rpc has a Memory, memory_of(frame) after absorb(), and
/// resumed(request, memory) for the first request of a stream that is opened again. Its frames go through one replica,
/// the next one in the list when that breaks off.
template <typename Rpc>
concept Sequential = requires {
  typename Rpc::Memory;
};

namespace detail {
struct NoMemory {};
template <typename Rpc>
struct MemoryOf {
  using type = NoMemory;
};
template <Sequential Rpc>
struct MemoryOf<Rpc> {
  using type = typename Rpc::Memory;
};
}  // namespace detail

/// One stream for each replica behind the addresses. Where these are names, replicas that come get a stream at the next
/// frame, and those that go no more frames; their stream ends when they have answered.
/// Rpc: Service, Request, Response, start(stub, context), take_back(PipelineFrame&) of what the request was lent, once
/// nobody sends it any more, and absorb(PipelineFrame&, Response::frame*).
template <typename Rpc>
class RemoteStage final : public Stage {
 public:
  using Request = typename Rpc::Request;
  using Response = typename Rpc::Response;
  using Stream = rpc::FrameStream<Request, Response>;
  using Opened = std::decay_t<decltype(std::declval<const Response&>().opened())>;
  using MemoryPtr = std::shared_ptr<const typename detail::MemoryOf<Rpc>::type>;

  struct Options {
    std::string stage;    ///< "to_image", in metrics
    std::string service;  ///< "conversion", in messages
    std::vector<std::string> addresses;
    Request open;
    std::uint32_t window = rpc::kDefaultWindow;
    std::uint64_t first_sequence = 0;
    LinkOptions link;
    MemoryPtr memory = {};  ///< of the frame before the first, if that is known; of a sequential stage
    std::size_t turn = 0;   ///< which replica a sequential stage begins with
  };
  struct Callbacks {
    std::function<void(const Opened&)> opened;  ///< every time a replica opened; an Error fails the session, with the
                                                ///< peer before its message
    std::function<void(std::unique_ptr<PipelineFrame>)> deliver;
    std::function<void()> drained;
    std::function<void(const Error&)> failed;
  };

  RemoteStage(Options options, Callbacks callbacks)
      : options_(std::move(options)),
        callbacks_(std::move(callbacks)),
        outage_(options_.link.give_up),
        memory_(options_.memory),
        choice_(options_.link.replicas, options_.turn),
        scheduler_({.replicas = slot_count(), .window = options_.window}, options_.first_sequence, callbacks_.deliver,
                   callbacks_.drained),
        links_(slot_count()),
        slots_(slot_count()) {
    for (std::size_t r = 0; r < slots_.size(); ++r) scheduler_.use(r, false);
  }

  ~RemoteStage() override {
    stop();
    join();
  }

  void start() override {
    if constexpr (Sequential<Rpc>) {
      const std::lock_guard lock(mutex_);
      occupy(0, "");  // it has its address when it connects
    } else {
      refresh();
    }
  }

  void join() override {
    {
      // Open streams close in good order; attempts to connect need not end any more.
      const std::lock_guard lock(mutex_);
      joining_ = true;
      for (std::size_t r = 0; r < links_.size(); ++r) {
        if (links_[r].stream != nullptr && !scheduler_.live(r)) links_[r].stream->cancel();
      }
    }
    // Nobody begins another thread now.
    for (Slot& slot : slots_) {
      if (slot.thread.joinable()) slot.thread.join();
    }
  }

  bool push(std::unique_ptr<PipelineFrame> frame) override {
    if (frame->error) return scheduler_.pass(std::move(frame));
    if constexpr (!Sequential<Rpc>) refresh();
    typename Scheduler::Direct direct;
    if (!scheduler_.push(std::move(frame), &direct)) return false;
    if (direct.work) send_direct(std::move(direct));
    return true;
  }
  void close() override { scheduler_.close(); }
  void stop() override {
    scheduler_.stop();
    const std::lock_guard lock(mutex_);
    for (const Link& link : links_) {
      if (link.stream != nullptr) link.stream->cancel();
    }
  }

 private:
  using Clock = std::chrono::steady_clock;
  using Scheduler = StageScheduler<PipelineFrame>;

  /// To a replica. It lasts as long as the scheduler lets somebody send.
  struct Link {
    Stream* stream = nullptr;
    bool begun = false;            ///< a request was sent
    std::optional<Error> failure;  ///< of who sent in the sender's place
    std::atomic<int> in_flight{0};
    std::shared_ptr<ReplicaLoad> load;  ///< of the replica; null: not known
  };

  /// A place for a replica, and the thread that serves it.
  struct Slot {
    std::string address;  ///< constant while a stream is open
    bool used = false, leaving = false;
    std::thread thread;
  };
  /// Where names may get more replicas; more than that get no stream.
  static constexpr std::size_t kMaxReplicas = 64;

  /// In the metrics: what a stream may have in flight, and has.
  class Window {
   public:
    Window(const Options& options, Link& link) : options_(options), link_(link) {
      add(static_cast<int>(options.window));
    }
    ~Window() {
      add(-static_cast<int>(options_.window));
      const int left = link_.in_flight.exchange(0);
      if (link_.load) link_.load->frames -= left;
      if (options_.link.metrics != nullptr) options_.link.metrics->add_inflight(options_.stage, -left);
    }
    Window(const Window&) = delete;
    Window& operator=(const Window&) = delete;

   private:
    void add(int frames) {
      if (options_.link.metrics != nullptr) options_.link.metrics->add_window(options_.stage, frames);
    }
    const Options& options_;
    Link& link_;
  };

  std::size_t slot_count() const {
    if (Sequential<Rpc>) return 1;
    return options_.link.replicas ? kMaxReplicas : options_.addresses.size();
  }
  std::vector<std::string> replicas() const { return replicas_behind(options_.link.replicas, options_.addresses); }
  const std::string& address(std::size_t r) const { return slots_[r].address; }
  std::string peer(std::size_t r) const { return options_.service + " at " + address(r); }

  /// With the mutex.
  void occupy(std::size_t r, const std::string& address) {
    Slot& slot = slots_[r];
    if (slot.thread.joinable()) slot.thread.join();  // it has left its slot, which is the last thing it does
    slot.address = address;
    slot.used = true;
    slot.leaving = false;
    scheduler_.use(r, true);
    slot.thread = std::thread([this, r] { run(r); });
  }

  /// A slot for each replica that has none, and none for those that are gone. Cheap where nothing changed.
  void refresh() {
    const std::uint64_t version = options_.link.replicas ? options_.link.replicas->version() : 1;
    if (version == seen_version_) return;
    const std::vector<std::string> wanted = replicas();
    const std::lock_guard lock(mutex_);
    if (joining_ || scheduler_.finished()) return;
    // The first look may have made a new version itself.
    seen_version_ = version;
    for (std::size_t r = 0; r < slots_.size(); ++r) {
      Slot& slot = slots_[r];
      if (!slot.used || slot.leaving || std::count(wanted.begin(), wanted.end(), slot.address) > 0) continue;
      slot.leaving = true;
      scheduler_.leave(r);
    }
    for (const std::string& address : wanted) {
      const auto serves = [&](const Slot& slot) { return slot.used && !slot.leaving && slot.address == address; };
      // An address that is configured twice gets two streams.
      if (std::count_if(slots_.begin(), slots_.end(), serves) >= std::count(wanted.begin(), wanted.end(), address))
        continue;
      const auto free = std::find_if(slots_.begin(), slots_.end(), [](const Slot& slot) { return !slot.used; });
      if (free != slots_.end()) occupy(static_cast<std::size_t>(free - slots_.begin()), address);
    }
  }

  bool no_more_comes(std::size_t r) {
    const std::lock_guard lock(mutex_);
    return scheduler_.drained() || slots_[r].leaving;
  }

  /// True, and the slot is free, if its replica is gone.
  bool left(std::size_t r) {
    const std::lock_guard lock(mutex_);
    if (!slots_[r].leaving) return false;
    scheduler_.use(r, false);
    slots_[r].used = false;
    return true;
  }

  void run(std::size_t r) {
    const telemetry::TraceScope trace(options_.link.trace);
    Backoff backoff;
    while (!scheduler_.finished()) {
      bool answered = false;
      if constexpr (Sequential<Rpc>) {
        slots_[r].address = choice_.next(replicas());
      }
      const auto cause = session(r, answered);
      if (!cause || scheduler_.finished()) return;
      if (answered)
        spdlog::warn("stage {}: {}; what it has not answered goes elsewhere", options_.stage, cause->what());
      if (!may_pass(cause->code())) {
        callbacks_.failed(*cause);
        return;
      }
      if (answered) backoff.reset();
      if (auto frame = scheduler_.broke_off(r)) {
        Rpc::take_back(*frame);
        frame->work.reset();
        frame->fail(static_cast<int>(grpc::StatusCode::INTERNAL),
                    "the stage broke off again and again at this frame: " + std::string(cause->what()));
        scheduler_.complete(std::move(frame));
      }
      if constexpr (!Sequential<Rpc>) {
        refresh();
        if (left(r)) return;
      }
      const bool stopping = options_.link.stopping && *options_.link.stopping;
      if (scheduler_.live() == 0 && (stopping || outage_.too_long())) {
        callbacks_.failed(stopping ? *cause : outage_.gave_up(*cause));
        return;
      }
      if (options_.link.metrics != nullptr) options_.link.metrics->count("reconnects");
      if (Sequential<Rpc> && answered) choice_.served();
      scheduler_.wait_finished(backoff.next());
    }
  }

  /// One connection, from connecting to its end. Returns why it broke, or nothing if the stage is finished.
  std::optional<Error> session(std::size_t r, bool& answered) {
    try {
      const auto load = options_.link.replicas ? options_.link.replicas->load_of(address(r)) : nullptr;
      const LoadShare share(Sequential<Rpc> ? load : nullptr, &ReplicaLoad::sessions);
      links_[r].load = load;
      // A new channel for each attempt: an old one waits by a schedule of its own before it connects again.
      const auto stub = Rpc::Service::NewStub(options_.link.connect(address(r)));
      Stream stream(
          [&](auto* context, auto* call) {
            add_origin(*context, options_.link);
            Rpc::start(*stub, context, call);
          },
          {.peer = peer(r),
           .window = options_.window,
           .open_timeout = options_.link.open_timeout,
           .frame_timeout = options_.link.answer_timeout,
           .same_host = rpc::is_unix_address(address(r))});
      const Registration registration(*this, r, stream);
      const auto opened = stream.open(options_.open);
      const auto since = Clock::now();
      if (!accept(r, opened)) return std::nullopt;
      links_[r].begun = false;
      const Window window(options_, links_[r]);
      scheduler_.connected(r, load ? std::shared_ptr<const std::atomic<int>>(load, &load->frames) : nullptr);
      auto cause = exchange(r, stream, answered);
      // A stream that served, or that idled for a while, was no failed attempt: the outage begins now.
      if (answered || Clock::now() - since > std::chrono::seconds(1)) outage_.serves();
      return cause;
    } catch (const Error& e) {
      return e;
    } catch (const std::exception& e) {
      return Error(ErrorCode::kInternal, peer(r) + ": " + e.what());
    }
  }

  bool accept(std::size_t r, const Opened& opened) {
    try {
      if (callbacks_.opened) callbacks_.opened(opened);
      return true;
    } catch (const Error& e) {
      callbacks_.failed(Error(e.code(), peer(r) + ": " + e.what()));
      return false;
    }
  }

  /// One thread at a time, as the scheduler says.
  void send(std::size_t r, std::shared_ptr<const google::protobuf::Message> work) {
    Link& link = links_[r];
    if constexpr (Sequential<Rpc>) {
      if (!link.begun && memory_) work = Rpc::resumed(std::move(work), *memory_);
    }
    link.begun = true;
    ++link.in_flight;
    if (link.load) ++link.load->frames;
    if (options_.link.metrics != nullptr) options_.link.metrics->add_inflight(options_.stage, 1);
    link.stream->push(static_cast<const Request&>(*work));
  }

  /// In the thread that had the frame before: a frame that finds the replica idle waits for no thread to wake up. What
  /// fails ends the stream; its frames are sent again then.
  void send_direct(typename Scheduler::Direct direct) {
    const std::size_t r = direct.replica;
    std::optional<Error> failure;
    try {
      send(r, std::move(direct.work));
    } catch (const Error& e) {
      failure = e;
    } catch (const std::exception& e) {
      failure = Error(ErrorCode::kInternal, peer(r) + ": " + e.what());
    }
    if (failure) {
      const std::lock_guard lock(mutex_);
      links_[r].failure = failure;
      links_[r].stream->cancel();
    }
    scheduler_.sent(r);
  }

  std::optional<Error> exchange(std::size_t r, Stream& stream, bool& answered) {
    std::optional<Error> read_failure, write_failure;
    std::mutex mutex;
    std::condition_variable ended;
    bool reading = true;
    std::thread reader([&] {
      const telemetry::TraceScope trace(options_.link.trace);
      try {
        receive(r, stream, answered);
      } catch (const Error& e) {
        read_failure = e;
        stream.cancel();
      } catch (const std::exception& e) {
        read_failure = Error(ErrorCode::kInternal, peer(r) + ": " + e.what());
        stream.cancel();
      }
      scheduler_.disconnected(r);
      const std::lock_guard lock(mutex);
      reading = false;
      ended.notify_all();
    });
    try {
      while (auto work = scheduler_.take(r)) send(r, std::move(work));
      if (no_more_comes(r)) stream.close();
    } catch (const Error& e) {
      write_failure = e;
    }
    {
      // At the end the service gets a moment to close its side in good order.
      std::unique_lock lock(mutex);
      if (!ended.wait_for(lock, std::chrono::seconds(no_more_comes(r) ? 1 : 0), [&] { return !reading; })) {
        stream.cancel();
      }
    }
    reader.join();
    scheduler_.wait_sent(r);
    if (!write_failure) write_failure = std::exchange(links_[r].failure, std::nullopt);
    if (scheduler_.finished()) return std::nullopt;
    if (read_failure && read_failure->code() != ErrorCode::kCancelled) return read_failure;
    if (write_failure) return write_failure;
    return Error(ErrorCode::kUnavailable, peer(r) + " ended the stream");
  }

  void receive(std::size_t r, Stream& stream, bool& answered) {
    Response response;
    while (stream.pop(&response)) {
      const bool ok = response.has_frame();
      if (!ok && !response.has_error()) {
        throw Error(ErrorCode::kInternal, peer(r) + " sent a message that is no answer to a frame");
      }
      const std::uint64_t index = ok ? rpc::frame_index(response.frame()) : response.error().index();
      std::chrono::duration<double> round_trip{};
      auto frame = scheduler_.answered(r, index, round_trip);
      if (!frame) {
        throw Error(ErrorCode::kInternal,
                    peer(r) + " answered frame " + std::to_string(index) + ", which it was not sent");
      }
      answered = true;
      outage_.serves();
      Rpc::take_back(*frame);
      frame->work.reset();
      if (ok) {
        Rpc::absorb(*frame, *response.mutable_frame());
        if constexpr (Sequential<Rpc>) memory_ = Rpc::memory_of(*frame);
      } else {
        frame->fail(response.error().code(), options_.stage + ": " + response.error().message());
      }
      --links_[r].in_flight;
      if (links_[r].load) --links_[r].load->frames;
      if (options_.link.metrics != nullptr) {
        options_.link.metrics->add_inflight(options_.stage, -1);
        options_.link.metrics->frame_done(options_.stage, round_trip.count(), !frame->error.has_value());
      }
      scheduler_.complete(std::move(frame));
    }
  }

  /// Lets stop() reach the stream of a replica.
  class Registration {
   public:
    Registration(RemoteStage& stage, std::size_t r, Stream& stream) : stage_(stage), r_(r) {
      const std::lock_guard lock(stage_.mutex_);
      stage_.links_[r_].stream = &stream;
      if (stage_.scheduler_.finished() || stage_.joining_) stream.cancel();
    }
    ~Registration() {
      const std::lock_guard lock(stage_.mutex_);
      stage_.links_[r_].stream = nullptr;
    }
    Registration(const Registration&) = delete;
    Registration& operator=(const Registration&) = delete;

   private:
    RemoteStage& stage_;
    std::size_t r_;
  };

  const Options options_;
  const Callbacks callbacks_;
  Outage outage_;
  /// Of the last frame that was answered; read before the first request of a stream is sent, written after that.
  MemoryPtr memory_;
  ReplicaChoice choice_;  ///< of a sequential stage
  Scheduler scheduler_;
  std::mutex mutex_;
  bool joining_ = false;
  std::vector<Link> links_;
  std::vector<Slot> slots_;
  std::atomic<std::uint64_t> seen_version_{0};  ///< of the directory
};

}  // namespace pleat::coordinator
