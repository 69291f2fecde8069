#include "common/rpc/priority.hpp"

#include <string_view>

namespace pleat::rpc {
namespace {

constexpr const char* kKey = "pleat-priority";
constexpr std::string_view kBackground = "background";

}  // namespace

void add_background(grpc::ClientContext& context) { context.AddMetadata(kKey, std::string(kBackground)); }

bool is_background(const grpc::ServerContextBase& context) {
  const auto& metadata = context.client_metadata();
  const auto found = metadata.find(kKey);
  return found != metadata.end() && std::string_view(found->second.data(), found->second.size()) == kBackground;
}

}  // namespace pleat::rpc
