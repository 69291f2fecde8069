#include "common/telemetry/page_server.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <cstdint>
#include <cstring>
#include <string_view>
#include <thread>

#include "common/base/error.hpp"

namespace pleat::telemetry {
namespace {

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }

 private:
  int fd_;
};

sockaddr_in parse(const std::string& address) {
  const auto colon = address.rfind(':');
  const std::string host = address.substr(0, colon) == "localhost" ? "127.0.0.1" : address.substr(0, colon);
  std::uint16_t port = 0;
  sockaddr_in result{};
  result.sin_family = AF_INET;
  const char* const end = address.data() + address.size();
  const char* const digits = colon == std::string::npos ? end : address.data() + colon + 1;
  const auto parsed = std::from_chars(digits, end, port);
  if (digits == end || parsed.ec != std::errc{} || parsed.ptr != end ||
      inet_pton(AF_INET, host.c_str(), &result.sin_addr) != 1)
    throw_invalid_argument("metrics address " + address + " is not HOST:PORT (IPv4 or localhost)");
  result.sin_port = htons(port);
  return result;
}

void send_all(int fd, std::string_view text) {
  while (!text.empty()) {
    const ssize_t sent = send(fd, text.data(), text.size(), MSG_NOSIGNAL);
    if (sent <= 0) return;
    text.remove_prefix(static_cast<std::size_t>(sent));
  }
}

}  // namespace

struct PageServer::State {
  State(int listener, std::function<std::string()> make_page)
      : socket(listener), stop(eventfd(0, EFD_CLOEXEC)), page(std::move(make_page)) {}

  void answer(int fd) const {
    const timeval patience{2, 0};
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof(patience));
    setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof(patience));
    std::string request;
    std::array<char, 1024> buffer;
    while (request.find("\r\n\r\n") == std::string::npos && request.size() < 8192) {
      const ssize_t got = recv(fd, buffer.data(), buffer.size(), 0);
      if (got <= 0) return;
      request.append(buffer.data(), static_cast<std::size_t>(got));
    }
    const bool found = request.rfind("GET /metrics ", 0) == 0 || request.rfind("GET /metrics?", 0) == 0;
    const std::string body = found ? page() : "see /metrics\n";
    send_all(fd, std::string("HTTP/1.0 ") + (found ? "200 OK" : "404 Not Found") +
                     "\r\nContent-Type: text/plain; version=0.0.4; charset=utf-8\r\nContent-Length: " +
                     std::to_string(body.size()) + "\r\nConnection: close\r\n\r\n" + body);
  }

  void run() const {
    std::array<pollfd, 2> watched{pollfd{socket.get(), POLLIN, 0}, pollfd{stop.get(), POLLIN, 0}};
    for (;;) {
      if (poll(watched.data(), watched.size(), -1) < 0 && errno != EINTR) return;
      if (watched[1].revents != 0) return;
      if (watched[0].revents == 0) continue;
      const Descriptor client(accept4(socket.get(), nullptr, nullptr, SOCK_CLOEXEC));
      if (client.get() >= 0) answer(client.get());
    }
  }

  Descriptor socket, stop;
  std::function<std::string()> page;
  std::thread thread;
};

PageServer::PageServer(const std::string& address, std::function<std::string()> page) {
  const sockaddr_in where = parse(address);
  state_ = std::make_unique<State>(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0), std::move(page));
  const int fd = state_->socket.get(), yes = 1;
  setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes));
  if (bind(fd, reinterpret_cast<const sockaddr*>(&where), sizeof(where)) != 0 || listen(fd, 16) != 0)
    throw Error(ErrorCode::kUnavailable, "metrics can't be served at " + address + ": " + std::strerror(errno));
  state_->thread = std::thread([state = state_.get()] { state->run(); });
}

PageServer::~PageServer() {
  const std::uint64_t one = 1;
  if (write(state_->stop.get(), &one, sizeof(one)) == sizeof(one)) state_->thread.join();
}

}  // namespace pleat::telemetry
