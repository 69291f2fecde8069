#include "common/rpc/caller.hpp"

#include <grpcpp/security/auth_context.h>

namespace pleat::rpc {

std::string host_of_peer(const std::string& peer) {
  const auto scheme = peer.find(':');
  if (peer.rfind("ipv", 0) != 0) return peer.substr(0, scheme);
  const auto port = peer.rfind(':');
  return port == scheme ? peer : peer.substr(0, port);
}

std::string caller(const grpc::ServerContextBase& context) {
  const auto auth = context.auth_context();
  if (auth && auth->IsPeerAuthenticated()) {
    for (const grpc::string_ref& name : auth->FindPropertyValues("x509_common_name")) {
      return "certificate " + std::string(name.data(), name.size());
    }
  }
  return host_of_peer(context.peer());
}

}  // namespace pleat::rpc
