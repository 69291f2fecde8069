// The one exception type of Pleat. Libraries throw it; common/rpc turns it into a gRPC status, in one place.
#pragma once

#include <stdexcept>
#include <string>
#include <string_view>

namespace pleat {

/// The kinds of failure. They map one to one to gRPC status codes of the same name.
enum class ErrorCode {
  kInvalidArgument,     ///< the input is wrong; sending it again can't help
  kNotFound,            ///< a named thing (file, vertex, bundle, job) does not exist
  kAlreadyExists,       ///< a named thing exists and must not be overwritten
  kFailedPrecondition,  ///< right input at the wrong time (no topology yet, job already ended)
  kResourceExhausted,   ///< a limit, the disk or the memory is reached
  kDataLoss,            ///< stored data are truncated or corrupt
  kUnavailable,         ///< a service can't be reached now; trying again may help
  kDeadlineExceeded,    ///< no answer in time
  kCancelled,           ///< the caller gave up
  kInternal,            ///< a bug or a broken invariant of ours
};

/// The code's name as in gRPC, for example "INVALID_ARGUMENT".
std::string_view to_string(ErrorCode code);

/// A failure with a code and a message of one line that names the culprit (file, key, vertex, address). Messages echo
/// what came from elsewhere: each control character in them becomes a space.
class Error : public std::runtime_error {
 public:
  Error(ErrorCode code, const std::string& message);
  ErrorCode code() const noexcept { return code_; }

 private:
  ErrorCode code_;
};

[[noreturn]] void throw_invalid_argument(const std::string& message);
[[noreturn]] void throw_not_found(const std::string& message);
[[noreturn]] void throw_data_loss(const std::string& message);
[[noreturn]] void throw_internal(const std::string& message);

}  // namespace pleat
