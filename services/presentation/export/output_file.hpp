// A file that appears under its name only when it is complete.
#pragma once

#include <bit>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string_view>

namespace pleat::presentation {

/// Writes PATH.tmp; commit() renames it. Without commit() the destructor removes it.
class OutputFile {
 public:
  /// Throws kInvalidArgument if the file can't be made.
  explicit OutputFile(std::filesystem::path path);
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  void text(std::string_view characters);

  /// A float or 32-bit integer in the byte order asked for.
  template <class T>
  void number(T value, std::endian order) {
    static_assert(sizeof(T) == 4);
    auto bits = std::bit_cast<std::uint32_t>(value);
    if (order != std::endian::native) bits = __builtin_bswap32(bits);
    file_.write(reinterpret_cast<const char*>(&bits), sizeof bits);
  }

  /// Throws kResourceExhausted if something could not be written.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path temporary_;
  std::ofstream file_;
  bool committed_ = false;
};

}  // namespace pleat::presentation
