#include "common/rpc/trace.hpp"

#include <string>

namespace pleat::rpc {

telemetry::TraceContext trace_of(const grpc::ServerContextBase& context) {
  const auto& metadata = context.client_metadata();
  if (metadata.count(kTraceparentKey) != 1) return telemetry::new_trace();
  const grpc::string_ref given = metadata.find(kTraceparentKey)->second;
  auto trace = telemetry::parse_traceparent({given.data(), given.size()});
  if (!trace) return telemetry::new_trace();
  std::string state;
  const auto [first, last] = metadata.equal_range(kTracestateKey);
  for (auto each = first; each != last; ++each) {
    if (!state.empty()) state += ',';
    state.append(each->second.data(), each->second.size());
  }
  trace->state = telemetry::checked_tracestate(std::move(state));
  return *trace;
}

void add_trace(grpc::ClientContext& context, const telemetry::TraceContext& trace) {
  if (trace.empty()) return;
  context.AddMetadata(kTraceparentKey, telemetry::to_traceparent(telemetry::child_of(trace)));
  if (!trace.state.empty()) context.AddMetadata(kTracestateKey, trace.state);
}

}  // namespace pleat::rpc
