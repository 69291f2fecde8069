#include "common/base/signals.hpp"

#include <unistd.h>

#include <csignal>
#include <initializer_list>

namespace pleat {
namespace {

volatile std::sig_atomic_t stop_requested = 0;

extern "C" void on_signal(int number) {
  if (stop_requested != 0) ::_exit(128 + number);
  stop_requested = 1;
}

}  // namespace

void install_signal_handlers() {
  struct sigaction action {};
  action.sa_handler = on_signal;
  ::sigemptyset(&action.sa_mask);
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) ::sigaction(number, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
}

void restore_signal_handlers() {
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) std::signal(number, SIG_DFL);
}

bool interrupted() noexcept { return stop_requested != 0; }

}  // namespace pleat
