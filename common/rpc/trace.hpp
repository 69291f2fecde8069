// The trace context of a call, in its metadata (common/telemetry/trace.hpp).
#pragma once

#include <grpcpp/client_context.h>
#include <grpcpp/server_context.h>

#include "common/telemetry/trace.hpp"

namespace pleat::rpc {

inline constexpr const char* kTraceparentKey = "traceparent";
inline constexpr const char* kTracestateKey = "tracestate";

/// What the caller says; a new trace where it says nothing, several things, or something invalid.
telemetry::TraceContext trace_of(const grpc::ServerContextBase& context);

/// The call belongs to the trace, with a span id of its own. Nothing for an empty one.
void add_trace(grpc::ClientContext& context, const telemetry::TraceContext& trace);

}  // namespace pleat::rpc
