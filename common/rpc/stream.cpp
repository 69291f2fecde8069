#include "common/rpc/stream.hpp"

namespace pleat::rpc {

std::uint32_t checked_window(std::uint32_t requested) {
  if (requested > kMaxWindow) {
    throw_invalid_argument("window: " + std::to_string(requested) + " frames, at most " + std::to_string(kMaxWindow));
  }
  return requested == 0 ? kDefaultWindow : requested;
}

std::unique_ptr<SharedFrames> accept_shared_frames(grpc::ServerContextBase& context, std::uint32_t window) {
  const auto offered = context.client_metadata().find(SharedFrames::kKey);
  if (offered == context.client_metadata().end() || !context.peer().starts_with("unix:")) return nullptr;
  auto shared = SharedFrames::accept({offered->second.data(), offered->second.size()}, window);
  if (shared) context.AddInitialMetadata(SharedFrames::kKey, "taken");
  return shared;
}

}  // namespace pleat::rpc
