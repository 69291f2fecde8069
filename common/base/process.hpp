// Child processes that never outlive us, and a private folder for their sockets.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "common/base/scratch_folder.hpp"

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

/// A scratch folder with a short path, below $XDG_RUNTIME_DIR or /tmp.
class PrivateFolder : public ScratchFolder {
 public:
  PrivateFolder();
};

/// Begins the log of a program anew: its first line is "log of PROGRAM". Throws kAlreadyExists if what lies there is no
/// such log, kInvalidArgument if it can't be written.
void begin_log(const std::filesystem::path& log, const std::string& program);

/// The folder that this executable lies in.
std::filesystem::path executable_folder();

/// What comes with Pleat, by its name below deploy/: "garments/tablecloth.obj". Looked for in the deploy/ of the
/// folders that this executable lies in (a build), in share/pleat/ beside its bin/ (an installation), then in pleat/ of
/// $XDG_DATA_HOME (~/.local/share) and $XDG_DATA_DIRS. Given relative to the current folder. Where it is in none of
/// them, deploy/NAME, so that messages name it.
std::filesystem::path shipped_file(const std::filesystem::path& name);

/// Where programs keep what they are not told to put elsewhere: out/NAME below the current folder in a build, else
/// $XDG_STATE_HOME/pleat/NAME (~/.local/state).
std::filesystem::path state_folder(const std::string& name);

/// The last `count` lines that are neither empty nor the first of begin_log, joined by " | "; empty if there is no such
/// file. Reads 8 KiB at most.
std::string last_lines(const std::filesystem::path& file, std::size_t count);

}  // namespace pleat
