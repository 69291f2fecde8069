// Sockets without an address lie where nobody else can put or take them.
#include "common/base/runtime_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

class RuntimeFolder : public testing::Test {
 protected:
  RuntimeFolder() { ::setenv("XDG_RUNTIME_DIR", temporary_.path().c_str(), 1); }
  ~RuntimeFolder() override { ::unsetenv("XDG_RUNTIME_DIR"); }
  std::string cause() const {
    try {
      check_runtime_folder(folder_ / "x.sock", true);
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kFailedPrecondition);
      EXPECT_THAT(error.what(), testing::StartsWith(folder_.string() + ": "));
      return error.what();
    }
    return "";
  }
  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path() / "pleat";
};

TEST_F(RuntimeFolder, IsMadeForThisUserAlone) {
  EXPECT_EQ(default_address("superres"), "unix:" + (folder_ / "superres.sock").string());
  EXPECT_NO_THROW(check_runtime_folder(folder_ / "x.sock", false));
  EXPECT_FALSE(fs::exists(folder_));
  EXPECT_EQ(cause(), "");
  EXPECT_EQ(fs::status(folder_).permissions(), fs::perms::owner_all);
  EXPECT_EQ(cause(), "");
}

TEST_F(RuntimeFolder, IsRefusedIfOthersCouldHaveMadeIt) {
  fs::create_directory(folder_);
  fs::permissions(folder_, fs::perms::owner_all | fs::perms::others_write);
  EXPECT_THAT(cause(), testing::HasSubstr("open to other users"));
  fs::permissions(folder_, fs::perms::owner_all);
  fs::rename(folder_, temporary_.path() / "real");
  fs::create_directory_symlink("real", folder_);
  EXPECT_THAT(cause(), testing::HasSubstr("is no folder"));
  EXPECT_NO_THROW(check_runtime_folder("/tmp/elsewhere/x.sock", true));
}

TEST_F(RuntimeFolder, WithoutOneItIsTheUsersInTmp) {
  ::unsetenv("XDG_RUNTIME_DIR");
  EXPECT_EQ(runtime_folder(), "/tmp/pleat-" + std::to_string(::geteuid()));
}

}  // namespace
}  // namespace pleat
