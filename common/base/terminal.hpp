// How much a program says on stderr, and whether in colours.
#pragma once

#include <string>

namespace pleat {

enum class Verbosity {
  kQuiet,    ///< errors and warnings alone
  kNormal,   ///< progress and notes, too
  kVerbose,  ///< and what is done on the way
};

/// Of this process; kNormal at its start. Set before other threads start.
void set_verbosity(Verbosity verbosity) noexcept;
Verbosity verbosity() noexcept;

/// A line on stderr, with kVerbose alone.
void say(const std::string& line);

/// True where text on this file descriptor may have colours: a terminal that is not dumb, and $NO_COLOR unset or empty.
bool has_colors(int file);

enum class Color { kRed, kYellow };
/// `text`, in this colour where stderr has colours.
std::string colored(const std::string& text, Color color);

}  // namespace pleat
