// Who calls, and what they may do.
#pragma once

#include <grpcpp/server_context.h>

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "common/base/error.hpp"
#include "common/base/reloaded_file.hpp"

namespace pleat::rpc {

/// In rising order of power.
enum class Role {
  kWatcher,  ///< reads everybody's jobs, changes and makes nothing
  kUser,     ///< makes jobs and sessions, and sees its own
  kAdmin,    ///< everything of everybody
};
/// "watcher", "user", "admin".
std::string_view to_string(Role role);
std::optional<Role> role_named(std::string_view name);

/// A call that its caller may not make: UNAUTHENTICATED (nobody knows who calls) or PERMISSION_DENIED. The caller's
/// side sees kFailedPrecondition.
class CallRefused : public Error {
 public:
  CallRefused(grpc::StatusCode status, const std::string& message)
      : Error(ErrorCode::kFailedPrecondition, message), status_(status) {}
  grpc::StatusCode status() const { return status_; }

 private:
  grpc::StatusCode status_;
};

struct Caller {
  std::string name;  ///< the owner of what it makes, and whose limits count
  Role role = Role::kUser;
  std::string host;  ///< "ipv4:10.0.0.7", "unix"

  /// For logs: "alice (user) at ipv4:10.0.0.7".
  std::string describe() const;
};

/// The name of everybody who reaches a local address without certificate and token.
inline constexpr const char* kLocalName = "local";

/// Whose secret is whose, from a file with lines
///     NAME ROLE TOKEN
/// Empty lines and those that begin with '#' say nothing. A token has at least 16 characters.
class TokenTable {
 public:
  /// Throws kNotFound, kInvalidArgument (naming the line), or kFailedPrecondition if others than its owner may read it.
  explicit TokenTable(const std::filesystem::path& file);

  struct Bearer {
    std::string name;
    Role role = Role::kUser;
  };
  /// Null for a token that is none. Compares with every one, in the same time wherever they differ.
  const Bearer* find(std::string_view token) const;

 private:
  std::map<std::string, Bearer> bearers_;  ///< by token
};

/// Tells who makes a call. Thread-safe.
/// With a client certificate: its common name; the role is the organisational unit that names one ("OU=admin"), else
/// user: who signs certificates decides. Without: with a token table the bearer of the token in the metadata
/// ("authorization: Bearer TOKEN"), and nobody else; without a table kLocalName, an admin: who reaches a Unix socket or
/// loopback of a service without tokens is trusted.
class Callers {
 public:
  /// token_file: empty for none; read again when it changes. Throws as TokenTable.
  explicit Callers(const std::string& token_file = {});

  /// Throws CallRefused (UNAUTHENTICATED): a certificate without a usable common name, no token where one is needed, a
  /// wrong one.
  Caller identify(const grpc::ServerContextBase& context) const;

 private:
  const std::unique_ptr<ReloadedFile<TokenTable>> tokens_;
};

/// The metadata that carries a token.
inline constexpr const char* kTokenKey = "authorization";
inline constexpr const char* kTokenPrefix = "Bearer ";

/// The token in a file of one line. Throws kNotFound or kInvalidArgument, naming the file.
std::string read_token(const std::string& file);

/// The host of what gRPC calls a peer ("ipv4:10.0.0.7:4242", "ipv6:%5B::1%5D:4242", "unix:").
std::string host_of_peer(const std::string& peer);

}  // namespace pleat::rpc
