// The sizes and choices of a network, read from JSON: each has a default and a range, and an unknown one is an error.
#pragma once

#include <initializer_list>
#include <nlohmann/json.hpp>
#include <string>

namespace pleat::superres {

class Options {
 public:
  /// json: an object's text. Throws kInvalidArgument if it is none.
  explicit Options(const std::string& json);

  /// Each throws kInvalidArgument, naming the key, for another type or a value out of range.
  int integer(const char* key, int fallback, int low, int high);
  bool flag(const char* key, bool fallback);
  std::string choice(const char* key, const char* fallback, std::initializer_list<const char*> choices);

  /// All that was asked for, with its values. Throws kInvalidArgument for a key that nobody asked for.
  std::string finish() const;

 private:
  nlohmann::json given_, complete_ = nlohmann::json::object();
};

}  // namespace pleat::superres
