#include <gtest/gtest.h>

#include <set>

#include "common/base/error.hpp"

namespace pleat {
namespace {

TEST(Error, CarriesCodeAndMessage) {
  try {
    throw_not_found("cloth.obj: can't be read");
    FAIL() << "nothing was thrown";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kNotFound);
    EXPECT_STREQ(error.what(), "cloth.obj: can't be read");
  }
}

// Messages echo what files hold.
TEST(Error, IsOneLine) {
  EXPECT_STREQ(Error(ErrorCode::kInternal, "a.usda: 'x\ny\t\x1b[0m': \u00e4").what(), "a.usda: 'x y  [0m': \u00e4");
}

TEST(Error, EveryCodeHasItsOwnName) {
  std::set<std::string_view> names;
  for (int code = 0; code <= static_cast<int>(ErrorCode::kInternal); ++code) {
    names.insert(to_string(static_cast<ErrorCode>(code)));
  }
  EXPECT_EQ(names.size(), static_cast<std::size_t>(ErrorCode::kInternal) + 1);
  EXPECT_EQ(names.count("DATA_LOSS"), 1u);
}

}  // namespace
}  // namespace pleat
