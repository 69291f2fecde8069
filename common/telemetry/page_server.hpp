// One page over HTTP/1.0: all that a Prometheus scrape needs.
#pragma once

#include <functional>
#include <memory>
#include <string>

namespace pleat::telemetry {

/// Serves `page()` at /metrics of HOST:PORT on one thread, one request at a time; everything else is 404. A client that
/// does not ask within two seconds is dropped. Its thread has a full stack: prometheus-cpp's own server runs on stacks
/// of 100 KiB, which do not hold the thread-local storage of programs that link LibTorch or OpenBLAS.
class PageServer {
 public:
  /// address: IPv4 or "localhost", and a port; port 0 lets the system choose. Throws kInvalidArgument (not an address),
  /// kUnavailable (taken).
  PageServer(const std::string& address, std::function<std::string()> page);
  ~PageServer();
  PageServer(const PageServer&) = delete;
  PageServer& operator=(const PageServer&) = delete;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::telemetry
