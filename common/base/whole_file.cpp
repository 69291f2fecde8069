#include "common/base/whole_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <random>
#include <string>
#include <system_error>
#include <utility>

#include "common/base/error.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr int kAttempts = 100;

std::string random_ending() {
  constexpr char kLetters[] = "0123456789abcdefghijklmnopqrstuvwxyz";
  std::random_device random;
  std::string ending = ".tmp-";
  for (int i = 0; i < 6; ++i) ending += kLetters[random() % 36];
  return ending;
}

[[noreturn]] void fail(const fs::path& path, const char* what) {
  throw Error(ErrorCode::kResourceExhausted, path.string() + ": " + what + ": " + std::strerror(errno));
}

bool sync(const fs::path& path, int flags) {
  const int file = ::open(path.c_str(), flags | O_CLOEXEC);
  if (file < 0) return false;
  const bool done = ::fsync(file) == 0;
  const int cause = errno;
  ::close(file);
  errno = cause;
  return done;
}

}  // namespace

WholeFile::WholeFile(fs::path path) : path_(std::move(path)), file_(nullptr, &std::fclose) {
  std::error_code ignored;
  const fs::file_status there = fs::symlink_status(path_, ignored);
  if (fs::exists(there) && !fs::is_regular_file(there) && !fs::is_symlink(there)) {
    throw_invalid_argument(path_.string() + ": is no file and can't be written");
  }
  int descriptor = -1;
  for (int attempt = 0; attempt < kAttempts && descriptor < 0; ++attempt) {
    temporary_ = path_.string() + random_ending();
    descriptor = ::open(temporary_.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor < 0 && errno != EEXIST) break;
  }
  if (descriptor < 0) throw_invalid_argument(path_.string() + ": can't be written: " + std::strerror(errno));
  file_.reset(::fdopen(descriptor, "w+b"));
}

WholeFile::~WholeFile() {
  if (temporary_.empty()) return;
  file_.reset();
  std::error_code ignored;
  fs::remove(temporary_, ignored);
}

void WholeFile::commit() {
  if (std::fflush(file_.get()) != 0 || std::ferror(file_.get()) != 0) fail(path_, "can't be written");
  file_.reset();
  publish_file(temporary_, path_);
  temporary_.clear();
}

void publish_file(const fs::path& temporary, const fs::path& path) {
  if (!sync(temporary, O_RDONLY)) fail(path, "can't be written");
  if (::rename(temporary.c_str(), path.c_str()) != 0) fail(path, "can't be replaced");
  // So that the new name outlives a power cut. Some file systems can't do it for folders; the content is safe then too.
  sync(path.has_parent_path() ? path.parent_path() : fs::path("."), O_RDONLY | O_DIRECTORY);
}

void write_whole_file(const fs::path& path, std::string_view content) {
  std::error_code ignored;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), ignored);
  WholeFile file(path);
  file.write(content);
  file.commit();
}

}  // namespace pleat
