#include "services/coordinator/replica_directory.hpp"

#include <arpa/inet.h>
#include <netdb.h>
#include <sys/socket.h>

#include <algorithm>
#include <optional>
#include <set>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::coordinator {
namespace {

constexpr std::string_view kScheme = "dns:///";

/// Host and port of dns:///HOST:PORT; nothing for what is no name of several replicas.
std::optional<std::pair<std::string, std::string>> name_in(const std::string& address) {
  if (address.rfind(kScheme, 0) != 0) return std::nullopt;
  const std::string rest = address.substr(kScheme.size());
  const std::size_t colon = rest.rfind(':');
  if (colon == std::string::npos || colon == 0 || rest.front() == '[') return std::nullopt;
  std::string host = rest.substr(0, colon);
  if (host == "localhost") return std::nullopt;  // one host, under two families of addresses
  return std::pair{std::move(host), rest.substr(colon + 1)};
}

std::string to_text(const addrinfo& found, const std::string& port) {
  char host[INET6_ADDRSTRLEN] = "";
  if (found.ai_family == AF_INET) {
    ::inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(found.ai_addr)->sin_addr, host, sizeof host);
    return std::string(host) + ":" + port;
  }
  ::inet_ntop(AF_INET6, &reinterpret_cast<const sockaddr_in6*>(found.ai_addr)->sin6_addr, host, sizeof host);
  std::string text = "[";
  text.append(host).append("]:").append(port);
  return text;
}

}  // namespace

std::vector<std::string> resolve_host(const std::string& host, const std::string& port) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int failed = ::getaddrinfo(host.c_str(), nullptr, &hints, &found);
  if (failed != 0) throw Error(ErrorCode::kUnavailable, host + ": " + ::gai_strerror(failed));
  std::set<std::string> of_family[2];
  for (const addrinfo* each = found; each != nullptr; each = each->ai_next) {
    if (each->ai_family == AF_INET) of_family[0].insert(to_text(*each, port));
    if (each->ai_family == AF_INET6) of_family[1].insert(to_text(*each, port));
  }
  ::freeaddrinfo(found);
  const std::set<std::string>& chosen = of_family[0].empty() ? of_family[1] : of_family[0];
  if (chosen.empty()) throw Error(ErrorCode::kUnavailable, host + ": has no address");
  return {chosen.begin(), chosen.end()};
}

ReplicaDirectory::ReplicaDirectory(std::chrono::milliseconds interval, Resolve resolve)
    : interval_(interval), resolve_(std::move(resolve)) {}

ReplicaDirectory::~ReplicaDirectory() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  stop_.notify_all();
  if (looking_.joinable()) looking_.join();
}

std::vector<std::string> ReplicaDirectory::behind(const std::vector<std::string>& configured) {
  std::vector<std::string> replicas;
  for (const std::string& address : configured) {
    const auto name = name_in(address);
    if (!name) {
      replicas.push_back(address);
      continue;
    }
    bool known = false;
    {
      const std::lock_guard lock(mutex_);
      known = names_.count(address) > 0;
    }
    if (!known) resolve(address, {name->first, name->second, {}});
    const std::lock_guard lock(mutex_);
    if (!looking_.joinable()) looking_ = std::thread([this] { look(); });
    const std::vector<std::string>& found = names_.at(address).addresses;
    if (found.empty()) replicas.push_back(address);
    replicas.insert(replicas.end(), found.begin(), found.end());
  }
  return replicas;
}

std::string ReplicaDirectory::name_of(const std::string& address) const {
  const std::lock_guard lock(mutex_);
  const auto found = name_of_.find(address);
  return found == name_of_.end() ? "" : found->second;
}

std::shared_ptr<ReplicaLoad> ReplicaDirectory::load_of(const std::string& address) {
  const std::lock_guard lock(mutex_);
  std::shared_ptr<ReplicaLoad>& load = loads_[address];
  if (!load) load = std::make_shared<ReplicaLoad>();
  return load;
}

void ReplicaDirectory::resolve(const std::string& configured, Name name) {
  std::vector<std::string> found;
  try {
    found = resolve_(name.host, name.port);
  } catch (const Error&) {  // who connects says so
  }
  const std::lock_guard lock(mutex_);
  Name& known = names_.try_emplace(configured, std::move(name)).first->second;
  if (found.empty() || found == known.addresses) return;
  for (const std::string& address : found) name_of_[address] = known.host;
  known.addresses = std::move(found);
  ++version_;
}

void ReplicaDirectory::look() {
  std::unique_lock lock(mutex_);
  while (!stop_.wait_for(lock, interval_, [this] { return stopping_; })) {
    const std::map<std::string, Name> names = names_;
    lock.unlock();
    for (const auto& [configured, name] : names) resolve(configured, name);
    lock.lock();
  }
}

std::vector<std::string> replicas_behind(const std::shared_ptr<ReplicaDirectory>& directory,
                                         const std::vector<std::string>& configured) {
  return directory ? directory->behind(configured) : configured;
}

}  // namespace pleat::coordinator
