#include "common/telemetry/trace.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "common/telemetry/log.hpp"

namespace pleat::telemetry {
namespace {

// The examples of https://www.w3.org/TR/trace-context/, sections 3.2 and 4.
const std::string kTrace = "0af7651916cd43dd8448eb211c80319c", kParent = "b7ad6b7169203331";
const std::string kExample = "00-" + kTrace + "-" + kParent + "-01";

TEST(Traceparent, IsReadAndWritten) {
  const auto context = parse_traceparent(kExample);
  ASSERT_TRUE(context);
  EXPECT_EQ(context->trace_id, kTrace);
  EXPECT_EQ(context->parent_id, kParent);
  EXPECT_EQ(context->flags, kSampled);
  EXPECT_EQ(to_traceparent(*context), kExample);
  EXPECT_EQ(parse_traceparent("00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-00")->flags, 0);
}

TEST(Traceparent, WhatTheSpecificationCallsInvalidIsNothing) {
  const std::string zeros = std::string(32, '0'), zero = std::string(16, '0');
  for (const std::string& text : {std::string(),
                                  std::string("00"),
                                  kExample.substr(1),
                                  kExample.substr(0, kExample.size() - 1),
                                  kExample + "0",
                                  kExample + "-what",
                                  kExample + "-",  // version 00 ends there
                                  "00-" + kTrace.substr(1) + "-" + kParent + "-01",
                                  "00-" + kTrace + "0-" + kParent + "-01",
                                  "00-" + kTrace + "-" + kParent.substr(1) + "-01",
                                  "00-" + kTrace + "-" + kParent + "0-01",
                                  "00-" + kTrace + "-" + kParent + "-1",
                                  "00-" + kTrace + "-" + kParent + "-001",
                                  "00-" + zeros + "-" + kParent + "-01",
                                  "00-" + kTrace + "-" + zero + "-01",  // ids of zeros
                                  "ff-" + kTrace + "-" + kParent + "-01",
                                  "ff-" + kTrace + "-" + kParent + "-01-more",
                                  "0-" + kTrace + "-" + kParent + "-01",
                                  "0x-" + kTrace + "-" + kParent + "-01",
                                  "FF-" + kTrace + "-" + kParent + "-01",
                                  "00-0AF7651916CD43DD8448EB211C80319C-" + kParent + "-01",  // upper case
                                  "00-" + kTrace + "-B7AD6B7169203331-01",
                                  "00-" + kTrace + "-" + kParent + "-0A",
                                  "00-" + kTrace + "-" + kParent + "-.0",
                                  "00-.af7651916cd43dd8448eb211c80319c-" + kParent + "-01",
                                  "00_" + kTrace + "-" + kParent + "-01",
                                  "00-" + kTrace + "_" + kParent + "-01",
                                  "00-" + kTrace + "-" + kParent + "_01",
                                  " " + kExample,
                                  kExample + " "}) {
    EXPECT_FALSE(parse_traceparent(text)) << "'" << text << "'";
  }
}

TEST(Traceparent, LaterVersionsAreReadAsFarAsTheyAreKnown) {
  for (const char* version : {"01", "cc", "fe"}) {
    const std::string text = version + kExample.substr(2);
    for (const char* more : {"", "-", "-what-the-future-will-be-like"}) {
      const auto context = parse_traceparent(text + more);
      ASSERT_TRUE(context) << text << more;
      EXPECT_EQ(context->trace_id, kTrace);
      EXPECT_EQ(to_traceparent(*context), kExample) << "we speak version 00";
    }
    EXPECT_FALSE(parse_traceparent(text + "0")) << "more has to begin with a dash";
    EXPECT_FALSE(parse_traceparent(text + ".what"));
  }
}

TEST(Traceparent, FlagsThatNobodyKnowsAreNotHandedOn) {
  EXPECT_EQ(parse_traceparent("00-" + kTrace + "-" + kParent + "-ff")->flags, kSampled | kRandomId);
  EXPECT_EQ(parse_traceparent("00-" + kTrace + "-" + kParent + "-fc")->flags, 0);
}

TEST(Traceparent, AChildHasTheTraceAndItsOwnSpan) {
  TraceContext context = *parse_traceparent(kExample);
  context.state = "congo=t61rcWkgMzE";
  const TraceContext child = child_of(context);
  EXPECT_EQ(child.trace_id, kTrace);
  EXPECT_NE(child.parent_id, kParent);
  EXPECT_EQ(child.flags, context.flags);
  EXPECT_EQ(child.state, context.state);
  EXPECT_TRUE(parse_traceparent(to_traceparent(child)));
}

TEST(Traceparent, NewOnesAreValidAndDiffer) {
  const TraceContext made = new_trace();
  EXPECT_EQ(parse_traceparent(to_traceparent(made)), made);
  EXPECT_NE(made.trace_id, new_trace().trace_id);
  EXPECT_TRUE(TraceContext().empty());
}

TEST(Tracestate, IsHandedOnAsItIsUnlessItIsTooMuch) {
  EXPECT_EQ(checked_tracestate("rojo=00f067aa0ba902b7,congo=t61rcWkgMzE"), "rojo=00f067aa0ba902b7,congo=t61rcWkgMzE");
  EXPECT_EQ(checked_tracestate(std::string(512, 'a')).size(), 512U);
  EXPECT_EQ(checked_tracestate(std::string(513, 'a')), "");
  EXPECT_EQ(checked_tracestate("a=\n"), "");
}

std::string logged(const std::function<void()>& log) {
  ::testing::internal::CaptureStderr();
  log();
  spdlog::default_logger()->flush();
  return ::testing::internal::GetCapturedStderr();
}

TEST(TraceScope, LogLinesOfItsThreadCarryTheId) {
  const TraceContext outer = new_trace(), inner = new_trace();
  const auto lines = [&] {
    spdlog::info("before");
    {
      const TraceScope scope(outer);
      spdlog::info("outer");
      std::thread([] { spdlog::info("elsewhere"); }).join();
      {
        const TraceScope nested(inner);
        audit("inner");
      }
      spdlog::info("outer again");
    }
    spdlog::info("after");
  };
  set_up_logging("sample", {"info", "json"});
  std::istringstream json(logged(lines));
  for (const std::string& expected :
       {std::string(), outer.trace_id, std::string(), inner.trace_id, outer.trace_id, std::string()}) {
    std::string line;
    ASSERT_TRUE(std::getline(json, line));
    EXPECT_EQ(nlohmann::json::parse(line).value("trace", std::string()), expected) << line;
  }
  set_up_logging("sample", {"info", "console"});
  const std::string console = logged(lines);
  EXPECT_NE(console.find("outer trace=" + outer.trace_id + "\n"), std::string::npos) << console;
  EXPECT_NE(console.find("elsewhere\n"), std::string::npos) << console;
  EXPECT_NE(console.find("audit: inner trace=" + inner.trace_id + "\n"), std::string::npos) << console;
  set_up_logging("sample", {"off", "console"});
}

}  // namespace
}  // namespace pleat::telemetry
