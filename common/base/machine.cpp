#include "common/base/machine.hpp"

#include <sys/sysinfo.h>
#include <sys/utsname.h>

#include <cmath>
#include <fstream>

#include "common/base/parallel.hpp"
#include "pleat_revision.hpp"

namespace pleat {
namespace {

/// The value of the first line "key<separator>value" of a file; empty if there is none.
std::string value_of(const char* file, const std::string& key, char separator) {
  std::ifstream stream(file);
  for (std::string line; std::getline(stream, line);) {
    if (!line.starts_with(key)) continue;
    const auto at = line.find(separator);
    if (at == std::string::npos) continue;
    const auto begin = line.find_first_not_of(" \t\"", at + 1);
    if (begin == std::string::npos) return {};
    return line.substr(begin, line.find_last_not_of(" \t\"") - begin + 1);
  }
  return {};
}

}  // namespace

std::string git_revision() { return PLEAT_GIT_REVISION; }

nlohmann::json machine_info() {
  nlohmann::json info;
  info["processor"] = value_of("/proc/cpuinfo", "model name", ':');
  info["processors"] = available_processors();
  struct sysinfo memory {};
  if (::sysinfo(&memory) == 0) {
    const double gib = static_cast<double>(memory.totalram) * memory.mem_unit / double{1u << 30};
    info["memory_gib"] = std::round(gib * 10) / 10;
  }
  struct utsname kernel {};
  std::string system = value_of("/etc/os-release", "PRETTY_NAME", '=');
  if (::uname(&kernel) == 0) system += std::string(", ") + kernel.sysname + " " + kernel.release;
  info["system"] = system;
  return info;
}

}  // namespace pleat
