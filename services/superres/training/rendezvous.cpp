#include "services/superres/training/rendezvous.hpp"

#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <charconv>
#include <thread>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

constexpr std::chrono::milliseconds kPause{500};

bool connects(const addrinfo& address) {
  const int socket = ::socket(address.ai_family, address.ai_socktype | SOCK_CLOEXEC, address.ai_protocol);
  if (socket < 0) return false;
  const bool connected = ::connect(socket, address.ai_addr, address.ai_addrlen) == 0;
  ::close(socket);
  return connected;
}

bool somebody_listens(const Rendezvous& place) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (::getaddrinfo(place.host.c_str(), std::to_string(place.port).c_str(), &hints, &found) != 0) return false;
  bool listens = false;
  for (const addrinfo* each = found; each != nullptr && !listens; each = each->ai_next) listens = connects(*each);
  ::freeaddrinfo(found);
  return listens;
}

}  // namespace

std::optional<Rendezvous> parse_rendezvous(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  if (colon == std::string::npos || text.find('/') != std::string::npos) return std::nullopt;
  Rendezvous place{text.substr(0, colon), 0};
  if (place.host.size() > 2 && place.host.front() == '[' && place.host.back() == ']') {
    place.host = place.host.substr(1, place.host.size() - 2);
  }
  const auto [end, failed] = std::from_chars(text.data() + colon + 1, text.data() + text.size(), place.port);
  if (failed != std::errc() || end != text.data() + text.size() || place.port == 0 || place.host.empty()) {
    return std::nullopt;
  }
  return place;
}

bool is_loopback(const Rendezvous& place) {
  return place.host == "localhost" || place.host.rfind("127.", 0) == 0 || place.host == "::1";
}

void await_listener(const Rendezvous& place, std::chrono::seconds limit, const std::atomic<bool>* stop) {
  const auto last = std::chrono::steady_clock::now() + limit;
  while (!somebody_listens(place)) {
    if (stop != nullptr && stop->load())
      throw Error(ErrorCode::kCancelled, "stopped while waiting for the first process");
    if (std::chrono::steady_clock::now() >= last) {
      throw Error(ErrorCode::kUnavailable,
                  "training processes can't meet: nobody listens at " + place.host + ":" + std::to_string(place.port));
    }
    std::this_thread::sleep_for(kPause);
  }
}

}  // namespace pleat::superres
