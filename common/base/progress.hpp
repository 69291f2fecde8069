// Progress of long work: a bar on a terminal, plain lines otherwise. Always on stderr; stdout stays for results.
// A quiet program (terminal.hpp) shows its lines alone.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace pleat {

class Progress {
 public:
  /// total: frames (or other things) to do, 0 if unknown.
  Progress(std::string label, std::uint64_t total);
  /// Ends the line of the bar.
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// On a terminal at most ten times a second; otherwise one line for every tenth of the total.
  void update(std::uint64_t done, const std::string& note = {});
  /// A line for people, above the bar.
  void line(const std::string& text);
  /// The last state, always shown.
  void finish(const std::string& note = {});

 private:
  void show(const std::string& note, bool last);

  std::string label_;
  std::uint64_t total_, done_ = 0, next_line_ = 0;
  bool terminal_, finished_ = false, shown_ = false;
  std::chrono::steady_clock::time_point start_, last_shown_;
};

}  // namespace pleat
