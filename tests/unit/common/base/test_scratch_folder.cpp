// Scratch folders of processes that are gone are removed, and nothing else is.
#include "common/base/scratch_folder.hpp"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <optional>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

class ScratchFolderTest : public testing::Test {
 protected:
  /// A scratch folder whose process was killed, with a file in it.
  fs::path abandoned() const {
    int channel[2];
    EXPECT_EQ(::pipe(channel), 0);
    const pid_t child = ::fork();
    if (child == 0) {
      const ScratchFolder folder(parent_, "work");
      std::ofstream(folder.path() / "file") << "x";
      const std::string name = folder.path().string();
      if (::write(channel[1], name.data(), name.size()) < 0) ::_exit(1);
      ::close(channel[1]);
      ::pause();
      ::_exit(0);
    }
    ::close(channel[1]);
    std::string name(4096, '\0');
    const ssize_t size = ::read(channel[0], name.data(), name.size());
    ::close(channel[0]);
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    return name.substr(0, size > 0 ? static_cast<std::size_t>(size) : 0);
  }

  const test::TemporaryFolder temporary_;
  const fs::path parent_ = temporary_.path();
};

TEST_F(ScratchFolderTest, IsPrivateAndRemovedWithAllThatIsInIt) {
  fs::path path;
  {
    const ScratchFolder folder(parent_, "work");
    path = folder.path();
    EXPECT_EQ(path.parent_path(), parent_);
    EXPECT_EQ(fs::status(path).permissions(), fs::perms::owner_all);
    fs::create_directories(path / "a" / "b");
    std::ofstream(path / "a" / "file") << "x";
    fs::create_symlink(parent_, path / "link");
  }
  EXPECT_FALSE(fs::exists(path));
  EXPECT_TRUE(fs::exists(parent_));
}

TEST_F(ScratchFolderTest, OfAKilledProcessIsRemovedByTheNext) {
  const fs::path left = abandoned();
  ASSERT_TRUE(fs::exists(left / "file"));
  const ScratchFolder other_kind(parent_, "logs");
  EXPECT_TRUE(fs::exists(left));
  const ScratchFolder next(parent_, "work");
  EXPECT_FALSE(fs::exists(left));
}

TEST_F(ScratchFolderTest, OfALivingProcessIsKept) {
  const ScratchFolder living(parent_, "work");
  const ScratchFolder next(parent_, "work");
  EXPECT_TRUE(fs::exists(living.path()));
}

TEST_F(ScratchFolderTest, NothingElseOfSuchANameIsRemoved) {
  const fs::path left = abandoned();
  // A copy of one, with the marker and all; folders with other markers; a link to one; a file.
  fs::copy(left, parent_ / "work-copy", fs::copy_options::recursive);
  for (const char* name : {"work-project", "work-locked", "work-empty-marker"}) fs::create_directory(parent_ / name);
  std::ofstream(parent_ / "work-locked" / "lock") << "";
  std::ofstream(parent_ / "work-empty-marker" / ".pleat-scratch") << "";
  std::ofstream(parent_ / "work-file") << "mine";
  const fs::path elsewhere = parent_ / "elsewhere";
  fs::rename(left, elsewhere);
  fs::create_directory_symlink(elsewhere, parent_ / "work-link");
  const ScratchFolder next(parent_, "work");
  for (const char* name :
       {"work-copy", "work-project", "work-locked", "work-empty-marker", "work-file", "work-link", "elsewhere/file"}) {
    EXPECT_TRUE(fs::exists(parent_ / name)) << name;
  }
}

TEST_F(ScratchFolderTest, AnotherFolderInItsPlaceIsKept) {
  std::optional<ScratchFolder> folder(std::in_place, parent_, "work");
  const fs::path path = folder->path();
  fs::rename(path, parent_ / "moved");
  fs::create_directory(path);
  std::ofstream(path / "precious") << "mine";
  folder.reset();
  EXPECT_TRUE(fs::exists(path / "precious"));
}

TEST_F(ScratchFolderTest, NeedsAParent) { EXPECT_THROW(ScratchFolder(parent_ / "missing", "work"), Error); }

}  // namespace
}  // namespace pleat
