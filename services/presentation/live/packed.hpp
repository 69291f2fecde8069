// The form in which meshes and frames go to the live page: a JSON object and arrays.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

namespace pleat::presentation {

/// Bytes of a message, little-endian: the length H of the JSON text (uint32), the text, filled up with spaces so that
/// 4 + H is a multiple of 4, then the arrays of 32-bit numbers, one behind the other. `arrays` in the text lists them
/// in their order: [{"name", "type": "float32" | "uint32", "length"}].
class Packed {
 public:
  /// About everything but the arrays; "arrays" is ours.
  nlohmann::json about = nlohmann::json::object();

  void add(const std::string& name, std::span<const float> values);
  void add(const std::string& name, std::span<const std::uint32_t> values);

  std::string bytes() const;

 private:
  void append(const std::string& name, const char* type, std::span<const std::byte> bytes);

  nlohmann::json arrays_ = nlohmann::json::array();
  std::vector<std::byte> values_;
};

}  // namespace pleat::presentation
