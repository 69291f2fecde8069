// Messages that echo input, kept to a length that a line, a log and gRPC's metadata can carry.
#pragma once

#include <cstddef>
#include <string>

namespace pleat {

inline constexpr std::size_t kMaxTextCharacters = 1000;

/// The text with its middle left out if it is longer than kMaxTextCharacters.
inline std::string bounded_text(std::string text) {
  if (text.size() <= kMaxTextCharacters) return text;
  constexpr std::size_t kEnd = 200;
  const std::string omission = " ... (" + std::to_string(text.size()) + " characters) ... ";
  return text.substr(0, kMaxTextCharacters - kEnd - omission.size()) + omission + text.substr(text.size() - kEnd);
}

}  // namespace pleat
