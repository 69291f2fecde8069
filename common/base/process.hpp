// Child processes that never outlive us, and a private folder for their sockets.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace pleat {

/// A child with its output in a file. It has a process group of its own, so that Ctrl-C on the terminal reaches the
/// parent alone, and gets SIGKILL from the kernel when the thread that started it ends: start it from the main thread.
class ChildProcess {
 public:
  /// Runs `program` with `arguments` (without argv[0]); stdout and stderr are appended to `log`.
  /// Throws kNotFound (no such executable), kResourceExhausted (fork), kInvalidArgument (log can't be opened).
  ChildProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
               const std::filesystem::path& log);
  /// Kills it if it still runs.
  ~ChildProcess();
  ChildProcess(ChildProcess&& other) noexcept;
  ChildProcess& operator=(ChildProcess&& other) noexcept;

  pid_t pid() const { return pid_; }
  /// Collects the exit status if there is one.
  bool running();
  /// "exit code 1" or "signal 11"; empty while it runs.
  const std::string& end_reason() const { return end_reason_; }

  void send(int signal_number);
  /// Waits until it has ended; false after the deadline.
  bool wait_until(std::chrono::steady_clock::time_point deadline);

 private:
  pid_t pid_ = -1;
  bool running_ = false;
  std::string end_reason_;
};

/// A folder of mode 0700 with a short path, below $XDG_RUNTIME_DIR or /tmp, removed with the object. A process that
/// was killed leaves its folder behind; the next one that makes a folder removes it (an flock tells the living).
class PrivateFolder {
 public:
  PrivateFolder();
  ~PrivateFolder();
  PrivateFolder(const PrivateFolder&) = delete;
  PrivateFolder& operator=(const PrivateFolder&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  int lock_ = -1;
};

/// The folder that this executable lies in.
std::filesystem::path executable_folder();

/// The last `count` lines that are not empty, joined by " | "; empty if there is no such file. Reads 8 KiB at most.
std::string last_lines(const std::filesystem::path& file, std::size_t count);

}  // namespace pleat
