// The end of a stream, or bytes that are no message: gRPC's Read says the same of both.
#pragma once

#include <google/protobuf/message.h>
#include <google/protobuf/unknown_field_set.h>
#include <grpcpp/support/status.h>

namespace pleat::rpc {

inline constexpr int kEndMark = 536'870'911;  ///< the largest number that a field may have

/// Set before reading into `message`. Parsing clears a message before anything else, so that after a read that failed
/// the mark is there if the stream has ended, and gone if bytes came that are no message.
inline void set_end_mark(google::protobuf::Message* message) {
  message->GetReflection()->MutableUnknownFields(message)->AddVarint(kEndMark, 1);
}

/// After a read that failed. Parsing leaves what it took for unknown fields before it met what is no message.
inline bool has_end_mark(const google::protobuf::Message& message) {
  const auto& fields = message.GetReflection()->GetUnknownFields(message);
  return fields.field_count() == 1 && fields.field(0).number() == kEndMark;
}

inline grpc::Status undecodable() {
  return {grpc::StatusCode::INVALID_ARGUMENT, "bytes that are no message of this stream"};
}

}  // namespace pleat::rpc
