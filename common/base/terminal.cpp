#include "common/base/terminal.hpp"

#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <string_view>

namespace pleat {
namespace {

std::atomic<Verbosity> current{Verbosity::kNormal};

std::string_view variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

void set_verbosity(Verbosity verbosity) noexcept { current = verbosity; }

Verbosity verbosity() noexcept { return current; }

void say(const std::string& line) {
  if (verbosity() == Verbosity::kVerbose) std::fprintf(stderr, "%s\n", line.c_str());
}

bool has_colors(int file) {
  return ::isatty(file) == 1 && variable("NO_COLOR").empty() && variable("TERM") != "dumb" && !variable("TERM").empty();
}

std::string colored(const std::string& text, Color color) {
  if (!has_colors(STDERR_FILENO)) return text;
  return (color == Color::kRed ? "\033[1;31m" : "\033[1;33m") + text + "\033[0m";
}

}  // namespace pleat
