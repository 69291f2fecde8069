// Options of a process: flags > environment > JSON file > default.
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

namespace pleat::config {

/// Declares options, then fills them. An option "max-vertices" of a program with the prefix PLEAT_REFINEMENT_ is the
/// flag
/// --max-vertices, the variable PLEAT_REFINEMENT_MAX_VERTICES, and the key "max_vertices" of the JSON file named by
/// --config (or PLEAT_REFINEMENT_CONFIG). An unknown flag, key, or variable with the prefix is an error that names it.
class Options {
 public:
  Options(std::string program, std::string description, std::string environment_prefix);

  /// The variable's value is its default and must outlive parse. Types: bool, integers, double/float, std::string,
  /// std::vector<std::string> (repeated flag; comma-separated in the environment; array in JSON).
  template <typename T>
  Options& add(const std::string& name, T& value, const std::string& help) {
    Entry entry;
    entry.name = name;
    entry.help = help;
    if constexpr (std::is_same_v<T, bool>) {
      entry.kind = Kind::kBool;
    } else if constexpr (std::is_same_v<T, std::vector<std::string>>) {
      entry.kind = Kind::kList;
    } else if constexpr (std::is_same_v<T, std::string>) {
      entry.kind = Kind::kString;
    } else {
      static_assert(std::is_arithmetic_v<T>);
      entry.kind = std::is_integral_v<T> ? Kind::kInteger : Kind::kNumber;
    }
    entry.set = [&value, name](const std::vector<std::string>& texts) { assign(name, texts, value); };
    entry.get = [&value] { return describe(value); };
    entries_.push_back(std::move(entry));
    return *this;
  }

  /// Fills the variables. Returns false if help, the version or the manual (common/base/manual.hpp) was asked for, and
  /// given. Throws kInvalidArgument, naming the option
  /// and where its value came from; kNotFound for a missing configuration file.
  bool parse(int argc, const char* const* argv);

  /// The values in force, as one line of JSON. After parse.
  std::string effective() const;

  std::string help() const;

 private:
  enum class Kind { kBool, kInteger, kNumber, kString, kList };
  struct Entry {
    std::string name;
    std::string help;
    Kind kind = Kind::kString;
    std::function<void(const std::vector<std::string>&)> set;
    std::function<std::string()> get;  ///< as JSON
  };

  static void assign(const std::string& name, const std::vector<std::string>& texts, bool& value);
  static void assign(const std::string& name, const std::vector<std::string>& texts, std::string& value);
  static void assign(const std::string& name, const std::vector<std::string>& texts, std::vector<std::string>& value);
  static long long to_integer(const std::string& name, const std::vector<std::string>& texts, long long minimum,
                              unsigned long long maximum);
  static double to_number(const std::string& name, const std::vector<std::string>& texts);
  template <typename T>
  static void assign(const std::string& name, const std::vector<std::string>& texts, T& value) {
    if constexpr (std::is_integral_v<T>) {
      constexpr auto lowest = static_cast<long long>(std::numeric_limits<T>::lowest());
      constexpr auto highest = static_cast<unsigned long long>(std::numeric_limits<T>::max());
      value = static_cast<T>(to_integer(name, texts, lowest, highest));
    } else {
      value = static_cast<T>(to_number(name, texts));
    }
  }

  static std::string describe(bool value);
  static std::string describe(double value);
  static std::string describe(const std::string& value);
  static std::string describe(const std::vector<std::string>& value);
  template <typename T>
  static std::string describe(const T& value) {
    if constexpr (std::is_integral_v<T>) {
      return std::to_string(value);
    } else {
      return describe(static_cast<double>(value));
    }
  }

  std::string program_, description_, prefix_;
  std::vector<Entry> entries_;
};

}  // namespace pleat::config
