#include <gtest/gtest.h>
#include <unistd.h>

#include <thread>

#include "tests/support/raw_stream.hpp"
#include "tests/unit/common/rpc/sample_service.hpp"

namespace pleat::rpc {
namespace {

using namespace std::chrono_literals;
using testing::SampleRefinement;
using testing::SampleSimulation;
using RefineStream = FrameStream<v1::RefineRequest, v1::RefineResponse>;

ServerOptions local_options(const std::string& name) {
  ServerOptions options;
  options.listen = "unix:/tmp/pleat-test-" + name + "-" + std::to_string(getpid()) + ".sock";
  options.drain_s = 0.2;
  return options;
}

class StreamBase : public ::testing::Test {
 protected:
  void serve(std::size_t concurrency = 1) {
    service = std::make_unique<SampleRefinement>(&metrics, concurrency);
    server = std::make_unique<Server>(
        local_options("stream"),
        std::vector<HostedService>{{service.get(), "pleat.v1.Refinement"}, {&simulation, "pleat.v1.Simulation"}});
    stub = v1::Refinement::NewStub(create_channel(server->address()));
  }
  std::unique_ptr<RefineStream> start(std::uint32_t window = 4, std::chrono::milliseconds timeout = 20s) {
    FrameStreamOptions options;
    options.peer = "refinement at here";
    options.window = window;
    options.frame_timeout = timeout;
    options.same_host = same_host;
    return std::make_unique<RefineStream>([&](auto* context, auto* call) { stub->async()->Refine(context, call); },
                                          options);
  }
  static v1::RefineRequest open_request(std::uint32_t window, const std::string& hash = "mesh") {
    v1::RefineRequest request;
    request.mutable_open()->set_window(window);
    request.mutable_open()->mutable_coarse()->set_hash(hash);
    return request;
  }
  static v1::RefineRequest frame_request(std::uint64_t index, int values = 30) {
    v1::RefineRequest request;
    request.mutable_frame()->mutable_coarse()->set_index(index);
    for (int i = 0; i < values; ++i) {
      request.mutable_frame()->mutable_fine()->add_positions(static_cast<float>(index) + static_cast<float>(i));
    }
    return request;
  }
  template <typename Action>
  static ErrorCode code_of(Action&& action, const std::string& part) {
    try {
      action();
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
      return error.code();
    }
    ADD_FAILURE() << "no error";
    return ErrorCode::kInternal;
  }
  void expect_no_sessions() {
    for (int i = 0; i < 500 && service->sessions_ > 0; ++i) std::this_thread::sleep_for(10ms);
    EXPECT_EQ(service->sessions_, 0);
  }

  bool same_host = false;  ///< frames in shared memory, or in the call
  telemetry::Metrics metrics{"refinement"};
  std::unique_ptr<SampleRefinement> service;
  SampleSimulation simulation;
  std::unique_ptr<Server> server;
  std::unique_ptr<v1::Refinement::Stub> stub;
};

/// Everything that a stream promises holds with the frames in shared memory and in the call.
class Stream : public StreamBase, public ::testing::WithParamInterface<bool> {
 protected:
  Stream() { same_host = GetParam(); }
};

INSTANTIATE_TEST_SUITE_P(Frames, Stream, ::testing::Bool(),
                         [](const auto& test) { return test.param ? "InSharedMemory" : "InTheCall"; });

class StreamOrder : public StreamBase,
                    public ::testing::WithParamInterface<std::tuple<std::pair<std::uint32_t, std::size_t>, bool>> {};

TEST_P(StreamOrder, AnswersComeInOrderEachOnce) {
  const auto [sizes, shared] = GetParam();
  const auto [window, concurrency] = sizes;
  same_host = shared;
  serve(concurrency);
  auto stream = start(window);
  EXPECT_EQ(stream->open(open_request(window)).fine_hash(), "fine of mesh");
  EXPECT_EQ(stream->shares_memory(), shared);
  constexpr std::uint64_t kFrames = 200;
  std::thread producer([&] {
    for (std::uint64_t k = 0; k < kFrames; ++k) stream->push(frame_request(k, static_cast<int>(k % 50)));
    stream->close();
  });
  v1::RefineResponse response;
  std::uint64_t next = 0;
  while (stream->pop(&response)) {
    ASSERT_TRUE(response.has_frame());
    EXPECT_EQ(response.frame().fine().index(), next);
    EXPECT_EQ(response.frame().fine().positions_size(), static_cast<int>(next % 50)) << "messages are reused";
    ASSERT_EQ(response.frame().stage_times_size(), 1);
    EXPECT_EQ(response.frame().stage_times(0).stage(), "refinement");
    ++next;
  }
  producer.join();
  EXPECT_EQ(next, kFrames);
  EXPECT_NE(metrics.text().find("pleat_frames_total{result=\"ok\",service=\"refinement\",stage=\"refinement\"} 200"),
            std::string::npos)
      << metrics.text();
  expect_no_sessions();
}

INSTANTIATE_TEST_SUITE_P(
    Windows, StreamOrder,
    ::testing::Combine(::testing::Values(std::pair{1u, std::size_t{1}}, std::pair{4u, std::size_t{1}},
                                         std::pair{16u, std::size_t{4}}, std::pair{64u, std::size_t{8}}),
                       ::testing::Bool()));

TEST_P(Stream, TryPushRefusesWhenTheWindowIsFull) {
  serve();
  auto stream = start(3);
  stream->open(open_request(3));
  EXPECT_TRUE(stream->try_push(frame_request(0)));
  EXPECT_TRUE(stream->try_push(frame_request(1)));
  EXPECT_TRUE(stream->try_push(frame_request(2)));
  EXPECT_FALSE(stream->try_push(frame_request(3)));
  EXPECT_EQ(stream->in_flight(), 3u);
  v1::RefineResponse response;
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_TRUE(stream->try_push(frame_request(3)));
}

TEST_P(Stream, AFrameThatFailsKeepsTheStream) {
  serve();
  auto stream = start();
  stream->open(open_request(4));
  v1::RefineResponse response;
  stream->push(frame_request(SampleRefinement::kBadFrame));
  stream->push(frame_request(SampleRefinement::kThrowingFrame));
  stream->push(frame_request(7));
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_EQ(response.error().index(), SampleRefinement::kBadFrame);
  EXPECT_EQ(response.error().code(), static_cast<int>(grpc::StatusCode::INVALID_ARGUMENT));
  EXPECT_EQ(response.error().message(), "frame 1000000: bad");
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_EQ(response.error().code(), static_cast<int>(grpc::StatusCode::INTERNAL));
  EXPECT_EQ(response.error().message(), "an unexpected failure");
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_EQ(response.frame().fine().index(), 7u);
  stream->close();
  EXPECT_FALSE(stream->pop(&response));
}

TEST_P(Stream, OpenErrorsEndTheStreamWithTheirCause) {
  serve();
  EXPECT_EQ(code_of([&] { start()->open(open_request(4, "bad")); }, "open.coarse: bad"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { start()->open(open_request(65)); }, "window"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { start()->open(frame_request(0)); }, "`open`"), ErrorCode::kInvalidArgument);
  expect_no_sessions();
}

TEST_P(Stream, ASecondOpenIsRefusedAfterTheFramesBefore) {
  serve();
  auto stream = start();
  stream->open(open_request(4));
  stream->push(frame_request(0));
  stream->send(open_request(4));
  v1::RefineResponse response;
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_EQ(response.frame().fine().index(), 0u);
  EXPECT_EQ(code_of([&] { stream->pop(&response); }, "only frames"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { stream->push(frame_request(1)); }, "only frames"), ErrorCode::kInvalidArgument);
}

TEST_P(Stream, TooLargeMessagesAreRefused) {
  serve();
  auto stream = start();
  stream->open(open_request(4));
  v1::RefineResponse response;
  EXPECT_EQ(code_of(
                [&] {
                  stream->push(frame_request(0, 17 << 20));
                  stream->pop(&response);
                },
                "larger than max"),
            ErrorCode::kResourceExhausted);
  auto other = start();
  other->open(open_request(4));
  other->push(frame_request(0));
  EXPECT_TRUE(other->pop(&response)) << "the service goes on serving";
}

TEST_P(Stream, TheWatchdogEndsAStuckStream) {
  serve();
  auto stream = start(4, 150ms);
  stream->open(open_request(4));
  stream->push(frame_request(SampleRefinement::kStuckFrame));
  v1::RefineResponse response;
  EXPECT_EQ(code_of([&] { stream->pop(&response); }, "refinement at here: no answer within 150 ms"),
            ErrorCode::kDeadlineExceeded);
  expect_no_sessions();
}

TEST_P(Stream, AClientThatSaysNothingIsCutOff) {
  serve();
  service->idle_timeout_ = 100ms;
  const auto expect_cut_off = [&](RefineStream& stream) {
    v1::RefineResponse response;
    EXPECT_THROW(stream.pop(&response), Error);
    expect_no_sessions();
  };
  expect_cut_off(*start());  // not even `open`
  auto stream = start();
  stream->open(open_request(4));
  stream->push(frame_request(0));
  v1::RefineResponse response;
  ASSERT_TRUE(stream->pop(&response));
  expect_cut_off(*stream);
}

TEST_P(Stream, AFrameThatTakesLongIsNoSilence) {
  serve();
  service->idle_timeout_ = 50ms;
  auto stream = start(4, 500ms);
  stream->open(open_request(4));
  stream->push(frame_request(SampleRefinement::kStuckFrame));
  v1::RefineResponse response;
  EXPECT_EQ(code_of([&] { stream->pop(&response); }, "no answer within 500 ms"), ErrorCode::kDeadlineExceeded);
}

TEST_P(Stream, AClientThatDoesNotReadIsCutOff) {
  serve();
  service->reader_timeout_ = 200ms;
  auto stream = start(16);
  stream->open(open_request(16));
  // More than the sockets hold; nobody pops. On a busy machine it is cut off before we are through.
  try {
    for (std::uint64_t k = 0; k < 16; ++k) stream->push(frame_request(k, 1 << 20));
  } catch (const Error&) {
  }
  expect_no_sessions();
}

TEST_P(Stream, BytesThatAreNoMessageEndTheStreamWithTheirCause) {
  serve();
  const auto channel = create_channel(server->address());
  v1::RefineOpen refine_open;
  v1::SimulateOpen simulate_open;
  refine_open.set_window(4);
  simulate_open.set_window(4);
  const auto garbage = test::with_first_field("\x0f"), open = test::with_first_field(refine_open.SerializeAsString());
  const auto late = test::with_unknown_and_first_field("\x0f");
  for (const auto& messages : {std::vector{garbage}, std::vector{open, garbage}, std::vector{open, late}}) {
    const grpc::Status refine = test::send_raw<v1::RefineResponse>(channel, "/pleat.v1.Refinement/Refine", messages);
    EXPECT_EQ(refine.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << refine.error_message();
    EXPECT_EQ(refine.error_message(), "bytes that are no message of this stream");
  }
  const grpc::Status simulate = test::send_raw<v1::SimulateResponse>(
      channel, "/pleat.v1.Simulation/Simulate", {test::with_first_field(simulate_open.SerializeAsString()), garbage});
  EXPECT_EQ(simulate.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << simulate.error_message();
  expect_no_sessions();
}

TEST_P(Stream, CancelFreesBothSides) {
  serve();
  auto stream = start();
  stream->open(open_request(4));
  stream->push(frame_request(SampleRefinement::kStuckFrame));
  std::thread canceller([&] {
    std::this_thread::sleep_for(50ms);
    stream->cancel();
  });
  v1::RefineResponse response;
  EXPECT_EQ(code_of([&] { stream->pop(&response); }, "cancelled"), ErrorCode::kCancelled);
  canceller.join();
  expect_no_sessions();
}

TEST_P(Stream, AClientThatDisappearsFreesTheSession) {
  serve();
  {
    auto stream = start();
    stream->open(open_request(4));
    stream->push(frame_request(0));
    stream->push(frame_request(SampleRefinement::kStuckFrame));
  }
  expect_no_sessions();
}

TEST_P(Stream, AServerThatStopsIsUnavailable) {
  serve();
  auto stream = start();
  stream->open(open_request(4));
  server->stop();
  v1::RefineResponse response;
  EXPECT_EQ(code_of([&] { stream->pop(&response); }, "refinement at here"), ErrorCode::kUnavailable);
  EXPECT_EQ(code_of([&] { stream->push(frame_request(0)); }, "refinement at here"), ErrorCode::kUnavailable);
  EXPECT_EQ(code_of([&] { start()->open(open_request(4)); }, "refinement at here"), ErrorCode::kUnavailable);
}

TEST_P(Stream, ADrainingServiceAnswersWhatItHasAndEndsByItself) {
  serve();
  auto stream = start();
  stream->open(open_request(4));
  v1::RefineResponse response;
  stream->push(frame_request(SampleRefinement::kSlowFrame));
  ASSERT_TRUE(stream->pop(&response)) << "the frame that it had read";
  EXPECT_EQ(response.frame().fine().index(), SampleRefinement::kSlowFrame);
  EXPECT_EQ(code_of([&] { stream->pop(&response); }, "refinement at here"), ErrorCode::kUnavailable);
  expect_no_sessions();
  EXPECT_EQ(code_of([&] { start()->open(open_request(4)); }, "stopping"), ErrorCode::kUnavailable);
}

TEST_P(Stream, AnIdleStreamEndsWhenItsServiceDrains) {
  serve(2);
  auto stream = start();
  stream->open(open_request(4));
  v1::RefineResponse response;
  for (std::uint64_t k = 0; k < 6; ++k) {
    stream->push(frame_request(k));
    ASSERT_TRUE(stream->pop(&response));
  }
  service->drain_.begin();
  EXPECT_EQ(code_of([&] { stream->pop(&response); }, "refinement at here"), ErrorCode::kUnavailable);
  expect_no_sessions();
}

using SimulateStream = FrameStream<v1::SimulateRequest, v1::SimulateResponse>;

/// A stream whose server sends of its own accord.
SimulateStream driven_by(v1::Simulation::Stub& stub) {
  FrameStreamOptions options;
  options.peer = "simulation at here";
  options.server_driven = true;
  return SimulateStream([&](auto* context, auto* call) { stub.async()->Simulate(context, call); }, options);
}

TEST_P(Stream, AServerThatDrivesAndWaitsForItsClientEndsWhenItDrains) {
  serve();
  const auto simulation_stub = v1::Simulation::NewStub(create_channel(server->address()));
  SimulateStream stream = driven_by(*simulation_stub);
  v1::SimulateRequest request;
  request.mutable_open()->set_window(2);
  request.mutable_open()->mutable_scene()->set_frames(20);
  stream.open(request);
  v1::SimulateResponse response;
  ASSERT_TRUE(stream.pop(&response));
  ASSERT_TRUE(stream.pop(&response));
  simulation.drain_.begin();
  EXPECT_EQ(code_of([&] { stream.pop(&response); }, "simulation at here"), ErrorCode::kUnavailable);
}

TEST_P(Stream, WorkInTheBackgroundHasALowerPriority) {
  for (const std::size_t concurrency : {1, 2}) {
    serve(concurrency);
    const auto niceness_of = [&](bool background) {
      FrameStreamOptions options;
      options.same_host = same_host;
      RefineStream stream(
          [&](auto* context, auto* call) {
            if (background) add_background(*context);
            stub->async()->Refine(context, call);
          },
          options);
      stream.open(open_request(4));
      stream.push(frame_request(0));
      v1::RefineResponse response;
      stream.pop(&response);
      stream.close();
      EXPECT_FALSE(stream.pop(&response));
      return service->niceness_.load();
    };
    const int normal = niceness_of(false);
    EXPECT_EQ(niceness_of(true), std::max(19, normal));
    EXPECT_EQ(niceness_of(false), normal) << "threads are not used again for work of another kind";
    server.reset();
  }
}

TEST_P(Stream, ACallCarriesItsTrace) {
  serve();
  const auto open_with = [&](const std::function<void(grpc::ClientContext&)>& add) {
    FrameStreamOptions options;
    options.peer = "refinement at here";
    options.same_host = same_host;
    RefineStream stream(
        [&](auto* context, auto* call) {
          add(*context);
          stub->async()->Refine(context, call);
        },
        options);
    stream.open(open_request(4));
    return service->trace_id_;
  };
  const std::string id = "4bf92f3577b34da6a3ce929d0e0e4736", given = "00-" + id + "-00f067aa0ba902b7-01";
  EXPECT_EQ(open_with([&](auto& context) { add_trace(context, *telemetry::parse_traceparent(given)); }), id);
  EXPECT_EQ(open_with([&](auto& context) { context.AddMetadata(kTraceparentKey, given); }), id);
  // What says nothing valid, or nothing, or two things gets a trace of its own.
  const std::string made = open_with([](auto&) {});
  EXPECT_EQ(made.size(), id.size());
  EXPECT_NE(open_with([](auto&) {}), made);
  EXPECT_NE(open_with([&](auto& context) { context.AddMetadata(kTraceparentKey, given + "x"); }), id);
  EXPECT_NE(open_with([&](auto& context) {
              for (int i = 0; i < 2; ++i) context.AddMetadata(kTraceparentKey, given);
            }),
            id);
}

TEST_P(Stream, TheClientPacesAServerThatDrives) {
  serve();
  const auto simulation_stub = v1::Simulation::NewStub(create_channel(server->address()));
  SimulateStream stream = driven_by(*simulation_stub);
  v1::SimulateRequest request;
  request.mutable_open()->set_window(3);
  request.mutable_open()->mutable_scene()->set_frames(20);
  request.mutable_open()->set_checkpoint("12345");
  EXPECT_EQ(stream.open(request).next_index(), 5u);
  v1::SimulateResponse response;
  for (std::uint64_t k = 5; k < 8; ++k) {
    ASSERT_TRUE(stream.pop(&response));
    EXPECT_EQ(response.frame().coarse().index(), k);
  }
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(simulation.sent_, 8u) << "nothing is acknowledged, so nothing more may be sent";
  for (std::uint64_t k = 8; k < 20; ++k) {
    request.set_ack_index(k - 3);
    stream.send(request);
    ASSERT_TRUE(stream.pop(&response));
    EXPECT_EQ(response.frame().coarse().index(), k);
  }
  stream.close();
  EXPECT_FALSE(stream.pop(&response));
}

}  // namespace
}  // namespace pleat::rpc
