#include <gtest/gtest.h>

#include <new>
#include <system_error>

#include "common/rpc/channel.hpp"
#include "common/rpc/status.hpp"

namespace pleat::rpc {
namespace {

TEST(Status, EveryCodeComesBack) {
  for (int code = 0; code <= static_cast<int>(ErrorCode::kInternal); ++code) {
    const Error error(static_cast<ErrorCode>(code), "culprit");
    const grpc::Status status = to_status(error);
    EXPECT_NE(status.error_code(), grpc::StatusCode::OK);
    EXPECT_EQ(status.error_message(), "culprit");
    EXPECT_EQ(to_error(status, "peer").code(), error.code());
    EXPECT_STREQ(to_error(status, "peer").what(), "peer: culprit");
  }
  EXPECT_EQ(to_error_code(grpc::StatusCode::ABORTED), ErrorCode::kInternal);
}

TEST(Status, GuardLetsNoExceptionThrough) {
  EXPECT_TRUE(guard([] {}).ok());
  EXPECT_EQ(guard([] { return grpc::Status(grpc::StatusCode::NOT_FOUND, "x"); }).error_code(),
            grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(guard([] { throw_data_loss("x"); }).error_code(), grpc::StatusCode::DATA_LOSS);
  EXPECT_EQ(guard([] { throw std::bad_alloc(); }).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(guard([] { throw std::runtime_error("y"); }).error_message(), "y");
  EXPECT_EQ(guard([] { throw 3; }).error_code(), grpc::StatusCode::INTERNAL);
}

TEST(Channel, LocalAddresses) {
  for (const char* address :
       {"unix:/tmp/a", "unix-abstract:a", "127.0.0.1:80", "127.3.0.1:0", "localhost:1", "[::1]:5"}) {
    EXPECT_TRUE(is_local_address(address)) << address;
  }
  for (const char* address :
       {"0.0.0.0:80", "10.0.0.1:80", "dns:///superres:50053", "127.evil.example:80", "[::]:80", ""}) {
    EXPECT_FALSE(is_local_address(address)) << address;
  }
  EXPECT_THROW(create_channel("10.0.0.1:80"), Error);
  EXPECT_THROW(create_channel(""), Error);
}

TEST(Status, MessagesAreBounded) {
  const std::string long_text = "job '" + std::string(20'000, 'x') + "' does not exist";
  const grpc::Status status = to_status(Error(ErrorCode::kNotFound, long_text));
  EXPECT_LE(status.error_message().size(), kMaxMessageCharacters);
  EXPECT_TRUE(status.error_message().starts_with("job 'xxx"));
  EXPECT_TRUE(status.error_message().ends_with("' does not exist"));
  EXPECT_EQ(bounded("short"), "short");
}

TEST(Status, OnlyWhatMayPassIsTriedAgain) {
  EXPECT_TRUE(may_pass(ErrorCode::kUnavailable));
  EXPECT_TRUE(may_pass(ErrorCode::kDeadlineExceeded));
  EXPECT_FALSE(may_pass(ErrorCode::kResourceExhausted)) << "an input beyond a limit stays there";
  EXPECT_FALSE(may_pass(ErrorCode::kInvalidArgument));
  const grpc::Status full(grpc::StatusCode::RESOURCE_EXHAUSTED, "Server Threadpool Exhausted");
  EXPECT_TRUE(may_pass(to_error(full, "x").code()));
}

TEST(Status, AThreadThatCanNotBeHadMayPass) {
  const auto status =
      guard([] { throw std::system_error(std::make_error_code(std::errc::resource_unavailable_try_again), "thread"); });
  EXPECT_EQ(status.error_code(), grpc::StatusCode::UNAVAILABLE);
}

}  // namespace
}  // namespace pleat::rpc
