// What a file says, read again when the file has been replaced or changed: lists that change while a server runs.
#pragma once

#include <sys/stat.h>

#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

namespace pleat {

/// Thread-safe. Looks at the file's size, time and number at every get(): a system call, no reading.
template <typename Value>
class ReloadedFile {
 public:
  using Read = std::function<Value(const std::filesystem::path&)>;
  using Complaint = std::function<void(const std::string&)>;

  /// Reads it for the first time and throws what `read` throws. Later failures keep the old value and go to `complain`,
  /// once for each state of the file.
  ReloadedFile(std::filesystem::path path, Read read, Complaint complain)
      : path_(std::move(path)), read_(std::move(read)), complain_(std::move(complain)), state_(look()) {
    value_ = std::make_shared<const Value>(read_(path_));
  }

  std::shared_ptr<const Value> get() {
    const std::lock_guard lock(mutex_);
    const State now = look();
    if (!(now == state_)) {
      state_ = now;
      try {
        value_ = std::make_shared<const Value>(read_(path_));
      } catch (const std::exception& error) {
        complain_(std::string(error.what()) + "; what it said before stays in force");
      }
    }
    return value_;
  }

 private:
  struct State {
    dev_t device = 0;
    ino_t number = 0;
    off_t size = -1;
    timespec changed{};
    bool operator==(const State& other) const {
      return device == other.device && number == other.number && size == other.size &&
             changed.tv_sec == other.changed.tv_sec && changed.tv_nsec == other.changed.tv_nsec;
    }
  };
  State look() const {
    struct stat status {};
    if (::stat(path_.c_str(), &status) != 0) return {};
    return {status.st_dev, status.st_ino, status.st_size, status.st_ctim};
  }

  const std::filesystem::path path_;
  const Read read_;
  const Complaint complain_;
  std::mutex mutex_;
  State state_;
  std::shared_ptr<const Value> value_;
};

}  // namespace pleat
