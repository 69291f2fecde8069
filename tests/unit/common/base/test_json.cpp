#include "common/base/json.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/error.hpp"

namespace pleat {
namespace {

TEST(Json, CommentsAreSkipped) {
  const std::string text = "// first\n{\"a\": /* here */ 1} // last";
  EXPECT_EQ(parse_json(text, "x")["a"], 1);
  EXPECT_EQ(plain_json(text, "x"), "{\"a\":1}");
  EXPECT_EQ(plain_json("{ \"a\": 1 }", "x"), "{ \"a\": 1 }");
}

TEST(Json, FaultsHaveAPlace) {
  for (const std::string text : {"{\n\"a\": [1,]\n}", "{\n  \"a\": 1e999}", "{\n/* never ends"}) {
    try {
      parse_json(text, "file.json");
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
      EXPECT_THAT(error.what(), testing::StartsWith("file.json: not JSON: "));
      EXPECT_THAT(error.what(), testing::Not(testing::HasSubstr("json.exception"))) << error.what();
    }
  }
}

}  // namespace
}  // namespace pleat
