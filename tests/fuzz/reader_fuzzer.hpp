// Fuzzers of readers: an input is a whole file. A reader gives what is right, or throws pleat::Error; anything else is
// a finding.
#pragma once

#include <spdlog/spdlog.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::fuzz {

inline void must(bool condition) {
  if (!condition) std::abort();
}

/// Runs `read`; a pleat::Error with a message of one line is an answer.
template <typename Read>
void accept_errors(Read&& read) {
  try {
    read();
  } catch (const Error& error) {
    const std::string_view message = error.what();
    must(!message.empty() && message.find('\n') == std::string_view::npos);
  }
}

/// A file with this content, in a folder of the process's own; the next call replaces it.
inline std::filesystem::path file_with(const std::uint8_t* data, std::size_t size, const std::string& name) {
  static const test::TemporaryFolder folder;
  const std::filesystem::path path = folder.path() / name;
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  return path;
}

}  // namespace pleat::fuzz
