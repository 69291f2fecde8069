// The end of a stream, or bytes that are no message: gRPC's Read says the same of both.
#pragma once

#include <google/protobuf/message.h>
#include <google/protobuf/unknown_field_set.h>
#include <grpcpp/support/status.h>

namespace pleat::rpc {

/// Set before reading into `message`. Parsing clears a message before anything else, so that after a read that failed
/// the mark is there if the stream has ended, and gone if bytes came that are no message.
inline void set_end_mark(google::protobuf::Message* message) {
  constexpr int kField = 536'870'911;  // the largest number that a field may have
  message->GetReflection()->MutableUnknownFields(message)->AddVarint(kField, 1);
}

/// After a read that failed.
inline bool has_end_mark(const google::protobuf::Message& message) {
  return !message.GetReflection()->GetUnknownFields(message).empty();
}

inline grpc::Status undecodable() {
  return {grpc::StatusCode::INVALID_ARGUMENT, "bytes that are no message of this stream"};
}

}  // namespace pleat::rpc
