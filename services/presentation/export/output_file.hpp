// A file of numbers that appears under its name only when it is complete.
#pragma once

#include <bit>
#include <cstdint>

#include "common/base/hash.hpp"
#include "common/base/whole_file.hpp"

namespace pleat::presentation {

class OutputFile : public WholeFile {
 public:
  using WholeFile::WholeFile;

  void text(std::string_view bytes) {
    write(bytes);
    hash_.add(bytes);
  }

  /// A float or 32-bit integer in the byte order asked for.
  template <class T>
  void number(T value, std::endian order) {
    static_assert(sizeof(T) == 4);
    auto bits = std::bit_cast<std::uint32_t>(value);
    if (order != std::endian::native) bits = __builtin_bswap32(bits);
    text({reinterpret_cast<const char*>(&bits), sizeof bits});
  }
  /// Of what was written so far.
  std::string hash() const { return hash_.digits(); }

 private:
  Fnv64 hash_;
};

}  // namespace pleat::presentation
