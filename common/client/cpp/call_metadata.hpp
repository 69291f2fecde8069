// What every call of a client carries.
#pragma once

#include <grpcpp/client_context.h>

#include <string>

#include "common/rpc/caller.hpp"
#include "common/rpc/trace.hpp"

namespace pleat::client {

struct CallMetadata {
  std::string authorization;      ///< with a token; empty: none
  telemetry::TraceContext trace;  ///< empty: none

  void add_to(grpc::ClientContext& context) const {
    if (!authorization.empty()) context.AddMetadata(rpc::kTokenKey, authorization);
    rpc::add_trace(context, trace);
  }
};

}  // namespace pleat::client
