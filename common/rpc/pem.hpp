// TLS files, for channels and servers.
#pragma once

#include <string>

#include "common/rpc/channel.hpp"

namespace pleat::rpc {

/// A PEM file's text. Throws kNotFound or kInvalidArgument with the path.
std::string read_pem(const std::string& path);

/// Throws kInvalidArgument unless all three files are named.
void check_tls(const TlsOptions& tls);

}  // namespace pleat::rpc
