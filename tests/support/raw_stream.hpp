// A client of a stream that sends whatever it likes.
#pragma once

#include <google/protobuf/empty.pb.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/support/sync_stream.h>

#include <memory>
#include <string>
#include <vector>

namespace pleat::test {

/// A message whose first field, which is another message in all our streams, holds these bytes.
inline google::protobuf::Empty with_first_field(const std::string& bytes) {
  google::protobuf::Empty message;
  message.GetReflection()->MutableUnknownFields(&message)->AddLengthDelimited(1, bytes);
  return message;
}

/// The same behind a field that no message of ours has.
inline google::protobuf::Empty with_unknown_and_first_field(const std::string& bytes) {
  google::protobuf::Empty message;
  message.GetReflection()->MutableUnknownFields(&message)->AddVarint(1000, 1);
  message.MergeFrom(with_first_field(bytes));
  return message;
}

/// Sends the messages to METHOD ("/pleat.v1.Refinement/Refine") and returns how the stream ends, though we never close
/// our side. Answers are read and dropped.
template <typename Response>
grpc::Status send_raw(const std::shared_ptr<grpc::Channel>& channel, const std::string& method,
                      const std::vector<google::protobuf::Empty>& messages) {
  const grpc::internal::RpcMethod rpc(method.c_str(), grpc::internal::RpcMethod::BIDI_STREAMING);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(20));
  const std::unique_ptr<grpc::ClientReaderWriter<google::protobuf::Empty, Response>> stream(
      grpc::internal::ClientReaderWriterFactory<google::protobuf::Empty, Response>::Create(channel.get(), rpc,
                                                                                           &context));
  for (const auto& message : messages) stream->Write(message);
  Response answer;
  while (stream->Read(&answer)) {
  }
  return stream->Finish();
}

}  // namespace pleat::test
