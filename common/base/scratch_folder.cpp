#include "common/base/scratch_folder.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <system_error>

#include "common/base/error.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMarker = ".pleat-scratch";

std::string marker_text(const struct stat& folder) {
  return "pleat.scratch 1\nuser " + std::to_string(folder.st_uid) + "\nfolder " + std::to_string(folder.st_ino) + "\n";
}

/// The marker of `folder`, locked, if the folder is one of this user's that no process holds; else -1.
int lock_abandoned(const fs::path& folder) {
  struct stat status {};
  if (::lstat(folder.c_str(), &status) != 0 || !S_ISDIR(status.st_mode) || status.st_uid != ::geteuid()) return -1;
  const int marker = ::open((folder / kMarker).c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
  if (marker < 0) return -1;
  const std::string expected = marker_text(status);
  std::string text(expected.size() + 1, '\0');
  const ssize_t size = ::pread(marker, text.data(), text.size(), 0);
  text.resize(size > 0 ? static_cast<std::size_t>(size) : 0);
  if (text == expected && ::flock(marker, LOCK_EX | LOCK_NB) == 0) return marker;
  ::close(marker);
  return -1;
}

void remove_abandoned(const fs::path& parent, const std::string& prefix) {
  std::error_code ignored;
  for (const fs::directory_entry& entry : fs::directory_iterator(parent, ignored)) {
    if (!entry.path().filename().string().starts_with(prefix + "-")) continue;
    const int marker = lock_abandoned(entry.path());
    if (marker < 0) continue;
    fs::remove_all(entry.path(), ignored);
    ::close(marker);
  }
}

}  // namespace

ScratchFolder::ScratchFolder(const fs::path& parent, const std::string& prefix) {
  remove_abandoned(parent, prefix);
  std::string name = (parent / (prefix + "-XXXXXX")).string();
  const auto fail = [&name] {
    throw Error(ErrorCode::kResourceExhausted, name + ": can't be made: " + std::strerror(errno));
  };
  if (::mkdtemp(name.data()) == nullptr) fail();
  path_ = name;
  struct stat status {};
  lock_ = ::open((path_ / kMarker).c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  // The lock comes before the text: a marker without its text proves nothing to others.
  if (lock_ < 0 || ::flock(lock_, LOCK_EX | LOCK_NB) != 0 || ::lstat(name.c_str(), &status) != 0) fail();
  const std::string text = marker_text(status);
  if (::write(lock_, text.data(), text.size()) != static_cast<ssize_t>(text.size())) fail();
}

ScratchFolder::~ScratchFolder() {
  struct stat own {
  }, there{};
  if (::fstat(lock_, &own) == 0 && ::lstat((path_ / kMarker).c_str(), &there) == 0 && own.st_ino == there.st_ino &&
      own.st_dev == there.st_dev) {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  ::close(lock_);
}

}  // namespace pleat
