#include "tests/support/executable.hpp"

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace pleat::test {
namespace {

namespace fs = std::filesystem;

std::string read(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

}  // namespace

fs::path built(const std::string& name) {
  const char* folder = std::getenv("PLEAT_BINARY_DIR");
  return fs::path(folder != nullptr ? folder : "build") / "bin" / name;
}

std::vector<std::string> Outcome::error_lines() const {
  std::vector<std::string> lines;
  std::istringstream stream(err);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

Background::Background(const fs::path& program, const std::vector<std::string>& arguments, const fs::path& output_stem,
                       const std::map<std::string, std::string>& environment)
    : stem_(output_stem) {
  if (!fs::exists(program)) throw std::runtime_error(program.string() + " is not built");
  pid_ = ::fork();
  if (pid_ != 0) return;
  for (const auto& [name, value] : environment) ::setenv(name.c_str(), value.c_str(), 1);
  ::dup2(::open((stem_.string() + ".out").c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600), STDOUT_FILENO);
  ::dup2(::open((stem_.string() + ".err").c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600), STDERR_FILENO);
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  ::execv(argv[0], argv.data());
  ::_exit(127);
}

Background::~Background() {
  if (pid_ <= 0) return;
  ::kill(pid_, SIGKILL);
  ::waitpid(pid_, nullptr, 0);
}

void Background::send(int signal_number) const { ::kill(pid_, signal_number); }

Outcome Background::wait() {
  int status = 0;
  ::waitpid(pid_, &status, 0);
  pid_ = -1;
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), read(stem_.string() + ".out"),
          read(stem_.string() + ".err")};
}

std::string Background::wait_for_line(const std::string& start) {
  while (true) {
    siginfo_t info{};
    const bool ended =
        ::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid != 0;
    std::istringstream stream(read(stem_.string() + ".out"));
    for (std::string line; std::getline(stream, line);)
      if (line.starts_with(start) && !stream.eof()) return line;
    if (ended) return {};
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

Outcome run(const fs::path& program, const std::vector<std::string>& arguments, const fs::path& output_stem,
            const std::map<std::string, std::string>& environment) {
  return Background(program, arguments, output_stem, environment).wait();
}

std::vector<pid_t> processes_with(const std::string& text) {
  std::vector<pid_t> found;
  for (const fs::directory_entry& entry : fs::directory_iterator("/proc")) {
    const std::string name = entry.path().filename().string();
    if (name.find_first_not_of("0123456789") != std::string::npos) continue;
    std::string command = read(entry.path() / "cmdline");  // empty for zombies
    std::replace(command.begin(), command.end(), '\0', ' ');
    if (command.find(text) != std::string::npos) found.push_back(std::stoi(name));
  }
  return found;
}

}  // namespace pleat::test
