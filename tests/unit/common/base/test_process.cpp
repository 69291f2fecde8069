// Children end with their parent, however that ends.
#include "common/base/process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <thread>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

class ProcessTest : public testing::Test {
 protected:
  const pleat::test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path(), log_ = folder_ / "child.log";
};

TEST_F(ProcessTest, CollectsOutputAndExitCode) {
  ChildProcess child("/bin/sh", {"-c", "echo out; echo err >&2; exit 3"}, log_);
  ASSERT_TRUE(child.wait_until(Clock::now() + std::chrono::seconds(30)));
  EXPECT_EQ(child.end_reason(), "exit code 3");
  EXPECT_EQ(last_lines(log_, 2), "out | err");
  EXPECT_EQ(last_lines(log_, 1), "err");
}

TEST_F(ProcessTest, NamesAMissingProgram) {
  try {
    ChildProcess("/nonexistent/pleat-x", {}, log_);
    ADD_FAILURE() << "started";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kNotFound);
    EXPECT_THAT(error.what(), testing::HasSubstr("/nonexistent/pleat-x"));
  }
}

TEST_F(ProcessTest, ReportsTheSignal) {
  ChildProcess child("/bin/sleep", {"600"}, log_);
  EXPECT_TRUE(child.running());
  child.send(SIGTERM);
  ASSERT_TRUE(child.wait_until(Clock::now() + std::chrono::seconds(30)));
  EXPECT_EQ(child.end_reason(), "signal 15");
}

TEST_F(ProcessTest, DestructionKills) {
  pid_t pid = 0;
  {
    ChildProcess child("/bin/sleep", {"600"}, log_);
    pid = child.pid();
  }
  EXPECT_EQ(::kill(pid, 0), -1);
}

TEST_F(ProcessTest, AKilledParentLeavesNoChild) {
  const fs::path pid_file = folder_ / "pid";
  const pid_t parent = ::fork();
  if (parent == 0) {
    ChildProcess child("/bin/sleep", {"600"}, log_);
    std::ofstream(folder_ / "pid.new") << child.pid();
    fs::rename(folder_ / "pid.new", pid_file);
    ::pause();
    ::_exit(0);
  }
  while (!fs::exists(pid_file)) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  pid_t child = 0;
  std::ifstream(pid_file) >> child;
  ASSERT_GT(child, 0);
  ASSERT_EQ(::kill(child, 0), 0);
  // The orphan is ours to collect, so that "gone" means gone and not a zombie of an init that does not reap.
  ::prctl(PR_SET_CHILD_SUBREAPER, 1);
  ::kill(parent, SIGKILL);
  ::waitpid(parent, nullptr, 0);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFSIGNALED(status));
  EXPECT_EQ(WTERMSIG(status), SIGKILL);
}

TEST_F(ProcessTest, ThePrivateFolderIsPrivateShortAndRemoved) {
  fs::path path;
  {
    PrivateFolder folder;
    path = folder.path();
    EXPECT_LT(path.string().size(), 80u);
    EXPECT_EQ(fs::status(path).permissions(), fs::perms::owner_all);
    std::ofstream(path / "x.sock") << "x";
  }
  EXPECT_FALSE(fs::exists(path));
}

TEST_F(ProcessTest, ForeignFoldersBesideThePrivateOneAreKept) {
  ASSERT_EQ(::setenv("XDG_RUNTIME_DIR", folder_.c_str(), 1), 0);
  const fs::path project = folder_ / "pleat-project";
  fs::create_directory(project);
  std::ofstream(project / "lock") << "";
  std::ofstream(project / "precious.txt") << "mine";
  fs::last_write_time(project, fs::file_time_type::clock::now() - std::chrono::hours(1));
  { const PrivateFolder folder; }
  EXPECT_TRUE(fs::exists(project / "precious.txt"));
  ::unsetenv("XDG_RUNTIME_DIR");
}

TEST_F(ProcessTest, ALogReplacesOneOfItsProgramOnly) {
  begin_log(log_, "pleat-example");
  EXPECT_EQ(last_lines(log_, 1), "");
  std::ofstream(log_, std::ios::app) << "of the first run\n";
  begin_log(log_, "pleat-example");
  EXPECT_EQ(last_lines(log_, 5), "");
  const fs::path precious = folder_ / "precious.log", link = folder_ / "link.log";
  std::ofstream(precious) << "mine\n";
  fs::create_symlink(log_, link);
  for (const fs::path& path : {precious, link, folder_}) EXPECT_THROW(begin_log(path, "pleat-example"), Error) << path;
  EXPECT_THROW(begin_log(log_, "pleat-other"), Error);
  EXPECT_EQ(last_lines(precious, 1), "mine");
}

TEST_F(ProcessTest, ShippedFilesAreFoundFromAnyFolder) {
  const fs::path here = fs::current_path(), skirt = fs::absolute(shipped_file("garments/skirt.obj"));
  EXPECT_TRUE(fs::is_regular_file(skirt)) << skirt;
  fs::current_path(folder_);
  EXPECT_TRUE(fs::equivalent(shipped_file("garments/skirt.obj"), skirt));
  EXPECT_EQ(shipped_file("garments/none.obj"), "deploy/garments/none.obj");
  // A user's own, beside those that came with the program.
  fs::create_directories("data/pleat/garments");
  std::ofstream("data/pleat/garments/mine.obj") << "v 0 0 0\n";
  ::setenv("XDG_DATA_HOME", (folder_ / "data").c_str(), 1);
  EXPECT_TRUE(fs::equivalent(shipped_file("garments/mine.obj"), "data/pleat/garments/mine.obj"));
  EXPECT_TRUE(fs::equivalent(shipped_file("garments/skirt.obj"), skirt));
  ::unsetenv("XDG_DATA_HOME");
  ::setenv("XDG_DATA_DIRS", ("/nowhere:" + (folder_ / "data").string()).c_str(), 1);
  EXPECT_TRUE(fs::equivalent(shipped_file("garments/mine.obj"), "data/pleat/garments/mine.obj"));
  ::unsetenv("XDG_DATA_DIRS");
  EXPECT_EQ(state_folder("services"), "out/services");
  fs::current_path(here);
}

}  // namespace
}  // namespace pleat
