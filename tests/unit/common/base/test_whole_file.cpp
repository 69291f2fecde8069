// A file is there whole or not at all, and its making touches no other file.
#include "common/base/whole_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <iterator>
#include <string>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

class WholeFileTest : public testing::Test {
 protected:
  static std::string content(const fs::path& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  std::size_t files() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }
  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path(), path_ = folder_ / "file";
};

TEST_F(WholeFileTest, AppearsWithCommitAndLeavesNothingWithout) {
  {
    WholeFile file(path_);
    file.write("half");
  }
  EXPECT_EQ(files(), 0u);
  {
    WholeFile file(path_);
    file.write("whole");
    EXPECT_FALSE(fs::exists(path_));
    file.commit();
  }
  EXPECT_EQ(content(path_), "whole");
  write_whole_file(path_, "again");
  EXPECT_EQ(content(path_), "again");
  EXPECT_EQ(files(), 1u);
  write_whole_file(folder_ / "a" / "b", "deep");
  EXPECT_EQ(content(folder_ / "a" / "b"), "deep");
}

TEST_F(WholeFileTest, ALinkIsReplacedAndNotWhatItNames) {
  std::ofstream(folder_ / "precious") << "mine";
  fs::create_symlink("precious", path_);
  write_whole_file(path_, "new");
  EXPECT_EQ(content(folder_ / "precious"), "mine");
  EXPECT_TRUE(fs::is_regular_file(fs::symlink_status(path_)));
}

TEST_F(WholeFileTest, WhatCannotBeWrittenIsNamed) {
  for (const fs::path& path : {fs::path("/dev/full"), folder_, folder_ / "missing" / "file"}) {
    try {
      WholeFile file(path);
      ADD_FAILURE() << path;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
      EXPECT_THAT(error.what(), testing::StartsWith(path.string() + ": "));
    }
  }
}

TEST_F(WholeFileTest, AFullDiskKeepsTheOldContent) {
  write_whole_file(path_, "old");
  const pid_t child = ::fork();
  if (child == 0) {
    ::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{1000, 1000};
    if (::setrlimit(RLIMIT_FSIZE, &limit) != 0) ::_exit(3);
    try {
      write_whole_file(path_, std::string(100'000, 'x'));
    } catch (const Error& error) {
      ::_exit(error.code() == ErrorCode::kResourceExhausted ? 0 : 1);
    }
    ::_exit(2);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  EXPECT_EQ(content(path_), "old");
  EXPECT_EQ(files(), 1u);
}

}  // namespace
}  // namespace pleat
