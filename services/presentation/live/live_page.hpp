// The live page: what a coordinator works on, in a browser on this host.
#pragma once

#include <memory>
#include <string>

#include "common/rpc/channel.hpp"

namespace pleat::presentation {

struct LivePageOptions {
  std::string listen;        ///< loopback, "127.0.0.1:8050"; port 0 lets the system choose
  std::string coordinator;   ///< its address
  rpc::TlsOptions identity;  ///< who the page is to the coordinator: jobs that this may read are shown
};

/// Throws kInvalidArgument, naming the option --page, unless `listen` is an address of this host alone.
void check_listen(const std::string& listen);

/// Serves the viewer, the list of jobs and live sessions, and the newest frames of those that are looked at, over
/// HTTP/1.1, to who knows the token in the address. Requests from pages of other origins are refused: the host that
/// they name must be this one (DNS rebinding), and nothing can be changed here. Threads of its own.
class LivePage {
 public:
  /// Throws kInvalidArgument (not an address of this host alone), kUnavailable (taken).
  explicit LivePage(const LivePageOptions& options);
  ~LivePage();
  LivePage(const LivePage&) = delete;
  LivePage& operator=(const LivePage&) = delete;

  /// "http://127.0.0.1:8050/TOKEN/", with 32 random hexadecimal digits.
  const std::string& address() const;

  /// A line that the page shows, such as a service that was started again; the newest 100 are kept.
  void note(const std::string& line);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::presentation
