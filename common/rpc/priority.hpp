// Calls whose work may wait for that of others: a job's beside live sessions. Where processors are short, somebody
// waits for a live frame, and nobody for a job's.
#pragma once

#include <grpcpp/client_context.h>
#include <grpcpp/server_context.h>

#include <optional>
#include <system_error>
#include <thread>
#include <utility>

#include "common/base/thread_priority.hpp"

namespace pleat::rpc {

/// Says so in the call's metadata.
void add_background(grpc::ClientContext& context);

/// Whether the caller says so.
bool is_background(const grpc::ServerContextBase& context);

/// Returns what `work` returns, which must not throw. A background call has it done in a thread of its own, because a
/// thread that has lowered its priority may not raise it again; all threads that `work` starts have the lower priority
/// too.
template <typename Work>
grpc::Status run_by_priority(const grpc::ServerContextBase& context, Work&& work) {
  if (!is_background(context)) return work();
  std::optional<grpc::Status> status;
  try {
    std::thread([&] {
      lower_thread_priority();
      status = work();
    }).join();
  } catch (const std::system_error&) {  // no thread to spare: as everybody else
    return work();
  }
  return *std::move(status);
}

}  // namespace pleat::rpc
