#include "services/cli/learn.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "services/cli/learn_page.hpp"

namespace pleat::cli {
namespace {

using testing::HasSubstr;
using testing::Not;

TEST(LearnBudget, WhatFitsStays) {
  // 13 x 100 frames of 0.1 s on two workers take a minute and a half, busy frames included.
  const LearnBudget budget = plan_budget(20, 1, {12, 100, 0}, false, false, 0.1, 2);
  EXPECT_EQ(budget.sequences, 12);
  EXPECT_EQ(budget.frames, 100);
  EXPECT_NEAR(budget.data_minutes, 1300 * 1.4 * 0.1 / 120, 1e-9);
}

TEST(LearnBudget, FramesComeDownBeforeSequences) {
  const LearnBudget fewer = plan_budget(20, 1, {12, 100, 0}, false, false, 0.6, 2);
  EXPECT_EQ(fewer.sequences, 12);
  EXPECT_LT(fewer.frames, 100);
  EXPECT_GT(fewer.frames, 30);
  EXPECT_LE(fewer.data_minutes, 6);
  const LearnBudget fewest = plan_budget(20, 1, {12, 100, 0}, false, false, 2, 2);
  EXPECT_EQ(fewest.frames, 30);
  EXPECT_LT(fewest.sequences, 12);
  EXPECT_GE(fewest.sequences, 6);
  const LearnBudget slow = plan_budget(20, 1, {12, 100, 0}, false, false, 100, 2);
  EXPECT_EQ(slow.frames, 30);
  EXPECT_EQ(slow.sequences, 6);
  EXPECT_GT(slow.data_minutes, 20);
}

TEST(LearnBudget, WhatWasAskedForStays) {
  const LearnBudget budget = plan_budget(1, 2, {5, 80, 0}, true, true, 10, 1);
  EXPECT_EQ(budget.sequences, 5);
  EXPECT_EQ(budget.frames, 80);
  // Few frames are not made more.
  EXPECT_EQ(plan_budget(1, 1, {2, 8, 0}, false, false, 10, 1).frames, 8);
  EXPECT_EQ(plan_budget(1, 1, {2, 8, 0}, false, false, 10, 1).sequences, 2);
}

TEST(LearnPage, HasTheFiguresSideBySideAndTheCurve) {
  LearnPage page;
  page.name = "<own>";
  page.scenes = {"a&b.json"};
  page.begun_with = "the bundle any";
  page.figures = {{"barycentric", {}, {}}, {"pleat:learned", {}, {{"superres", 3}, {"refinement", 1}}}};
  page.figures[1].metrics.psnr_db = 66.125;
  page.figures[1].metrics.rmse_m = 0.00125;
  page.figures[1].metrics.counts.penetrations = 2;
  page.figures[1].metrics.counts.self_intersections = 5;
  page.curve = {"own", {1, 2}, {60, 61.5}, {}, {}};
  page.judged = {"hung", "hung-05"};
  page.verdict = "better";
  const std::string html = to_html(page);
  EXPECT_THAT(html, HasSubstr(std::string(kLearnPageMarks[0])));
  EXPECT_THAT(html, HasSubstr("<th>barycentric</th><th>pleat:learned</th>"));
  EXPECT_THAT(html, HasSubstr("<td>&ndash;</td><td>66.12</td>"));
  EXPECT_THAT(html, HasSubstr("<td>1.25</td>"));
  EXPECT_THAT(html, HasSubstr("<td>0</td><td>7</td>"));
  EXPECT_THAT(html, HasSubstr("<td>4.0</td>"));
  EXPECT_THAT(html, HasSubstr("hung, hung-05"));
  EXPECT_THAT(html, HasSubstr("a&amp;b.json"));
  EXPECT_THAT(html, HasSubstr("<svg"));
  EXPECT_THAT(html, Not(HasSubstr("<own>")));
  EXPECT_THAT(html, Not(HasSubstr("http://")));
}

}  // namespace
}  // namespace pleat::cli
