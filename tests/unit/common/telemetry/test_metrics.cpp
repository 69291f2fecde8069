#include "common/telemetry/metrics.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/base/error.hpp"

namespace pleat::telemetry {
namespace {

TEST(Metrics, NamesAndLabels) {
  Metrics metrics("refinement");
  metrics.frame_done("refinement", 0.003, true);
  metrics.frame_done("refinement", 0.005, true);
  metrics.frame_done("refinement", 0.001, false);
  metrics.add_sessions(2);
  metrics.add_sessions(-1);
  metrics.set_queue_depth("to_image", 3);
  metrics.count("penetrations", 4);
  metrics.count("penetrations");
  const std::string text = metrics.text();
  for (const char* line : {
           "pleat_frames_total{result=\"ok\",service=\"refinement\",stage=\"refinement\"} 2",
           "pleat_frames_total{result=\"error\",service=\"refinement\",stage=\"refinement\"} 1",
           "pleat_stage_latency_seconds_count{service=\"refinement\",stage=\"refinement\"} 3",
           "pleat_sessions{service=\"refinement\"} 1",
           "pleat_queue_depth{edge=\"to_image\",service=\"refinement\"} 3",
           "pleat_penetrations_total{service=\"refinement\"} 5",
       }) {
    EXPECT_NE(text.find(line), std::string::npos) << line << "\n" << text;
  }
}

/// A port of the system's choice, held open.
class HeldPort {
 public:
  HeldPort() : socket_(socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in name{};
    name.sin_family = AF_INET;
    name.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(name);
    EXPECT_EQ(bind(socket_, reinterpret_cast<sockaddr*>(&name), size), 0);
    EXPECT_EQ(listen(socket_, 1), 0);
    getsockname(socket_, reinterpret_cast<sockaddr*>(&name), &size);
    port = ntohs(name.sin_port);
  }
  ~HeldPort() { release(); }
  HeldPort(const HeldPort&) = delete;
  HeldPort& operator=(const HeldPort&) = delete;
  void release() {
    if (socket_ >= 0) close(socket_);
    socket_ = -1;
  }
  int port = 0;

 private:
  int socket_;
};

TEST(Metrics, AreServedOnLoopbackOnly) {
  Metrics metrics("sample");
  EXPECT_THROW(metrics.serve("0.0.0.0:9000"), Error);
  HeldPort held;
  const std::string address = "127.0.0.1:" + std::to_string(held.port);
  try {
    metrics.serve(address);
    ADD_FAILURE() << "a port that is taken was accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kUnavailable);
    EXPECT_NE(std::string(error.what()).find(address), std::string::npos);
  }
  held.release();
  metrics.count("things", 7);
  metrics.serve(address);
  const int client = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in name{};
  name.sin_family = AF_INET;
  name.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  name.sin_port = htons(static_cast<std::uint16_t>(held.port));
  ASSERT_EQ(connect(client, reinterpret_cast<sockaddr*>(&name), sizeof(name)), 0);
  const std::string request = "GET /metrics HTTP/1.0\r\n\r\n";
  ASSERT_EQ(write(client, request.data(), request.size()), static_cast<ssize_t>(request.size()));
  std::string answer;
  char buffer[4096];
  for (ssize_t size = 0; (size = read(client, buffer, sizeof(buffer))) > 0;) {
    answer.append(buffer, static_cast<std::size_t>(size));
  }
  close(client);
  EXPECT_NE(answer.find("pleat_things_total{service=\"sample\"} 7"), std::string::npos) << answer;
}

}  // namespace
}  // namespace pleat::telemetry
