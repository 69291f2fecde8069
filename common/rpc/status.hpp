// The one place where pleat::Error and gRPC's status become each other.
#pragma once

#include <grpcpp/support/status.h>

#include <string>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::rpc {

grpc::StatusCode to_status_code(ErrorCode code);
/// Codes that Pleat does not use (UNKNOWN, ABORTED, UNIMPLEMENTED, ...) become kInternal; OK is not allowed.
ErrorCode to_error_code(grpc::StatusCode code);

/// Messages are cut to kMaxMessageCharacters: they echo input, and gRPC sends them as metadata, which is limited.
inline constexpr std::size_t kMaxMessageCharacters = 1000;
grpc::Status to_status(const Error& error);

/// The text with its middle left out if it is longer than kMaxMessageCharacters.
std::string bounded(std::string text);

/// Whether the same call may succeed later: the peer was away, hung, had no thread to spare, or failed in a way that
/// may be passing. A limit that the input exceeds (kResourceExhausted) does not pass; who is full for the moment says
/// kUnavailable. The one place that decides what is tried again.
bool may_pass(ErrorCode code);

/// `peer` ("refinement at unix:/run/pleat/refinement.sock") goes before the message. gRPC's own "threadpool exhausted"
/// becomes kUnavailable.
Error to_error(const grpc::Status& status, const std::string& peer);

/// Throws to_error unless the status is OK.
void throw_if_failed(const grpc::Status& status, const std::string& peer);

/// The status of the exception that is being handled: pleat::Error by its code, bad_alloc as RESOURCE_EXHAUSTED, a
/// thread that the system refuses as UNAVAILABLE, everything else as INTERNAL. To be called in a catch block only.
grpc::Status current_exception_status();

/// Runs a handler's body so that no exception crosses gRPC. `body` returns void or a grpc::Status.
template <typename Body>
grpc::Status guard(Body&& body) noexcept {
  try {
    if constexpr (std::is_void_v<decltype(body())>) {
      std::forward<Body>(body)();
      return grpc::Status::OK;
    } else {
      return std::forward<Body>(body)();
    }
  } catch (...) {
    return current_exception_status();
  }
}

}  // namespace pleat::rpc
