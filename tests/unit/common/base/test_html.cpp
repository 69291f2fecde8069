#include "common/base/html.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace pleat {
namespace {

using testing::HasSubstr;
using testing::Not;

TEST(EscapeHtml, LeavesNothingThatATagCouldBeMadeOf) {
  EXPECT_EQ(escape_html("a<b>&\"c\""), "a&lt;b&gt;&amp;&quot;c&quot;");
}

TEST(LineChart, SpansThePictureAndBreaksAtGaps) {
  const double gap = std::numeric_limits<double>::quiet_NaN();
  const std::string svg = line_chart({"Loss", "dB", false, {{"a<b", "#123", {1, 2, 3, 4, 5}, {0, 1, gap, 3, 4}}}});
  EXPECT_THAT(svg, HasSubstr("<h2>Loss</h2>"));
  EXPECT_THAT(svg, HasSubstr("stroke=\"#123\" d=\"M70.0 "));
  EXPECT_THAT(svg, HasSubstr("L620.0 "));
  EXPECT_THAT(svg, HasSubstr("a&lt;b"));
  EXPECT_EQ(std::count(svg.begin(), svg.end(), 'M'), 2) << "a second line behind the gap: " << svg;
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
}

TEST(LineChart, LogarithmicAxesHavePowersOfTenAndNoPlaceForZero) {
  const std::string svg = line_chart({"Rate", "", true, {{"rate", "#123", {1, 2, 3}, {0, 1e-3, 10}}}});
  EXPECT_THAT(svg, HasSubstr(">0.001</text>"));
  EXPECT_THAT(svg, HasSubstr(">10</text>"));
  EXPECT_THAT(svg, Not(HasSubstr("inf")));
}

TEST(LineChart, SaysThatThereIsNothing) {
  EXPECT_THAT(line_chart({"Loss", "dB", false, {{"a", "#123", {}, {}}}}), HasSubstr("No values yet"));
  EXPECT_THAT(line_chart({"Loss", "dB", true, {{"a", "#123", {1}, {-1}}}}), HasSubstr("No values yet"));
  EXPECT_THAT(line_chart({"Loss", "dB", false, {{"a", "#123", {1}, {5}}}}), HasSubstr("<path")) << "one value is shown";
}

}  // namespace
}  // namespace pleat
