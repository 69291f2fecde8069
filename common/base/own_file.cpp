#include "common/base/own_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string>
#include <system_error>

#include "common/base/error.hpp"

namespace pleat {

namespace fs = std::filesystem;

bool has_mark(const fs::path& path, FileMarks marks) {
  std::error_code ignored;
  if (!fs::is_regular_file(fs::symlink_status(path, ignored))) return false;
  std::ifstream file(path, std::ios::binary);
  std::string head(kMarkBytes, '\0');
  file.read(head.data(), static_cast<std::streamsize>(head.size()));
  head.resize(static_cast<std::size_t>(file.gcount()));
  return std::any_of(marks.begin(), marks.end(),
                     [&](std::string_view mark) { return head.find(mark) != std::string::npos; });
}

void require_absent_or(bool own, const fs::path& path) {
  std::error_code ignored;
  if (own || !fs::exists(fs::symlink_status(path, ignored))) return;
  throw Error(ErrorCode::kAlreadyExists,
              path.string() + ": is there and was not made by Pleat; move it away or choose another folder");
}

void require_replaceable(const fs::path& path, FileMarks marks) { require_absent_or(has_mark(path, marks), path); }

void set_aside(const fs::path& path) {
  for (int n = 1; n < 1000; ++n) {
    const std::string name = path.string() + ".aside-" + std::to_string(n);
    if (::renameat2(AT_FDCWD, path.c_str(), AT_FDCWD, name.c_str(), RENAME_NOREPLACE) == 0) return;
    if (errno == ENOENT) return;
    if (errno != EEXIST) break;
  }
  throw Error(ErrorCode::kResourceExhausted,
              path.string() + ": is in the way and can't be set aside: " + std::strerror(errno));
}

void take_over(const fs::path& file) {
  const mode_t mask = ::umask(0);
  ::umask(mask);
  ::chmod(file.c_str(), 0666 & ~mask);
}

void make_writable_folder(const fs::path& folder) {
  std::error_code failed;
  if (folder.empty()) throw_invalid_argument("the name of a folder is empty");
  fs::create_directories(folder, failed);
  if (!fs::is_directory(folder)) {
    throw_invalid_argument(folder.string() + (failed ? ": can't be made: " + failed.message() : ": not a folder"));
  }
  if (fs::equivalent(folder, "/", failed)) {
    throw_invalid_argument(folder.string() + ": is the root of the file system; choose another folder");
  }
  if (::access(folder.c_str(), W_OK | X_OK) != 0) throw_invalid_argument(folder.string() + ": can't be written");
}

}  // namespace pleat
