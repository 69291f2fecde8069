#include "common/rpc/caller.hpp"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>

#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::rpc {
namespace {

TEST(Caller, AHostIsOneWhateverThePort) {
  EXPECT_EQ(host_of_peer("ipv4:10.0.0.7:4242"), "ipv4:10.0.0.7");
  EXPECT_EQ(host_of_peer("ipv6:%5B::1%5D:4242"), "ipv6:%5B::1%5D");
  EXPECT_EQ(host_of_peer("unix:"), "unix");
  EXPECT_EQ(host_of_peer("unix:/tmp/client.sock"), "unix");
  EXPECT_EQ(host_of_peer("ipv4:"), "ipv4:");
}

TEST(Caller, RolesHaveNames) {
  for (const Role role : {Role::kWatcher, Role::kUser, Role::kAdmin}) EXPECT_EQ(role_named(to_string(role)), role);
  EXPECT_FALSE(role_named("root"));
}

class TokenTest : public ::testing::Test {
 protected:
  void write(const std::string& text, mode_t mode = 0600) {
    std::ofstream(file_) << text;
    ::chmod(file_.c_str(), mode);
  }
  Error failure() {
    return test::error_of([&] { TokenTable table(file_); });
  }

  const test::TemporaryFolder folder_;
  const std::string file_ = folder_.path() / "tokens";
};

TEST_F(TokenTest, FindsTheBearer) {
  write("# who may call\n\nalice admin 0123456789abcdef\n  bob watcher fedcba9876543210\n");
  const TokenTable table(file_);
  ASSERT_NE(table.find("0123456789abcdef"), nullptr);
  EXPECT_EQ(table.find("0123456789abcdef")->name, "alice");
  EXPECT_EQ(table.find("0123456789abcdef")->role, Role::kAdmin);
  EXPECT_EQ(table.find("fedcba9876543210")->role, Role::kWatcher);
  for (const char* wrong : {"", "0123456789abcde", "0123456789abcdef0", "0123456789abcdeF"}) {
    EXPECT_EQ(table.find(wrong), nullptr) << wrong;
  }
}

TEST_F(TokenTest, BadFilesAreNamedWithTheLine) {
  EXPECT_EQ(test::error_of([&] { TokenTable table("/nowhere/tokens"); }).code(), ErrorCode::kNotFound);
  write("alice admin 0123456789abcdef\n", 0640);
  EXPECT_EQ(failure().code(), ErrorCode::kFailedPrecondition) << "others may read it";
  for (const char* line : {"alice admin", "alice root 0123456789abcdef", "alice admin short",
                           "alice admin 0123456789abcdef more", "local user 0123456789abcdef"}) {
    write(std::string("\n") + line + "\n");
    EXPECT_EQ(failure().code(), ErrorCode::kInvalidArgument) << line;
    EXPECT_NE(std::string(failure().what()).find("tokens:2: "), std::string::npos) << failure().what();
  }
}

TEST_F(TokenTest, AClientsFileHoldsOneToken) {
  write("0123456789abcdef\n");
  EXPECT_EQ(read_token(file_), "0123456789abcdef");
  write("a b");
  EXPECT_EQ(test::error_of([&] { read_token(file_); }).code(), ErrorCode::kInvalidArgument);
  write("");
  EXPECT_EQ(test::error_of([&] { read_token(file_); }).code(), ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace pleat::rpc
