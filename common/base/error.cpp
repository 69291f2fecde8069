#include "common/base/error.hpp"

#include <algorithm>

namespace pleat {
namespace {

std::string in_one_line(std::string text) {
  const auto is_control = [](unsigned char c) { return c < 0x20 || c == 0x7f; };
  std::replace_if(text.begin(), text.end(), is_control, ' ');
  return text;
}

}  // namespace

Error::Error(ErrorCode code, const std::string& message) : std::runtime_error(in_one_line(message)), code_(code) {}

std::string_view to_string(ErrorCode code) {
  switch (code) {
    case ErrorCode::kInvalidArgument:
      return "INVALID_ARGUMENT";
    case ErrorCode::kNotFound:
      return "NOT_FOUND";
    case ErrorCode::kAlreadyExists:
      return "ALREADY_EXISTS";
    case ErrorCode::kFailedPrecondition:
      return "FAILED_PRECONDITION";
    case ErrorCode::kResourceExhausted:
      return "RESOURCE_EXHAUSTED";
    case ErrorCode::kDataLoss:
      return "DATA_LOSS";
    case ErrorCode::kUnavailable:
      return "UNAVAILABLE";
    case ErrorCode::kDeadlineExceeded:
      return "DEADLINE_EXCEEDED";
    case ErrorCode::kCancelled:
      return "CANCELLED";
    case ErrorCode::kInternal:
      return "INTERNAL";
  }
  return "INTERNAL";
}

void throw_invalid_argument(const std::string& message) { throw Error(ErrorCode::kInvalidArgument, message); }
void throw_not_found(const std::string& message) { throw Error(ErrorCode::kNotFound, message); }
void throw_data_loss(const std::string& message) { throw Error(ErrorCode::kDataLoss, message); }
void throw_internal(const std::string& message) { throw Error(ErrorCode::kInternal, message); }

}  // namespace pleat
