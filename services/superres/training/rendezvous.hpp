// Where training processes on several machines meet: HOST:PORT, at which the first one listens.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

namespace pleat::superres {

struct Rendezvous {
  std::string host;
  std::uint16_t port = 0;
};

/// HOST:PORT, [IPV6]:PORT. Nothing if it is no such thing: a file, then.
std::optional<Rendezvous> parse_rendezvous(const std::string& text);

/// Whether the host is this machine by its loopback: then its processes need not be reached from elsewhere.
bool is_loopback(const Rendezvous& place);

/// Waits until somebody listens there. Throws kUnavailable after `limit`, kCancelled when `stop` (may be null) is set.
void await_listener(const Rendezvous& place, std::chrono::seconds limit, const std::atomic<bool>* stop);

}  // namespace pleat::superres
