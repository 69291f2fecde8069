#include "common/base/lease.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <random>
#include <sstream>
#include <system_error>
#include <utility>

#include "common/base/error.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxBytes = 1024;
constexpr const char* kHeld = "held    ";  // as long as the other: a claim is changed in place
constexpr const char* kReleased = "released";

fs::path claim_file(const fs::path& folder, const std::string& name, std::uint64_t generation) {
  return folder / (name + "." + std::to_string(generation));
}

/// For people who look into the folder; the random part tells processes of one number apart.
std::string describe_self() {
  char host[256] = "unknown";
  ::gethostname(host, sizeof host - 1);
  std::random_device random;
  std::ostringstream text;
  text << host << ' ' << ::getpid() << ' ' << std::hex << random();
  return text.str();
}

/// Opened anew for each look: that is when NFS asks the server. Empty: there is no such file, or nothing in it yet.
std::optional<std::string> read_text(const fs::path& path) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return std::nullopt;
  std::string text(kMaxBytes, '\0');
  const ssize_t bytes = ::read(file, text.data(), text.size());
  ::close(file);
  text.resize(bytes > 0 ? static_cast<std::size_t>(bytes) : 0);
  return text;
}

std::string value_of(const std::string& text, const std::string& key) {
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.rfind(key + " ", 0) == 0) return line.substr(key.size() + 1);
  }
  return "";
}

}  // namespace

bool Lease::write(const char* state, bool create) {
  char counter[32];
  std::snprintf(counter, sizeof counter, "%020llu", static_cast<unsigned long long>(beats_));
  const std::string text = "pleat-lease 1\nowner " + owner_ + "\nexpiry_ms " + std::to_string(expiry_.count()) +
                           "\nstate " + state + "\nbeat " + counter + "\n";
  const int file = ::open(claim_file(folder_, name_, generation_).c_str(),
                          O_WRONLY | O_CLOEXEC | (create ? O_CREAT | O_EXCL : 0), 0666);
  if (file < 0) return false;
  const bool written = ::pwrite(file, text.data(), text.size(), 0) == static_cast<ssize_t>(text.size());
  // What an NFS client could not deliver shows here.
  return ::close(file) == 0 && written;
}

bool Lease::renew() {
  if (::access(claim_file(folder_, name_, generation_ + 1).c_str(), F_OK) == 0) return false;
  ++beats_;
  write(kHeld, false);
  return true;
}

void Lease::release() { write(kReleased, false); }

LeaseFolder::LeaseFolder(fs::path folder, std::chrono::milliseconds expiry, Clock clock)
    : folder_(std::move(folder)), owner_(describe_self()), expiry_(expiry), clock_(std::move(clock)) {
  if (expiry_.count() <= 0) throw_invalid_argument("lease: the expiry must be positive");
  std::error_code failed;
  fs::create_directories(folder_, failed);
  if (!fs::is_directory(folder_)) throw_invalid_argument(folder_.string() + ": can't be made: " + failed.message());
}

std::optional<Lease> LeaseFolder::claim(const std::string& name) {
  if (name.empty() || name.find('/') != std::string::npos) throw_invalid_argument("lease: no name: '" + name + "'");
  std::uint64_t last = seen_[name].generation;
  while (::access(claim_file(folder_, name, last + 1).c_str(), F_OK) == 0) ++last;
  if (last > 0 && !is_over(name, last)) return std::nullopt;
  Lease lease;
  lease.folder_ = folder_;
  lease.name_ = name;
  lease.owner_ = owner_;
  lease.generation_ = last + 1;
  lease.expiry_ = expiry_;
  errno = 0;
  if (lease.write(kHeld, true)) return lease;
  if (errno == EEXIST) return std::nullopt;  // somebody was quicker
  throw Error(ErrorCode::kResourceExhausted,
              claim_file(folder_, name, last + 1).string() + ": can't be made: " + std::strerror(errno));
}

bool LeaseFolder::is_over(const std::string& name, std::uint64_t generation) {
  const std::string text = read_text(claim_file(folder_, name, generation)).value_or("");
  if (value_of(text, "state") == kReleased) return true;
  Seen& seen = seen_[name];
  const auto now = clock_();
  if (seen.generation != generation || seen.text != text) {
    // A first look says nothing of how long it has been so.
    seen = {generation, text, now, seen.generation == generation};
    return false;
  }
  const long long promised = std::strtoll(value_of(text, "expiry_ms").c_str(), nullptr, 10);
  const auto expiry = promised > 0 ? std::chrono::milliseconds(promised) : expiry_;
  return now - seen.since >= expiry;
}

Holder LeaseFolder::holder(const std::string& name) const {
  const auto found = seen_.find(name);
  return found != seen_.end() && found->second.renewed ? Holder::kAlive : Holder::kUnknown;
}

}  // namespace pleat
