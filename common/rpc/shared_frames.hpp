// Memory in which two processes of one host hand each other the messages of a stream (docs/transport.md). The call
// stays gRPC's: it opens the stream, ends it, and tells each side that the other one has gone; only the frames between
// do not pass through sockets, threads of gRPC's and the buffers of both.
//
// The client offers memory without a name (memfd) in the call's metadata, as "PID FD TOKEN". A server that can reach it
// takes it up and says so in its own; where it can't (another host, another container, another user) the frames travel
// in the call, as they do with a peer that knows nothing of this. What is in the memory are the same messages, written
// and parsed by protobuf. The memory goes when both processes have gone, however they end.
#pragma once

#include <google/protobuf/message_lite.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

namespace pleat::rpc {

/// One side. Of each direction one thread at a time sends, or receives; ring() and what only looks is for any thread.
class SharedFrames {
 public:
  /// In the metadata of both sides. Its value is a ticket from the client, and empty from the server.
  static constexpr const char* kKey = "pleat-shared-frames";

  /// Memory for a window of frames in flight, for the client to offer. Null where the system has none.
  static std::unique_ptr<SharedFrames> offer(std::uint32_t window);
  /// The other side of it. Null for anything but memory of this user and of the size that the window needs, which its
  /// owner can't take away (sealed), and which holds the ticket's token.
  static std::unique_ptr<SharedFrames> accept(std::string_view ticket, std::uint32_t window);

  ~SharedFrames();
  SharedFrames(const SharedFrames&) = delete;
  SharedFrames& operator=(const SharedFrames&) = delete;

  const std::string& ticket() const { return ticket_; }
  /// The server has accepted, or won't: nobody else can from now on.
  void withdraw();

  /// False: not sent, because it is larger than kMaxMessageBytes, or because more messages are on their way than the
  /// window allows.
  bool send(const google::protobuf::MessageLite& message);
  /// Sent, and not received yet.
  std::uint32_t on_their_way() const;
  /// Received by the other side, modulo 2^32.
  std::uint32_t taken() const;
  /// Nothing more will be sent.
  void close();

  bool available() const;
  /// Takes the next message, which is available(). False: it is none.
  bool receive(google::protobuf::MessageLite* message);
  /// The other side has closed; what it sent before may still be available().
  bool closed() const;

  /// The number of rings at this side's bell: by the other side when it has sent or closed, and by ring().
  std::uint32_t rings() const;
  /// Sleeps until there are other rings than `rings`, or until then: false.
  bool wait(std::uint32_t rings, std::chrono::steady_clock::time_point until) const;
  /// Wakes up who waits on this side.
  void ring();

 private:
  struct Lane;
  struct Layout;

  SharedFrames(int descriptor, void* memory, std::size_t bytes, std::uint32_t slots, bool client);
  std::byte* slot(std::uint32_t lane, std::uint32_t index) const;
  Lane& out() const;
  Lane& in() const;

  int descriptor_;
  Layout* const layout_;
  const std::size_t bytes_;
  const std::uint32_t slots_;
  const bool client_;
  std::string ticket_;
};

}  // namespace pleat::rpc
