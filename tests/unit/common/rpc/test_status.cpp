#include <gtest/gtest.h>

#include <new>

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

}  // namespace
}  // namespace pleat::rpc
