// The hash of topologies, scenes and check-points. It is part of files and of the wire: the values must stay.
#pragma once

#include <cstdint>
#include <cstdio>
#include <span>
#include <string>
#include <string_view>

namespace pleat {

/// 64-bit FNV-1a over the bytes that are added.
class Hash {
 public:
  Hash& add(std::span<const std::byte> bytes) {
    for (const std::byte byte : bytes) value_ = (value_ ^ static_cast<std::uint64_t>(byte)) * 0x100000001b3ull;
    return *this;
  }
  Hash& add(std::string_view text) { return add(std::as_bytes(std::span(text))); }

  std::uint64_t value() const { return value_; }
  /// 16 hexadecimal digits.
  std::string hex() const {
    char digits[17];
    std::snprintf(digits, sizeof digits, "%016llx", static_cast<unsigned long long>(value_));
    return digits;
  }

 private:
  std::uint64_t value_ = 0xcbf29ce484222325ull;
};

}  // namespace pleat
