#include "common/telemetry/metrics.hpp"

#include <prometheus/counter.h>
#include <prometheus/gauge.h>
#include <prometheus/histogram.h>
#include <prometheus/registry.h>
#include <prometheus/text_serializer.h>

#include <atomic>

#include "common/base/error.hpp"
#include "common/telemetry/page_server.hpp"

namespace pleat::telemetry {
namespace {

prometheus::Histogram::BucketBoundaries latency_buckets() {
  return {0.00025, 0.0005, 0.001, 0.002, 0.004, 0.006, 0.008, 0.012, 0.016, 0.025, 0.05, 0.1, 0.25, 0.5, 1};
}

}  // namespace

struct Metrics::State {
  explicit State(const std::string& name)
      : service(name),
        registry(std::make_shared<prometheus::Registry>()),
        latency(prometheus::BuildHistogram()
                    .Name("pleat_stage_latency_seconds")
                    .Help("Time of a stage per frame, without transport and waiting")
                    .Register(*registry)),
        frames(prometheus::BuildCounter()
                   .Name("pleat_frames_total")
                   .Help("Frames processed, by result")
                   .Register(*registry)),
        sessions(prometheus::BuildGauge().Name("pleat_sessions").Help("Open streams").Register(*registry)),
        inflight(
            prometheus::BuildGauge().Name("pleat_inflight_frames").Help("Frames being processed").Register(*registry)),
        windows(prometheus::BuildGauge()
                    .Name("pleat_window_frames")
                    .Help("Frames that may be in flight")
                    .Register(*registry)),
        queues(
            prometheus::BuildGauge().Name("pleat_queue_depth").Help("Frames or jobs that wait").Register(*registry)) {
    sessions.Add({{"service", service}});
  }

  std::string service;
  std::atomic<int> open_sessions{0};
  std::atomic<std::uint64_t> ended_sessions{0};
  std::shared_ptr<prometheus::Registry> registry;
  prometheus::Family<prometheus::Histogram>& latency;
  prometheus::Family<prometheus::Counter>& frames;
  prometheus::Family<prometheus::Gauge>& sessions;
  prometheus::Family<prometheus::Gauge>& inflight;
  prometheus::Family<prometheus::Gauge>& windows;
  prometheus::Family<prometheus::Gauge>& queues;
  std::unique_ptr<PageServer> server;
};

Metrics::Metrics(const std::string& service) : state_(std::make_unique<State>(service)) {}
Metrics::~Metrics() = default;

void Metrics::serve(const std::string& address, bool anywhere) {
  const bool local = address.rfind("127.", 0) == 0 || address.rfind("localhost:", 0) == 0;
  if (!local && !anywhere)
    throw_invalid_argument("metrics address " + address + " is not on loopback (--metrics-anywhere allows it)");
  state_->server = std::make_unique<PageServer>(address, [this] { return text(); });
}

void Metrics::frame_done(const std::string& stage, double seconds, bool ok) {
  state_->latency.Add({{"service", state_->service}, {"stage", stage}}, latency_buckets()).Observe(seconds);
  state_->frames.Add({{"service", state_->service}, {"stage", stage}, {"result", ok ? "ok" : "error"}}).Increment();
}

void Metrics::add_sessions(int delta) {
  state_->open_sessions += delta;
  if (delta < 0) state_->ended_sessions += static_cast<std::uint64_t>(-delta);
  state_->sessions.Add({{"service", state_->service}}).Increment(delta);
}

int Metrics::sessions() const { return state_->open_sessions; }

std::uint64_t Metrics::ended_sessions() const { return state_->ended_sessions; }

void Metrics::add_inflight(const std::string& stage, int delta) {
  state_->inflight.Add({{"service", state_->service}, {"stage", stage}}).Increment(delta);
}

void Metrics::add_window(const std::string& stage, int delta) {
  state_->windows.Add({{"service", state_->service}, {"stage", stage}}).Increment(delta);
}

void Metrics::set_queue_depth(const std::string& edge, std::size_t depth) {
  state_->queues.Add({{"service", state_->service}, {"edge", edge}}).Set(static_cast<double>(depth));
}

void Metrics::count(const std::string& name, double amount) {
  prometheus::BuildCounter()
      .Name("pleat_" + name + "_total")
      .Help(name + " so far")
      .Register(*state_->registry)
      .Add({{"service", state_->service}})
      .Increment(amount);
}

std::string Metrics::text() const { return prometheus::TextSerializer().Serialize(state_->registry->Collect()); }

}  // namespace pleat::telemetry
