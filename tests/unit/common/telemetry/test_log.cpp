#include "common/telemetry/log.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"

namespace pleat::telemetry {
namespace {

TEST(Log, JsonLines) {
  set_up_logging("sample", {"info", "json"});
  ::testing::internal::CaptureStderr();
  spdlog::info("a \"quoted\" {} and \xff a bad byte", 42);
  spdlog::debug("not shown");
  spdlog::default_logger()->flush();
  const std::string text = ::testing::internal::GetCapturedStderr();
  ASSERT_EQ(std::count(text.begin(), text.end(), '\n'), 1) << text;
  const auto line = nlohmann::json::parse(text);
  EXPECT_EQ(line["level"], "info");
  EXPECT_EQ(line["service"], "sample");
  EXPECT_NE(line["message"].get<std::string>().find("a \"quoted\" 42"), std::string::npos);
  EXPECT_GT(line["time"].get<double>(), 1e9);
}

TEST(Log, RefusesUnknownSettings) {
  EXPECT_THROW(set_up_logging("sample", {"loud", "json"}), Error);
  EXPECT_THROW(set_up_logging("sample", {"info", "xml"}), Error);
  set_up_logging("sample", {"off", "console"});
}

}  // namespace
}  // namespace pleat::telemetry
