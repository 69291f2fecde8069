#include "common/rpc/status.hpp"

#include <array>
#include <exception>
#include <new>
#include <system_error>
#include <utility>

#include "common/base/bounded_text.hpp"
#include "common/rpc/caller.hpp"

namespace pleat::rpc {
namespace {

constexpr std::array<std::pair<ErrorCode, grpc::StatusCode>, 10> kCodes{{
    {ErrorCode::kInvalidArgument, grpc::StatusCode::INVALID_ARGUMENT},
    {ErrorCode::kNotFound, grpc::StatusCode::NOT_FOUND},
    {ErrorCode::kAlreadyExists, grpc::StatusCode::ALREADY_EXISTS},
    {ErrorCode::kFailedPrecondition, grpc::StatusCode::FAILED_PRECONDITION},
    {ErrorCode::kResourceExhausted, grpc::StatusCode::RESOURCE_EXHAUSTED},
    {ErrorCode::kDataLoss, grpc::StatusCode::DATA_LOSS},
    {ErrorCode::kUnavailable, grpc::StatusCode::UNAVAILABLE},
    {ErrorCode::kDeadlineExceeded, grpc::StatusCode::DEADLINE_EXCEEDED},
    {ErrorCode::kCancelled, grpc::StatusCode::CANCELLED},
    {ErrorCode::kInternal, grpc::StatusCode::INTERNAL},
}};

}  // namespace

grpc::StatusCode to_status_code(ErrorCode code) {
  for (const auto& [ours, theirs] : kCodes) {
    if (ours == code) return theirs;
  }
  return grpc::StatusCode::INTERNAL;
}

ErrorCode to_error_code(grpc::StatusCode code) {
  for (const auto& [ours, theirs] : kCodes) {
    if (theirs == code) return ours;
  }
  // Who is not known, or not allowed, is told so; another call of theirs ends the same.
  const bool refused = code == grpc::StatusCode::UNAUTHENTICATED || code == grpc::StatusCode::PERMISSION_DENIED;
  return refused ? ErrorCode::kFailedPrecondition : ErrorCode::kInternal;
}

static_assert(kMaxMessageCharacters == kMaxTextCharacters);
std::string bounded(std::string text) { return bounded_text(std::move(text)); }

bool may_pass(ErrorCode code) {
  return code == ErrorCode::kUnavailable || code == ErrorCode::kDeadlineExceeded || code == ErrorCode::kInternal;
}

grpc::Status to_status(const Error& error) { return {to_status_code(error.code()), bounded(error.what())}; }

Error to_error(const grpc::Status& status, const std::string& peer) {
  const bool no_thread = status.error_code() == grpc::StatusCode::RESOURCE_EXHAUSTED &&
                         status.error_message().find("Threadpool Exhausted") != std::string::npos;
  return {no_thread ? ErrorCode::kUnavailable : to_error_code(status.error_code()),
          bounded(peer + ": " + status.error_message())};
}

void throw_if_failed(const grpc::Status& status, const std::string& peer) {
  if (!status.ok()) throw to_error(status, peer);
}

grpc::Status current_exception_status() {
  try {
    throw;
  } catch (const CallRefused& refused) {
    return {refused.status(), bounded(refused.what())};
  } catch (const Error& error) {
    return to_status(error);
  } catch (const std::bad_alloc&) {
    return {grpc::StatusCode::RESOURCE_EXHAUSTED, "out of memory"};
  } catch (const std::system_error& error) {
    const bool no_thread = error.code() == std::errc::resource_unavailable_try_again;
    return {no_thread ? grpc::StatusCode::UNAVAILABLE : grpc::StatusCode::INTERNAL, bounded(error.what())};
  } catch (const std::exception& error) {
    return {grpc::StatusCode::INTERNAL, bounded(error.what())};
  } catch (...) {
    return {grpc::StatusCode::INTERNAL, "an exception of unknown type"};
  }
}

}  // namespace pleat::rpc
