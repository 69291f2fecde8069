#include "services/cli/top.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/metrics.hpp"

namespace pleat::cli {
namespace {

TEST(Top, ReadsTheTextFormat) {
  const auto samples = parse_metrics(
      "# HELP pleat_sessions Open streams\n# TYPE pleat_sessions gauge\n"
      "pleat_sessions{service=\"fold\"} 3\n"
      "plain 1e-3\n"
      "escaped{a=\"x\\\"y\",le=\"+Inf\"} 7 1700000000\n"
      "broken{a=\"x\n"
      "{} 3\nno_value\n");
  ASSERT_EQ(samples.size(), 3U);
  EXPECT_EQ(samples[0].name, "pleat_sessions");
  EXPECT_EQ(samples[0].labels.at("service"), "fold");
  EXPECT_EQ(samples[0].value, 3);
  EXPECT_EQ(samples[1].value, 1e-3);
  EXPECT_EQ(samples[2].labels.at("a"), "x\"y");
  EXPECT_EQ(samples[2].labels.at("le"), "+Inf");
  EXPECT_EQ(samples[2].value, 7);
}

// Whatever telemetry writes is what is read here.
TEST(Top, SaysWhatHappenedSinceTheLastLook) {
  telemetry::Metrics metrics("fold");
  metrics.add_sessions(2);
  metrics.add_window("fold", 8);
  metrics.add_inflight("fold", 5);
  metrics.set_queue_depth("jobs", 4);
  metrics.count("fold_restarts", 6);
  for (int i = 0; i < 50; ++i) metrics.frame_done("fold", 0.9, true);
  const auto before = parse_metrics(metrics.text());
  for (int i = 0; i < 90; ++i) metrics.frame_done("fold", 0.003, true);
  for (int i = 0; i < 10; ++i) metrics.frame_done("fold", 0.3, true);
  metrics.frame_done("fold", 0.003, false);
  const auto now = parse_metrics(metrics.text());

  const auto services = loads(before, now, 2);
  ASSERT_EQ(services.size(), 1U);
  const ServiceLoad& service = services.front();
  EXPECT_EQ(service.service, "fold");
  EXPECT_EQ(service.sessions, 2);
  EXPECT_EQ(service.waiting.at("jobs"), 4);
  EXPECT_EQ(service.counts.at("fold_restarts"), 6);
  EXPECT_FALSE(service.counts.count("frames")) << "that is the stages'";
  const StageLoad& load = service.stages.at("fold");
  EXPECT_EQ(load.frames_per_s, 50);
  EXPECT_EQ(load.errors, 1);
  EXPECT_EQ(load.in_flight, 5);
  EXPECT_EQ(load.window, 8);
  EXPECT_GT(load.p50_ms, 1);
  EXPECT_LT(load.p50_ms, 5);
  EXPECT_GT(load.p95_ms, 100);
  EXPECT_LT(load.p95_ms, 600) << "the 0.9 s are before the first look";
  EXPECT_THAT(table_of(services), testing::AllOf(testing::HasSubstr("5 of 8"), testing::HasSubstr("2 sessions"),
                                                 testing::HasSubstr("4 wait: jobs")));

  // A service that began anew: its counters are smaller than they were.
  const auto again = loads(now, before, 1);
  EXPECT_EQ(again.front().stages.at("fold").frames_per_s, 50);
  // Nothing since: no latency, and no division by nothing.
  EXPECT_EQ(loads(now, now, 0).front().stages.at("fold").p95_ms, 0);
}

}  // namespace
}  // namespace pleat::cli
