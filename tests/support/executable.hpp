// Runs the built executables as a user does.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace pleat::test {

/// PLEAT_BINARY_DIR/bin/NAME.
std::filesystem::path built(const std::string& name);

struct Outcome {
  int exit_code = -1;  ///< 128 + signal if a signal ended it
  std::string out, err;
  std::vector<std::string> error_lines() const;
};

/// A program with its output in files. Killed with the object.
class Background {
 public:
  Background(const std::filesystem::path& program, const std::vector<std::string>& arguments,
             const std::filesystem::path& output_stem, const std::map<std::string, std::string>& environment = {});
  ~Background();
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;

  pid_t pid() const { return pid_; }
  void send(int signal_number) const;
  /// Waits for the end.
  Outcome wait();
  /// Waits until stdout has a line that begins with `start` and returns the line; empty once the program has ended.
  std::string wait_for_line(const std::string& start);

 private:
  std::filesystem::path stem_;
  pid_t pid_ = -1;
};

Outcome run(const std::filesystem::path& program, const std::vector<std::string>& arguments,
            const std::filesystem::path& output_stem, const std::map<std::string, std::string>& environment = {});

/// Processes (not zombies) whose command line contains `text`.
std::vector<pid_t> processes_with(const std::string& text);

}  // namespace pleat::test
