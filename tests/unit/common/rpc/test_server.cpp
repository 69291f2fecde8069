#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <thread>

#include "tests/support/certificates.hpp"
#include "tests/unit/common/rpc/sample_service.hpp"

namespace pleat::rpc {
namespace {

using namespace std::chrono_literals;
using testing::SampleRefinement;

template <typename Action>
ErrorCode code_of(Action&& action, const std::string& part) {
  try {
    action();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    return error.code();
  }
  ADD_FAILURE() << "no error";
  return ErrorCode::kInternal;
}

std::string socket_file(const std::string& name) {
  return "/tmp/pleat-test-" + name + "-" + std::to_string(getpid()) + ".sock";
}

TEST(ServerHealth, AnswersForTheNamedServiceOnly) {
  SampleRefinement service;
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  Server server(options, {{&service, "pleat.v1.Refinement"}});
  const auto channel = create_channel(server.address());
  wait_healthy(channel, "pleat.v1.Refinement", server.address(), 5s);
  EXPECT_TRUE(is_healthy(channel, "pleat.v1.Refinement", 5s));
  EXPECT_FALSE(is_healthy(channel, "pleat.v1.Conversion", 5s));
  EXPECT_EQ(code_of([&] { wait_healthy(channel, "pleat.v1.Conversion", server.address(), 100ms); },
                    "pleat.v1.Conversion at " + server.address()),
            ErrorCode::kUnavailable);
  server.stop();
  EXPECT_FALSE(is_healthy(channel, "pleat.v1.Refinement", 200ms));
}

TEST(ServerHealth, NamesTheServiceThatIsNotThere) {
  const std::string address = "unix:" + socket_file("nobody");
  EXPECT_EQ(code_of([&] { wait_healthy(create_channel(address), "pleat.v1.Refinement", address, 200ms); },
                    "pleat.v1.Refinement at " + address),
            ErrorCode::kUnavailable);
}

TEST(ServerAddress, APortThatIsTakenIsNamed) {
  SampleRefinement service;
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  const Server first(options, {{&service, "pleat.v1.Refinement"}});
  options.listen = first.address();
  SampleRefinement other;
  EXPECT_EQ(code_of(
                [&] {
                  Server second(options, {{&other, "pleat.v1.Refinement"}});
                },
                first.address()),
            ErrorCode::kUnavailable);
}

TEST(ServerAddress, ASocketOfAnotherKindIsSomebodys) {
  const std::string path = socket_file("datagram");
  const int other = socket(AF_UNIX, SOCK_DGRAM, 0);
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  std::strncpy(name.sun_path, path.c_str(), sizeof(name.sun_path) - 1);
  ASSERT_EQ(bind(other, reinterpret_cast<sockaddr*>(&name), sizeof(name)), 0);
  SampleRefinement service;
  ServerOptions options;
  options.listen = "unix:" + path;
  EXPECT_EQ(code_of([&] { Server(options, {{&service, "pleat.v1.Refinement"}}); }, path), ErrorCode::kUnavailable);
  EXPECT_TRUE(std::filesystem::exists(path));
  close(other);
  std::filesystem::remove(path);
}

TEST(ServerAddress, OnlyAStaleSocketIsRemoved) {
  const std::string path = socket_file("stale");
  // What a killed server leaves behind: a socket file that nobody listens on.
  const int old = socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  std::strncpy(name.sun_path, path.c_str(), sizeof(name.sun_path) - 1);
  ASSERT_EQ(bind(old, reinterpret_cast<sockaddr*>(&name), sizeof(name)), 0);
  close(old);
  ASSERT_TRUE(std::filesystem::exists(path));

  SampleRefinement service;
  ServerOptions options;
  options.listen = "unix:" + path;
  {
    const Server server(options, {{&service, "pleat.v1.Refinement"}});
    EXPECT_TRUE(is_healthy(create_channel(server.address()), "pleat.v1.Refinement", 5s));
    SampleRefinement other;
    EXPECT_EQ(code_of(
                  [&] {
                    Server second(options, {{&other, "pleat.v1.Refinement"}});
                  },
                  path),
              ErrorCode::kUnavailable);
    EXPECT_TRUE(is_healthy(create_channel(server.address()), "pleat.v1.Refinement", 5s)) << "the first one lives on";
  }
  EXPECT_FALSE(std::filesystem::exists(path));
  std::ofstream(path) << "a file of somebody";
  EXPECT_EQ(code_of(
                [&] {
                  Server third(options, {{&service, "pleat.v1.Refinement"}});
                },
                path),
            ErrorCode::kInvalidArgument);
  std::filesystem::remove(path);
}

TEST(ServerAddress, OtherHostsNeedTls) {
  SampleRefinement service;
  ServerOptions options;
  options.listen = "0.0.0.0:0";
  EXPECT_EQ(code_of(
                [&] {
                  Server server(options, {{&service, "pleat.v1.Refinement"}});
                },
                "--tls-ca"),
            ErrorCode::kInvalidArgument);
  options.tls.ca_file = "/nowhere/ca.pem";
  EXPECT_EQ(code_of(
                [&] {
                  Server server(options, {{&service, "pleat.v1.Refinement"}});
                },
                "all three"),
            ErrorCode::kInvalidArgument);
  options.tls.certificate_file = options.tls.key_file = "/nowhere/x.pem";
  EXPECT_EQ(code_of(
                [&] {
                  Server server(options, {{&service, "pleat.v1.Refinement"}});
                },
                "/nowhere/"),
            ErrorCode::kNotFound);
}

TEST(ServerTls, OnlyClientsOfTheSameAuthorityGetIn) {
  const test::Certificates ours, theirs;
  if (!ours.made() || !theirs.made()) GTEST_SKIP() << "no openssl command";
  SampleRefinement service;
  ServerOptions options;
  options.listen = "0.0.0.0:0";
  options.tls = ours.server();
  const Server server(options, {{&service, "pleat.v1.Refinement"}});
  const std::string address = "127.0.0.1" + server.address().substr(server.address().rfind(':'));
  wait_healthy(create_channel(address, ours.client()), "pleat.v1.Refinement", address, 10s);
  EXPECT_FALSE(is_healthy(create_channel(address), "pleat.v1.Refinement", 500ms)) << "without TLS";
  EXPECT_FALSE(is_healthy(create_channel(address, theirs.client()), "pleat.v1.Refinement", 500ms))
      << "another authority";
  TlsOptions stranger = theirs.client();
  stranger.ca_file = ours.client().ca_file;  // trusts us, but we do not know it
  EXPECT_FALSE(is_healthy(create_channel(address, stranger), "pleat.v1.Refinement", 500ms));
  TlsOptions other_name = ours.client();
  other_name.server_name = "elsewhere.test";
  EXPECT_FALSE(is_healthy(create_channel(address, other_name), "pleat.v1.Refinement", 500ms));
  other_name.server_name = "localhost";
  EXPECT_TRUE(is_healthy(create_channel(address, other_name), "pleat.v1.Refinement", 5s));
}

TEST(ServerHealth, TellsWhetherThereIsRoom) {
  SampleRefinement service;
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  bool room = true;
  Server server(options, {{&service, "pleat.v1.Refinement", {}, [&] { return room; }}});
  const auto channel = create_channel(server.address());
  wait_healthy(channel, "pleat.v1.Refinement.room", server.address(), 5s);
  room = false;
  server.show_room();
  EXPECT_FALSE(is_healthy(channel, "pleat.v1.Refinement.room", 5s));
  EXPECT_TRUE(is_healthy(channel, "pleat.v1.Refinement", 5s)) << "who is full still serves";
}

/// The sample service as a process of its own.
class Process {
 public:
  explicit Process(const std::vector<std::string>& arguments) {
    int out[2], error[2];
    EXPECT_EQ(pipe2(out, O_CLOEXEC), 0);
    EXPECT_EQ(pipe2(error, O_CLOEXEC), 0);
    pid_ = fork();
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);  // also when the test ends badly
      dup2(out[1], 1);
      dup2(error[1], 2);
      std::vector<char*> argv = {const_cast<char*>(PLEAT_RPC_SAMPLE)};
      for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
      argv.push_back(nullptr);
      execv(argv[0], argv.data());
      _exit(127);
    }
    close(out[1]);
    close(error[1]);
    out_ = out[0];
    error_ = error[0];
  }
  ~Process() {
    if (!ended_) kill(pid_, SIGKILL);
    wait();
    close(out_);
    close(error_);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  std::string line() { return read_until(out_, '\n'); }
  std::string errors() { return read_until(error_, '\0'); }
  void signal(int number) { kill(pid_, number); }
  int wait() {
    if (ended_) return code_;
    int status = 0;
    waitpid(pid_, &status, 0);
    ended_ = true;
    code_ = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
    return code_;
  }

 private:
  static std::string read_until(int descriptor, char end) {
    std::string text;
    char c = 0;
    while (read(descriptor, &c, 1) == 1 && c != end) text += c;
    return text;
  }
  pid_t pid_ = -1;
  int out_ = -1, error_ = -1, code_ = 0;
  bool ended_ = false;
};

TEST(ServiceProcess, ReportsReadyAndStopsOnASignal) {
  const std::string address = "unix:" + socket_file("process");
  for (const int signal : {SIGTERM, SIGINT}) {
    Process process({"--listen", address});
    EXPECT_EQ(process.line(), "ready " + address);
    EXPECT_TRUE(is_healthy(create_channel(address), "pleat.v1.Refinement", 5s));
    process.signal(signal);
    EXPECT_EQ(process.wait(), 0);
    EXPECT_FALSE(std::filesystem::exists(address.substr(5)));
  }
}

TEST(ServiceProcess, DrainsAnOpenStreamAndObeysASecondSignal) {
  const std::string address = "unix:" + socket_file("drain");
  const auto with_open_stream = [&](const std::string& drain_s, int signals) {
    Process process({"--listen", address, "--drain-s", drain_s});
    process.line();
    const auto stub = v1::Refinement::NewStub(create_channel(address));
    FrameStreamOptions options;
    options.peer = "sample";
    FrameStream<v1::RefineRequest, v1::RefineResponse> stream(
        [&](auto* context, auto* call) { stub->async()->Refine(context, call); }, options);
    v1::RefineRequest request;
    request.mutable_open();
    stream.open(request);
    for (int i = 0; i < signals; ++i) {
      process.signal(SIGTERM);
      std::this_thread::sleep_for(200ms);
    }
    return process.wait();
  };
  EXPECT_EQ(with_open_stream("0.3", 1), 0);
  EXPECT_EQ(with_open_stream("60", 2), 128 + SIGTERM);
  std::filesystem::remove(address.substr(5));
}

/// A process that is stopped keeps its connections and reads nothing: writes fill the socket and stay.
class StoppedProcess : public ::testing::Test {
 protected:
  StoppedProcess() : address_("unix:" + socket_file("stopped")), process_({"--listen", address_}) {
    process_.line();
    stub_ = v1::Refinement::NewStub(create_channel(address_));
    FrameStreamOptions options;
    options.peer = "sample";
    options.frame_timeout = 300ms;
    options.window = 64;
    stream_ = std::make_unique<RefineStream>([&](auto* context, auto* call) { stub_->async()->Refine(context, call); },
                                             options);
    v1::RefineRequest request;
    request.mutable_open()->set_window(64);
    stream_->open(request);
    process_.signal(SIGSTOP);
  }
  ~StoppedProcess() override { std::filesystem::remove(address_.substr(5)); }

  /// Until the stream fails.
  void push_without_end() {
    v1::RefineRequest frame;
    frame.mutable_frame()->mutable_fine()->mutable_positions()->Resize(1 << 20, 1.0f);
    while (true) stream_->push(frame);
  }

  using RefineStream = FrameStream<v1::RefineRequest, v1::RefineResponse>;
  const std::string address_;
  Process process_;
  std::unique_ptr<v1::Refinement::Stub> stub_;
  std::unique_ptr<RefineStream> stream_;
};

TEST_F(StoppedProcess, AWriteFailsInTime) {
  EXPECT_EQ(code_of([&] { push_without_end(); }, "sample: no answer within 300 ms"), ErrorCode::kDeadlineExceeded);
  v1::RefineResponse response;
  EXPECT_EQ(code_of([&] { stream_->pop(&response); }, "no answer"), ErrorCode::kDeadlineExceeded);
}

TEST_F(StoppedProcess, CancelEndsAWrite) {
  std::thread canceller([&] {
    std::this_thread::sleep_for(50ms);
    stream_->cancel();
  });
  EXPECT_EQ(code_of([&] { push_without_end(); }, "sample: cancelled"), ErrorCode::kCancelled);
  canceller.join();
}

TEST_F(StoppedProcess, IsUsableAgainWhenItGoesOn) {
  EXPECT_EQ(code_of([&] { push_without_end(); }, "no answer"), ErrorCode::kDeadlineExceeded);
  process_.signal(SIGCONT);
  FrameStreamOptions options;
  options.peer = "sample";
  RefineStream again([&](auto* context, auto* call) { stub_->async()->Refine(context, call); }, options);
  v1::RefineRequest request;
  request.mutable_open();
  again.open(request);
  request.mutable_frame()->mutable_coarse()->set_index(3);
  again.push(request);
  v1::RefineResponse response;
  ASSERT_TRUE(again.pop(&response));
  EXPECT_EQ(response.frame().fine().index(), 3u);
}

TEST(ServiceProcess, ExitCodesAndMessages) {
  const auto fails = [](const std::vector<std::string>& arguments, int code, const std::string& part) {
    Process process(arguments);
    const std::string errors = process.errors();
    EXPECT_EQ(process.wait(), code);
    EXPECT_NE(errors.find(part), std::string::npos) << errors;
  };
  fails({"--listen", "0.0.0.0:5000"}, 2, "0.0.0.0:5000");
  fails({"--nonsense"}, 2, "--nonsense");
  fails({}, 2, "listen");
  SampleRefinement service;
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  const Server server(options, {{&service, "pleat.v1.Refinement"}});
  fails({"--listen", server.address()}, 1, server.address());
}

TEST(ServiceProcess, DiesWithItsParent) {
  const std::string address = "unix:" + socket_file("orphan");
  // The process between is killed; the service must go with it.
  const pid_t between = fork();
  if (between == 0) {
    const pid_t child = fork();
    if (child == 0) {
      execl(PLEAT_RPC_SAMPLE, PLEAT_RPC_SAMPLE, "--listen", address.c_str(), "--die-with-parent", nullptr);
      _exit(127);
    }
    pause();
    _exit(0);
  }
  const auto channel = create_channel(address);
  wait_healthy(channel, "pleat.v1.Refinement", address, 10s);
  kill(between, SIGKILL);
  waitpid(between, nullptr, 0);
  bool gone = false;
  for (int i = 0; i < 500 && !gone; ++i) {
    gone = !std::filesystem::exists(address.substr(5));
    std::this_thread::sleep_for(10ms);
  }
  EXPECT_TRUE(gone);
}

}  // namespace
}  // namespace pleat::rpc
