#include "common/rpc/stream.hpp"

namespace pleat::rpc {

std::uint32_t checked_window(std::uint32_t requested) {
  if (requested > kMaxWindow) {
    throw_invalid_argument("window: " + std::to_string(requested) + " frames, at most " + std::to_string(kMaxWindow));
  }
  return requested == 0 ? kDefaultWindow : requested;
}

}  // namespace pleat::rpc
