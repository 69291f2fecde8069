#include "common/frame/detail.hpp"

#include <gtest/gtest.h>

#include "tests/support/errors.hpp"

namespace pleat {
namespace {

TEST(Detail, NamesAndValuesBelongTogether) {
  for (const v1::Detail detail : {v1::DETAIL_NETWORK, v1::DETAIL_FOLD, v1::DETAIL_BOTH}) {
    EXPECT_EQ(detail_named(name_of(detail)), detail);
    EXPECT_EQ(checked_detail(detail, "", "detail"), detail);
    EXPECT_EQ(checked_detail(detail, "draping", "detail"), detail);
    EXPECT_TRUE(uses_network(detail) || uses_fold(detail));
    EXPECT_FALSE(is_simulated(detail));
  }
  for (const v1::Detail detail : {v1::DETAIL_NONE, v1::DETAIL_TRACKED, v1::DETAIL_FREE, v1::DETAIL_COARSE}) {
    EXPECT_EQ(detail_named(name_of(detail)), detail);
    EXPECT_EQ(checked_detail(detail, "", "detail"), detail);
    EXPECT_FALSE(uses_network(detail) || uses_fold(detail));
    EXPECT_EQ(is_simulated(detail), detail != v1::DETAIL_NONE);
  }
  EXPECT_EQ(detail_named(""), v1::DETAIL_UNSPECIFIED);
  EXPECT_EQ(detail_named("default"), v1::DETAIL_UNSPECIFIED);
}

TEST(Detail, UnsetIsTheDefaultAndUnknownIsRefused) {
  EXPECT_EQ(checked_detail(v1::DETAIL_UNSPECIFIED, "", "detail"), v1::DETAIL_FOLD);
  EXPECT_EQ(checked_detail(v1::DETAIL_UNSPECIFIED, "draping", "detail"), v1::DETAIL_NETWORK);
  const auto error = test::error_of([] { checked_detail(static_cast<v1::Detail>(12), "", "open.detail"); });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_STREQ(error.what(), "open.detail: unknown value 12");
}

TEST(Detail, SaysWhichStagesThereAre) {
  using Names = std::vector<std::string>;
  EXPECT_EQ(stage_names(v1::DETAIL_NETWORK), (Names{"to_image", "superres", "to_mesh", "refinement"}));
  EXPECT_EQ(stage_names(v1::DETAIL_FOLD), (Names{"fold", "refinement"}));
  EXPECT_EQ(stage_names(v1::DETAIL_BOTH), (Names{"to_image", "superres", "to_mesh", "fold", "refinement"}));
  EXPECT_EQ(stage_names(v1::DETAIL_NONE), (Names{"upsampling", "refinement"}));
  EXPECT_EQ(stage_names(v1::DETAIL_COARSE), (Names{"refinement"}));
  EXPECT_EQ(stage_names(v1::DETAIL_FREE), (Names{"simulation.fine", "refinement"}));
}

}  // namespace
}  // namespace pleat
