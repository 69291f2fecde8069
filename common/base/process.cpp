#include "common/base/process.hpp"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string_view>
#include <thread>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/own_file.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::milliseconds kPoll{5};
constexpr int kExecFailed = 127;
constexpr const char* kLogHeader = "log of ";

fs::path runtime_folder() {
  const char* runtime = std::getenv("XDG_RUNTIME_DIR");
  // sun_path holds 108 bytes, of which our own names need about 40.
  if (runtime != nullptr && std::strlen(runtime) > 0 && std::strlen(runtime) < 60 && ::access(runtime, W_OK) == 0)
    return runtime;
  return "/tmp";
}

/// A folder of the XDG base directories: $VARIABLE, which counts where it is absolute, else STANDARD in $HOME.
fs::path user_folder(const char* variable, const char* standard) {
  if (const char* folder = std::getenv(variable); folder != nullptr && *folder == '/') return folder;
  const char* home = std::getenv("HOME");
  return fs::path(home != nullptr && *home == '/' ? home : "/tmp") / standard;
}

std::vector<fs::path> data_folders() {
  std::vector<fs::path> folders{user_folder("XDG_DATA_HOME", ".local/share")};
  const char* variable = std::getenv("XDG_DATA_DIRS");
  std::istringstream list(variable != nullptr && *variable != '\0' ? variable : "/usr/local/share:/usr/share");
  for (std::string folder; std::getline(list, folder, ':');)
    if (folder.starts_with('/')) folders.emplace_back(folder);
  return folders;
}

}  // namespace

ChildProcess::ChildProcess(const fs::path& program, const std::vector<std::string>& arguments, const fs::path& log) {
  if (::access(program.c_str(), X_OK) != 0) throw_not_found(program.string() + ": no such executable");
  const int output = ::open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (output < 0) throw_invalid_argument(log.string() + ": can't be opened: " + std::strerror(errno));
  const std::string program_text = program.string();
  std::vector<char*> argv{const_cast<char*>(program_text.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  sigset_t none;
  ::sigemptyset(&none);
  const pid_t parent = ::getpid();

  pid_ = ::fork();
  if (pid_ == 0) {
    // Other threads may have held locks at the fork: only async-signal-safe calls until exec.
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::getppid() != parent) ::_exit(kExecFailed);
    ::setpgid(0, 0);
    ::sigprocmask(SIG_SETMASK, &none, nullptr);
    struct sigaction standard {};
    standard.sa_handler = SIG_DFL;
    for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) ::sigaction(number, &standard, nullptr);
    const int input = ::open("/dev/null", O_RDONLY);
    if (input >= 0) ::dup2(input, STDIN_FILENO);
    ::dup2(output, STDOUT_FILENO);
    ::dup2(output, STDERR_FILENO);
    ::execv(argv[0], argv.data());
    ::_exit(kExecFailed);
  }
  const int fork_error = errno;
  ::close(output);
  if (pid_ < 0)
    throw Error(ErrorCode::kResourceExhausted, program_text + ": can't be started: " + std::strerror(fork_error));
  running_ = true;
}

ChildProcess::~ChildProcess() {
  if (!running()) return;
  send(SIGKILL);
  ::waitpid(pid_, nullptr, 0);
}

ChildProcess::ChildProcess(ChildProcess&& other) noexcept
    : pid_(other.pid_), running_(std::exchange(other.running_, false)), end_reason_(std::move(other.end_reason_)) {}

ChildProcess& ChildProcess::operator=(ChildProcess&& other) noexcept {
  // The child that was ours ends with `other`.
  std::swap(pid_, other.pid_);
  std::swap(running_, other.running_);
  std::swap(end_reason_, other.end_reason_);
  return *this;
}

bool ChildProcess::running() {
  if (!running_) return false;
  int status = 0;
  const pid_t ended = ::waitpid(pid_, &status, WNOHANG);
  if (ended == 0) return true;
  running_ = false;
  if (ended < 0)
    end_reason_ = "unknown reason";
  else if (WIFSIGNALED(status))
    end_reason_ = "signal " + std::to_string(WTERMSIG(status));
  else
    end_reason_ = "exit code " + std::to_string(WEXITSTATUS(status));
  return false;
}

void ChildProcess::send(int signal_number) {
  if (running_) ::kill(pid_, signal_number);
}

bool ChildProcess::wait_until(std::chrono::steady_clock::time_point deadline) {
  while (running()) {
    if (std::chrono::steady_clock::now() >= deadline) return false;
    std::this_thread::sleep_for(kPoll);
  }
  return true;
}

PrivateFolder::PrivateFolder() : ScratchFolder(runtime_folder(), "pleat") {}

void begin_log(const fs::path& log, const std::string& program) {
  const std::string header = kLogHeader + program + "\n";
  const std::string_view marks[] = {header, "ready unix:"};
  require_replaceable(log, marks);
  const int file = ::open(log.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0644);
  const bool written = file >= 0 && ::write(file, header.data(), header.size()) == static_cast<ssize_t>(header.size());
  const int cause = errno;
  if (file >= 0) ::close(file);
  if (!written) throw_invalid_argument(log.string() + ": can't be written: " + std::strerror(cause));
}

fs::path executable_folder() {
  std::error_code failed;
  const fs::path self = fs::read_symlink("/proc/self/exe", failed);
  return failed ? fs::current_path() : self.parent_path();
}

fs::path shipped_file(const fs::path& name) {
  std::error_code ignored;
  std::vector<fs::path> places;
  const fs::path self = executable_folder();
  for (fs::path folder = self; folder != folder.root_path(); folder = folder.parent_path())
    places.push_back(folder / "deploy");
  places.push_back(self.parent_path() / "share" / "pleat");
  for (const fs::path& folder : data_folders()) places.push_back(folder / "pleat");
  for (const fs::path& place : places)
    if (fs::exists(place / name, ignored)) return fs::proximate(place / name, ignored);
  return "deploy" / name;
}

fs::path state_folder(const std::string& name) {
  std::error_code ignored;
  for (fs::path folder = executable_folder(); folder != folder.root_path(); folder = folder.parent_path())
    if (fs::is_directory(folder / "deploy", ignored)) return fs::path("out") / name;
  return user_folder("XDG_STATE_HOME", ".local/state") / "pleat" / name;
}

std::string last_lines(const fs::path& file, std::size_t count) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) return {};
  constexpr std::streamoff kTail = 8192;
  stream.seekg(0, std::ios::end);
  const std::streamoff size = stream.tellg();
  stream.seekg(std::max<std::streamoff>(0, size - kTail));
  std::vector<std::string> lines;
  for (std::string line; std::getline(stream, line);)
    if (!line.empty() && !line.starts_with(kLogHeader)) lines.push_back(line);
  std::string joined;
  for (std::size_t i = lines.size() > count ? lines.size() - count : 0; i < lines.size(); ++i)
    joined += (joined.empty() ? "" : " | ") + lines[i];
  return joined;
}

}  // namespace pleat
