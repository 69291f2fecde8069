#include "services/cli/top.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <optional>
#include <utility>

namespace pleat::cli {
namespace {

constexpr std::string_view kPrefix = "pleat_", kLatency = "pleat_stage_latency_seconds_bucket";

std::optional<MetricSample> parse_line(std::string_view line) {
  MetricSample sample;
  std::size_t at = line.find_first_of("{ ");
  if (at == std::string_view::npos || at == 0 || line[0] == '#') return std::nullopt;
  sample.name = line.substr(0, at);
  if (line[at] == '{') {
    ++at;
    while (at < line.size() && line[at] != '}') {
      const std::size_t equals = line.find("=\"", at);
      if (equals == std::string_view::npos) return std::nullopt;
      std::string value;
      std::size_t end = equals + 2;
      for (; end < line.size() && line[end] != '"'; ++end) {
        if (line[end] == '\\' && end + 1 < line.size()) ++end;
        value += line[end];
      }
      if (end >= line.size()) return std::nullopt;
      sample.labels[std::string(line.substr(at, equals - at))] = std::move(value);
      at = end + 1;
      if (at < line.size() && line[at] == ',') ++at;
    }
    if (at >= line.size()) return std::nullopt;
    ++at;
  }
  const std::string number(line.substr(at));
  char* end = nullptr;
  sample.value = std::strtod(number.c_str(), &end);
  if (end == number.c_str()) return std::nullopt;
  return sample;
}

std::string label(const MetricSample& sample, const std::string& name) {
  const auto found = sample.labels.find(name);
  return found == sample.labels.end() ? "" : found->second;
}

/// Upper bound (s) -> frames at most as slow.
using Buckets = std::map<double, double>;

/// The latency (s) that a share of the frames stays within.
double quantile(const Buckets& buckets, double share) {
  if (buckets.empty() || buckets.rbegin()->second <= 0) return 0;
  const double wanted = share * buckets.rbegin()->second;
  double low = 0, below = 0;
  for (const auto& [high, count] : buckets) {
    if (count >= wanted && count > below) {
      if (high == std::numeric_limits<double>::infinity()) return low;
      return low + (high - low) * (wanted - below) / (count - below);
    }
    low = high, below = count;
  }
  return low;
}

}  // namespace

std::vector<MetricSample> parse_metrics(std::string_view page) {
  std::vector<MetricSample> samples;
  while (!page.empty()) {
    const std::size_t end = std::min(page.find('\n'), page.size());
    if (auto sample = parse_line(page.substr(0, end))) samples.push_back(std::move(*sample));
    page.remove_prefix(std::min(end + 1, page.size()));
  }
  return samples;
}

std::vector<ServiceLoad> loads(const std::vector<MetricSample>& before, const std::vector<MetricSample>& now,
                               double seconds) {
  std::map<std::pair<std::string, std::map<std::string, std::string>>, double> known;
  for (const MetricSample& sample : before) known[{sample.name, sample.labels}] = sample.value;
  std::map<std::string, ServiceLoad> services;
  std::map<std::pair<std::string, std::string>, Buckets> latencies;
  for (const MetricSample& sample : now) {
    if (sample.name.rfind(kPrefix, 0) != 0 || label(sample, "service").empty()) continue;
    ServiceLoad& service = services[label(sample, "service")];
    const std::string stage = label(sample, "stage");
    const auto earlier = known.find({sample.name, sample.labels});
    // A service that began anew counts from nothing.
    const double last = earlier == known.end() || earlier->second > sample.value ? 0 : earlier->second;
    const double since = sample.value - last;
    if (sample.name == kLatency) {
      latencies[{label(sample, "service"), stage}][std::strtod(label(sample, "le").c_str(), nullptr)] = since;
    } else if (sample.name == "pleat_frames_total") {
      StageLoad& load = service.stages[stage];
      if (label(sample, "result") == "ok") {
        load.frames_per_s = seconds > 0 ? since / seconds : 0;
      } else {
        load.errors += sample.value;
      }
    } else if (sample.name == "pleat_inflight_frames") {
      service.stages[stage].in_flight = sample.value;
    } else if (sample.name == "pleat_window_frames") {
      service.stages[stage].window = sample.value;
    } else if (sample.name == "pleat_sessions") {
      service.sessions = sample.value;
    } else if (sample.name == "pleat_queue_depth") {
      service.waiting[label(sample, "edge")] = sample.value;
    } else if (sample.name.size() > kPrefix.size() + 6 && sample.name.substr(sample.name.size() - 6) == "_total") {
      service.counts[sample.name.substr(kPrefix.size(), sample.name.size() - kPrefix.size() - 6)] = sample.value;
    }
  }
  std::vector<ServiceLoad> result;
  for (auto& [name, service] : services) {
    service.service = name;
    for (auto& [stage, load] : service.stages) {
      const Buckets& buckets = latencies[{name, stage}];
      load.p50_ms = 1e3 * quantile(buckets, 0.5);
      load.p95_ms = 1e3 * quantile(buckets, 0.95);
    }
    result.push_back(std::move(service));
  }
  return result;
}

std::string table_of(const std::vector<ServiceLoad>& services) {
  std::string text;
  char line[256];
  std::snprintf(line, sizeof line, "%-14s %-14s %9s %13s %9s %9s %7s\n", "service", "stage", "frames/s", "in flight",
                "p50 ms", "p95 ms", "errors");
  text += line;
  for (const ServiceLoad& service : services) {
    std::snprintf(line, sizeof line, "%-14s %.0f session%s", service.service.c_str(), service.sessions,
                  service.sessions == 1 ? "" : "s");
    text += line;
    for (const auto& [queue, depth] : service.waiting) {
      std::snprintf(line, sizeof line, ", %.0f wait: %s", depth, queue.c_str());
      text += line;
    }
    for (const auto& [name, count] : service.counts) {
      std::snprintf(line, sizeof line, ", %s %.0f", name.c_str(), count);
      text += line;
    }
    text += '\n';
    for (const auto& [stage, load] : service.stages) {
      std::string flight = std::to_string(static_cast<long>(load.in_flight));
      if (load.window > 0) flight += " of " + std::to_string(static_cast<long>(load.window));
      std::snprintf(line, sizeof line, "%-14s %-14s %9.1f %13s %9.2f %9.2f %7.0f\n", "", stage.c_str(),
                    load.frames_per_s, flight.c_str(), load.p50_ms, load.p95_ms, load.errors);
      text += line;
    }
  }
  return text;
}

}  // namespace pleat::cli
