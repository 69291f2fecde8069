#include "services/presentation/live/packed.hpp"

#include <bit>
#include <cstring>

namespace pleat::presentation {

static_assert(std::endian::native == std::endian::little, "arrays are sent as they lie in memory");

void Packed::add(const std::string& name, std::span<const float> values) {
  append(name, "float32", std::as_bytes(values));
}

void Packed::add(const std::string& name, std::span<const std::uint32_t> values) {
  append(name, "uint32", std::as_bytes(values));
}

void Packed::append(const std::string& name, const char* type, std::span<const std::byte> bytes) {
  arrays_.push_back({{"name", name}, {"type", type}, {"length", bytes.size() / 4}});
  values_.insert(values_.end(), bytes.begin(), bytes.end());
}

std::string Packed::bytes() const {
  nlohmann::json whole = about;
  whole["arrays"] = arrays_;
  std::string text = whole.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  text.resize((text.size() + 3) / 4 * 4, ' ');
  const auto length = static_cast<std::uint32_t>(text.size());
  std::string out(sizeof length + text.size() + values_.size(), '\0');
  std::memcpy(out.data(), &length, sizeof length);
  std::memcpy(out.data() + sizeof length, text.data(), text.size());
  if (!values_.empty()) std::memcpy(out.data() + sizeof length + text.size(), values_.data(), values_.size());
  return out;
}

}  // namespace pleat::presentation
