// A hash for telling files and meshes apart; not against people who want two to be equal.
#pragma once

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>

namespace pleat {

/// 64-bit FNV-1a of the bytes added so far.
class Fnv64 {
 public:
  void add(std::string_view bytes) {
    for (const char c : bytes) hash_ = (hash_ ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  }
  /// 16 hexadecimal digits.
  std::string digits() const {
    char text[17];
    std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash_));
    return text;
  }

 private:
  std::uint64_t hash_ = 0xcbf29ce484222325u;
};

}  // namespace pleat
