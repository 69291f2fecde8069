// Client channels with Pleat's limits.
#pragma once

#include <grpcpp/channel.h>

#include <chrono>
#include <memory>
#include <string>

namespace pleat::rpc {

/// On both sides; a longer message ends the call with RESOURCE_EXHAUSTED.
inline constexpr int kMaxMessageBytes = 64 * 1024 * 1024;

/// Who we are, and whom we trust. PEM files: all three or none: with a client certificate both sides are verified
/// (mTLS).
struct TlsOptions {
  std::string ca_file;
  std::string certificate_file;
  std::string key_file;
  std::string server_name;  ///< client only: name in the server's certificate, if it is not the address
  std::string token_file;   ///< client only: its token's file, for a coordinator that wants one; empty: none
  std::string crl_file;     ///< server only: certificates of the authority that don't count any more; empty: none

  bool enabled() const { return !ca_file.empty() || !certificate_file.empty() || !key_file.empty(); }
};

/// Keeps gRPC up until the process ends; create_channel and Server call it. gRPC 1.51 shuts down with the last object
/// that used it, which takes up to 10 s, and takes its callback threads down with the last channel that used them,
/// where one that is made at that moment aborts the process.
void keep_grpc();

/// True for `unix:PATH` and `unix-abstract:NAME`: the peer runs on this host.
bool is_unix_address(const std::string& address);

/// True for those, and 127.0.0.0/8, [::1] or localhost with a port.
bool is_local_address(const std::string& address);

/// A channel to `address` ("unix:PATH", "HOST:PORT", "dns:///NAME:PORT"); it connects at the first call. An address
/// that is not local needs TLS, else kInvalidArgument. Thread-safe channel; limits as kMaxMessageBytes, keepalive 30 s,
/// no proxy from the environment. Each call gets a connection of its own (no sharing with other channels).
std::shared_ptr<grpc::Channel> create_channel(const std::string& address, const TlsOptions& tls = {});

/// Waits until the named service ("pleat.v1.Refinement") answers SERVING. Throws kUnavailable after `timeout`, naming
/// the service and the address.
void wait_healthy(const std::shared_ptr<grpc::Channel>& channel, const std::string& service, const std::string& address,
                  std::chrono::milliseconds timeout);

/// One health check. Throws nothing.
bool is_healthy(const std::shared_ptr<grpc::Channel>& channel, const std::string& service,
                std::chrono::milliseconds timeout);

}  // namespace pleat::rpc
