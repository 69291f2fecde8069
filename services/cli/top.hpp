// What metrics pages of services say, between two looks at them.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace pleat::cli {

/// A line of a page in Prometheus' text format.
struct MetricSample {
  std::string name;
  std::map<std::string, std::string> labels;
  double value = 0;
};

/// Lines that are none (comments, other formats) are left out.
std::vector<MetricSample> parse_metrics(std::string_view page);

struct StageLoad {
  double frames_per_s = 0;
  double in_flight = 0, window = 0;  ///< frames; window 0: there is none
  double p50_ms = 0, p95_ms = 0;     ///< of the frames since the last look; 0 without any
  double errors = 0;                 ///< since the service began
};

struct ServiceLoad {
  std::string service;
  double sessions = 0;
  std::map<std::string, double> waiting;  ///< queue -> frames or jobs
  std::map<std::string, StageLoad> stages;
  std::map<std::string, double> counts;  ///< what only one service has, "reconnects" for example, since it began
};

/// before: the page `seconds` earlier; empty: everything since the service began counts as new. Latencies are
/// interpolated in the histogram's buckets.
std::vector<ServiceLoad> loads(const std::vector<MetricSample>& before, const std::vector<MetricSample>& now,
                               double seconds);

/// As a table, a line for each stage.
std::string table_of(const std::vector<ServiceLoad>& services);

}  // namespace pleat::cli
