// Who calls.
#pragma once

#include <grpcpp/server_context.h>

#include <string>

namespace pleat::rpc {

/// One name for all connections of a client, for limits and logs: "certificate NAME" of a client that shows one, else
/// the host ("ipv4:10.0.0.7", "unix").
std::string caller(const grpc::ServerContextBase& context);

/// The host of what gRPC calls a peer ("ipv4:10.0.0.7:4242", "ipv6:%5B::1%5D:4242", "unix:").
std::string host_of_peer(const std::string& peer);

}  // namespace pleat::rpc
