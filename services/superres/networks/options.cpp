#include "services/superres/networks/options.hpp"

#include <algorithm>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

[[noreturn]] void refuse(const std::string& key, const std::string& what) {
  throw_invalid_argument("architecture: " + key + " " + what);
}

}  // namespace

Options::Options(const std::string& json) : given_(nlohmann::json::parse(json, nullptr, false)) {
  if (!given_.is_object()) throw_invalid_argument("architecture: no JSON object");
}

int Options::integer(const char* key, int fallback, int low, int high) {
  std::int64_t value = fallback;
  if (const auto it = given_.find(key); it != given_.end()) {
    if (!it->is_number_integer()) refuse(key, "must be a whole number");
    value = it->get<std::int64_t>();
  }
  if (value < low || value > high) {
    refuse(key, "= " + std::to_string(value) + " is outside " + std::to_string(low) + " to " + std::to_string(high));
  }
  complete_[key] = value;
  return static_cast<int>(value);
}

bool Options::flag(const char* key, bool fallback) {
  bool value = fallback;
  if (const auto it = given_.find(key); it != given_.end()) {
    if (!it->is_boolean()) refuse(key, "must be true or false");
    value = it->get<bool>();
  }
  complete_[key] = value;
  return value;
}

std::string Options::choice(const char* key, const char* fallback, std::initializer_list<const char*> choices) {
  std::string value = fallback;
  if (const auto it = given_.find(key); it != given_.end()) {
    if (!it->is_string()) refuse(key, "must be a word");
    value = it->get<std::string>();
  }
  if (std::find(choices.begin(), choices.end(), value) == choices.end()) {
    std::string all;
    for (const char* word : choices) all += std::string(all.empty() ? "'" : ", '") + word + "'";
    refuse(key, "is none of " + all + ", but '" + value + "'");
  }
  complete_[key] = value;
  return value;
}

std::string Options::finish() const {
  for (const auto& [key, value] : given_.items()) {
    if (!complete_.contains(key)) refuse("'" + key + "'", "is unknown to this kind of network");
  }
  return complete_.dump();
}

}  // namespace pleat::superres
