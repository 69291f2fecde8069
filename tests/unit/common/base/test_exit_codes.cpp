#include "common/base/exit_codes.hpp"

#include <gtest/gtest.h>

namespace pleat {
namespace {

TEST(ExitCodes, TellTheUsersMistakesFromOurs) {
  for (const ErrorCode code : {ErrorCode::kInvalidArgument, ErrorCode::kNotFound, ErrorCode::kAlreadyExists,
                               ErrorCode::kFailedPrecondition, ErrorCode::kDataLoss})
    EXPECT_EQ(exit_code(code), 2) << to_string(code);
  for (const ErrorCode code : {ErrorCode::kResourceExhausted, ErrorCode::kUnavailable, ErrorCode::kDeadlineExceeded,
                               ErrorCode::kCancelled, ErrorCode::kInternal})
    EXPECT_EQ(exit_code(code), 1) << to_string(code);
}

}  // namespace
}  // namespace pleat
