#include <atomic>
#include <limits>
#include <map>
#include <memory>
#include <thread>
#include <vector>

#include "common/frame/messages.hpp"
#include "common/rpc/stream.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/raw_stream.hpp"
#include "tests/unit/services/coordinator/coordinator_fixture.hpp"

namespace pleat::coordinator {
namespace {

using testing::Faults;
using namespace std::chrono_literals;

/// One Enhance call.
class Client {
 public:
  explicit Client(v1::Coordinator::Stub& stub) : stream_(stub.Enhance(&context_)) {}

  bool send(const v1::EnhanceRequest& request) { return stream_->Write(request); }
  /// The next message; an empty one at the end.
  v1::EnhanceResponse receive() {
    v1::EnhanceResponse response;
    if (!stream_->Read(&response)) response.Clear();
    return response;
  }
  void close() { stream_->WritesDone(); }
  void vanish() { context_.TryCancel(); }
  grpc::Status finish() {
    v1::EnhanceResponse rest;
    while (stream_->Read(&rest)) {
    }
    return stream_->Finish();
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::EnhanceRequest, v1::EnhanceResponse>> stream_;
};

class LiveSessionTest : public CoordinatorTest {
 protected:
  LiveSessionTest() : coarse_(testing::sheet()), subdivision_(subdivide(coarse_, 2)) {}

  v1::EnhanceRequest open_request() const {
    v1::EnhanceRequest request;
    *request.mutable_open()->mutable_coarse() = to_message(coarse_);
    request.mutable_open()->add_obstacles()->set_name("ball");
    request.mutable_open()->set_detail(v1::DETAIL_NETWORK);
    return request;
  }
  std::unique_ptr<Client> open(const v1::EnhanceRequest& request) {
    auto client = std::make_unique<Client>(*stub_);
    client->send(request);
    const v1::EnhanceResponse response = client->receive();
    EXPECT_TRUE(response.has_opened()) << client->finish().error_message();
    return client;
  }
  v1::EnhanceRequest frame_request(std::uint64_t index) const {
    v1::EnhanceRequest request;
    *request.mutable_frame()->mutable_coarse() = testing::fake_coarse_frame(coarse_, index);
    request.mutable_frame()->mutable_coarse()->clear_velocities();
    request.mutable_frame()->add_obstacles()->set_name("ball");
    return request;
  }
  void expect_frame(const v1::EnhanceResponse& response, std::uint64_t index, bool refined = true) const {
    ASSERT_TRUE(response.has_frame()) << response.error().message();
    EXPECT_EQ(response.frame().fine().index(), index);
    const Positions expected =
        testing::fake_enhanced(subdivision_, coarse_.faces, testing::fake_coarse_frame(coarse_, index), refined);
    ASSERT_EQ(response.frame().fine().positions_size(), expected.size());
    EXPECT_LT((positions_from_message(response.frame().fine()) - expected).cwiseAbs().maxCoeff(), 1e-6F);
  }
  bool all_stages_free() {
    for (const auto* fake : fakes_.all()) {
      if (fake->sessions != 0) return false;
    }
    return true;
  }
  void expect_refused(const v1::EnhanceRequest& request, grpc::StatusCode code, const std::string& cause) {
    Client client(*stub_);
    client.send(request);
    const grpc::Status status = client.finish();
    EXPECT_EQ(status.error_code(), code) << status.error_message();
    EXPECT_NE(status.error_message().find(cause), std::string::npos) << status.error_message();
  }

  Topology coarse_;
  Subdivision subdivision_;
};

TEST_F(LiveSessionTest, FramesComeBackRefinedAndVelocitiesAreFilled) {
  start();
  Client client(*stub_);
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->set_window(3);
  client.send(request);
  const v1::EnhanceResponse opened = client.receive();
  ASSERT_TRUE(opened.has_opened());
  EXPECT_EQ(opened.opened().window(), 3U);
  EXPECT_EQ(opened.opened().model(), "fake");
  EXPECT_EQ(topology_hash(from_message(opened.opened().fine())), topology_hash(subdivision_.fine));
  EXPECT_EQ(opened.opened().feature_vertices_size(), coarse_.vertex_count());
  for (std::uint64_t i = 0; i < 25; ++i) {
    ASSERT_TRUE(client.send(frame_request(i)));
    const v1::EnhanceResponse response = client.receive();
    expect_frame(response, i);
    EXPECT_EQ(response.frame().report().zones(), 1U) << "the obstacle reached refinement";
    EXPECT_EQ(response.frame().stage_times_size(), 4);
  }
  client.close();
  EXPECT_TRUE(client.finish().ok());
  EXPECT_TRUE(eventually([&] { return all_stages_free(); }));
}

TEST_F(LiveSessionTest, FramesMayBeSentAhead) {
  start();
  const auto client = open(open_request());
  std::thread sender([&] {
    for (std::uint64_t i = 0; i < 80; ++i) client->send(frame_request(i));
    client->close();
  });
  for (std::uint64_t i = 0; i < 80; ++i) expect_frame(client->receive(), i);
  sender.join();
  EXPECT_TRUE(client->finish().ok());
}

TEST_F(LiveSessionTest, AReplacedBundleEndsTheSessionThatMeetsIt) {
  start();
  const auto client = open(open_request());
  client->send(frame_request(0));
  expect_frame(client->receive(), 0);
  fakes_.bundle().replace([](v1::ModelDescription& model) { model.mutable_representation()->set_window(2); });
  fakes_.superres().faults.at(1, Faults::Kind::kBreak);
  client->send(frame_request(1));
  EXPECT_EQ(client->receive().message_case(), v1::EnhanceResponse::MESSAGE_NOT_SET);
  const grpc::Status status = client->finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_NE(status.error_message().find("another representation; begin anew"), std::string::npos)
      << status.error_message();
}

TEST_F(LiveSessionTest, ABadFrameIsAnErrorAndTheSessionLives) {
  start();
  const auto client = open(open_request());
  std::vector<v1::EnhanceRequest> bad(4, frame_request(1));
  bad[0].mutable_frame()->mutable_coarse()->mutable_positions()->Truncate(30);
  bad[1].mutable_frame()->mutable_coarse()->set_positions(7, std::numeric_limits<float>::quiet_NaN());
  bad[2].mutable_frame()->mutable_coarse()->add_velocities(1);
  bad[3].mutable_frame()->clear_coarse();
  const std::vector<std::string> causes{"positions: 30 values given, the session has 20 vertices", "not finite",
                                        "velocities: 1 values", "positions: 0 values"};
  client->send(frame_request(0));
  expect_frame(client->receive(), 0);
  for (std::size_t i = 0; i < bad.size(); ++i) {
    client->send(bad[i]);
    const v1::EnhanceResponse response = client->receive();
    ASSERT_TRUE(response.has_error());
    EXPECT_EQ(response.error().code(), static_cast<int>(grpc::StatusCode::INVALID_ARGUMENT));
    EXPECT_EQ(response.error().index(), i < 3 ? 1U : 0U);
    EXPECT_NE(response.error().message().find(causes[i]), std::string::npos) << response.error().message();
  }
  client->send(frame_request(1));
  expect_frame(client->receive(), 1);
  client->close();
  EXPECT_TRUE(client->finish().ok());
}

TEST_F(LiveSessionTest, AnErrorBetweenFramesInFlightKeepsItsPlace) {
  start();
  fakes_.superres().faults.delay(5ms);
  const auto client = open(open_request());
  v1::EnhanceRequest bad = frame_request(1);
  bad.mutable_frame()->mutable_coarse()->mutable_positions()->Clear();
  client->send(frame_request(0));
  client->send(bad);
  client->send(frame_request(2));
  EXPECT_TRUE(client->receive().has_frame());
  EXPECT_TRUE(client->receive().has_error());
  EXPECT_TRUE(client->receive().has_frame());
}

TEST_F(LiveSessionTest, TheClientsIndicesComeBack) {
  start();
  const auto client = open(open_request());
  for (const std::uint64_t index : {700, 701, 701, 5}) {
    v1::EnhanceRequest request = frame_request(3);
    request.mutable_frame()->mutable_coarse()->set_index(index);
    client->send(request);
    EXPECT_EQ(client->receive().frame().fine().index(), index);
  }
}

TEST_F(LiveSessionTest, RefinementCanBeLeftOut) {
  start();
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->set_skip_refinement(true);
  const auto client = open(request);
  client->send(frame_request(0));
  expect_frame(client->receive(), 0, false);
}

TEST_F(LiveSessionTest, TheFoldStepNeedsNoBundle) {
  fakes_.conversion().stop();
  fakes_.superres().stop();
  start();
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->set_detail(v1::DETAIL_FOLD);
  request.mutable_open()->set_subdivision_rounds(1);
  const auto client = open(request);
  const Subdivision halved = subdivide(coarse_, 1);
  for (std::uint64_t i = 0; i < 8; ++i) {
    client->send(frame_request(i));
    const v1::EnhanceResponse response = client->receive();
    ASSERT_TRUE(response.has_frame()) << response.error().message();
    EXPECT_EQ(response.frame().fold().restarted(), i == 0);
    EXPECT_EQ(positions_from_message(response.frame().fine()),
              testing::fake_folded(halved, coarse_.faces, testing::fake_coarse_frame(coarse_, i), i + 1));
  }
  client->close();
  EXPECT_TRUE(client->finish().ok());
}

TEST_F(LiveSessionTest, WithoutDetailFramesAreUpsampledSmoothly) {
  fakes_.conversion().stop();
  fakes_.superres().stop();
  start();
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->set_detail(v1::DETAIL_NONE);
  const auto client = open(request);
  const SmoothUpsampling upsampling(coarse_, subdivide(coarse_, 2));
  for (std::uint64_t i = 0; i < 3; ++i) {
    client->send(frame_request(i));
    const v1::EnhanceResponse response = client->receive();
    ASSERT_TRUE(response.has_frame()) << response.error().message();
    Positions expected = upsampling(positions_from_message(testing::fake_coarse_frame(coarse_, i)));
    expected.array() += 0.001F;  // the fake refinement's
    EXPECT_EQ(positions_from_message(response.frame().fine()), expected);
  }
  client->close();
  EXPECT_TRUE(client->finish().ok());
}

TEST_F(LiveSessionTest, RefusesWhatIsForJobsAndSessionsWithoutAnyStage) {
  start();
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->set_detail(v1::DETAIL_TRACKED);
  expect_refused(request, grpc::StatusCode::INVALID_ARGUMENT, "open.detail: 'tracked' is for jobs");
  request.mutable_open()->set_detail(v1::DETAIL_NONE);
  request.mutable_open()->set_skip_refinement(true);
  expect_refused(request, grpc::StatusCode::INVALID_ARGUMENT, "skip_refinement");
}

TEST_F(LiveSessionTest, FaultsAreInvisible) {
  start();
  for (testing::FakeService* fake : {&fakes_.conversion(), &fakes_.superres(), &fakes_.refinement()}) {
    fake->faults.at(3, Faults::Kind::kBreak);
    fake->faults.at(9, Faults::Kind::kBreak);
  }
  const auto client = open(open_request());
  for (std::uint64_t i = 0; i < 15; ++i) {
    client->send(frame_request(i));
    expect_frame(client->receive(), i);
  }
}

TEST_F(LiveSessionTest, AClientThatDisappearsFreesEveryStage) {
  options_.answer_timeout_s = 60;
  start();
  fakes_.superres().faults.at(2, Faults::Kind::kHang);
  const auto client = open(open_request());
  for (std::uint64_t i = 0; i < 4; ++i) client->send(frame_request(i));
  EXPECT_TRUE(eventually([&] { return fakes_.superres().frames >= 2; }));
  client->vanish();
  EXPECT_EQ(client->finish().error_code(), grpc::StatusCode::CANCELLED);
  EXPECT_TRUE(eventually([&] { return all_stages_free(); }));
  EXPECT_TRUE(eventually([&] {
    return metrics_.text().find("pleat_sessions{service=\"coordinator\"} 0") != std::string::npos;
  })) << metrics_.text();
}

TEST_F(LiveSessionTest, AClientThatWaitsIsToldWhenAStageIsLost) {
  start();
  const auto client = open(open_request());
  client->send(frame_request(0));
  expect_frame(client->receive(), 0);
  fakes_.refinement().stop();
  // The client only reads: the status must reach it all the same.
  const grpc::Status status = client->finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_NE(status.error_message().find("refinement at " + fakes_.refinement().address()), std::string::npos)
      << status.error_message();
}

TEST_F(LiveSessionTest, BadOpensAreRefusedWithTheirCause) {
  start();
  using grpc::StatusCode;
  expect_refused(frame_request(0), StatusCode::INVALID_ARGUMENT, "open");
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->mutable_coarse()->set_faces(0, 99);
  expect_refused(request, StatusCode::INVALID_ARGUMENT, "open.coarse");
  request = open_request();
  request.mutable_open()->set_detail(static_cast<v1::Detail>(9));
  expect_refused(request, StatusCode::INVALID_ARGUMENT, "open.detail: unknown value 9");
  request = open_request();
  request.mutable_open()->mutable_coarse()->clear_uv();
  request.mutable_open()->mutable_coarse()->clear_uv_faces();
  expect_refused(request, StatusCode::INVALID_ARGUMENT, "open.coarse");
  request = open_request();
  request.mutable_open()->set_model("nobody");
  expect_refused(request, StatusCode::NOT_FOUND, "nobody");
  request = open_request();
  request.mutable_open()->set_window(65);
  expect_refused(request, StatusCode::INVALID_ARGUMENT, "window");
  request = open_request();
  request.mutable_open()->set_frame_time_s(-1);
  expect_refused(request, StatusCode::INVALID_ARGUMENT, "frame_time_s");
  request = open_request();
  request.mutable_open()->set_subdivision_rounds(30);
  expect_refused(request, StatusCode::INVALID_ARGUMENT, "subdivision_rounds");
  request = open_request();
  request.mutable_open()->add_obstacles()->set_name("ball");
  expect_refused(request, StatusCode::INVALID_ARGUMENT, "'ball'");
}

TEST_F(LiveSessionTest, ASecondOpenEndsTheStreamAfterTheFramesBefore) {
  start();
  const auto client = open(open_request());
  client->send(frame_request(0));
  client->send(open_request());
  expect_frame(client->receive(), 0);
  EXPECT_EQ(client->finish().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(LiveSessionTest, BytesThatAreNoMessageEndTheSessionWithTheirCause) {
  start();
  const auto garbage = test::with_first_field("\x0f");
  const auto open = test::with_first_field(open_request().open().SerializeAsString());
  const auto late = test::with_unknown_and_first_field("\x0f");
  for (const auto& messages : {std::vector{garbage}, std::vector{open, garbage}, std::vector{open, late}}) {
    const grpc::Status status =
        test::send_raw<v1::EnhanceResponse>(channel_, "/pleat.v1.Coordinator/Enhance", messages);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << status.error_message();
    EXPECT_EQ(status.error_message(), "bytes that are no message of this stream");
  }
}

TEST_F(LiveSessionTest, SessionsAreLimited) {
  options_.live.max_sessions = 1;
  start();
  auto client = open(open_request());
  expect_refused(open_request(), grpc::StatusCode::RESOURCE_EXHAUSTED, "live sessions");
  client->close();
  EXPECT_TRUE(client->finish().ok());
  EXPECT_TRUE(eventually([&] {
    Client next(*stub_);
    next.send(open_request());
    return next.receive().has_opened();
  }));
}

TEST_F(LiveSessionTest, ASilentClientMakesRoom) {
  options_.live.max_sessions = 1;
  options_.live.open_timeout_s = 0.2;
  options_.live.idle_timeout_s = 0.4;
  start();
  Client nothing_said(*stub_);
  EXPECT_EQ(nothing_said.finish().error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  ASSERT_TRUE(eventually([&] { return metrics_.sessions() == 0; }));
  const auto nothing_more = open(open_request());
  nothing_more->send(frame_request(0));
  expect_frame(nothing_more->receive(), 0);
  const grpc::Status status = nothing_more->finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_NE(status.error_message().find("sent no frame for 400 ms"), std::string::npos) << status.error_message();
  EXPECT_TRUE(eventually([&] { return metrics_.sessions() == 0; }));
}

TEST_F(LiveSessionTest, AnswersThatNobodyTakesOutOfSharedMemoryEndTheSession) {
  options_.live.reader_timeout_s = 0.3;
  start();
  rpc::FrameStreamOptions stream_options;
  stream_options.peer = "coordinator";
  stream_options.same_host = true;
  rpc::FrameStream<v1::EnhanceRequest, v1::EnhanceResponse> stream(
      [&](auto* context, auto* call) { stub_->async()->Enhance(context, call); }, stream_options);
  stream.open(open_request());
  ASSERT_TRUE(stream.shares_memory());
  v1::EnhanceResponse response;
  for (std::uint64_t i = 0; i < 3; ++i) {
    // Whoever is slow but takes them is not meant.
    std::this_thread::sleep_for(150ms);
    stream.push(frame_request(i));
    ASSERT_TRUE(stream.pop(&response));
  }
  stream.push(frame_request(3));
  ASSERT_TRUE(eventually([&] { return metrics_.sessions() == 0; }))
      << "long before the time for the next frame is over";
  const Error error = test::error_of([&] {
    while (stream.pop(&response)) {
    }
  });
  EXPECT_EQ(error.code(), ErrorCode::kDeadlineExceeded);
  EXPECT_NE(std::string(error.what()).find("did not take an answer for 300 ms"), std::string::npos) << error.what();
}

TEST_F(LiveSessionTest, AMeshIsAdmittedBeforeItIsSubdivided) {
  options_.live.max_vertices = 300;
  start();
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->set_subdivision_rounds(5);
  expect_refused(request, grpc::StatusCode::RESOURCE_EXHAUSTED, "open.coarse: 20 vertices, subdivided 5 times");
}

TEST_F(LiveSessionTest, TheMemoryOfAllSessionsIsLimited) {
  // One session with a window of 4: 5 x 4 frames of at most 320 fine vertices, 24 bytes each.
  options_.live.max_live_gb = 1.5 * 5 * 4 * 320 * 24 * 1e-9;
  start();
  auto client = open(open_request());
  expect_refused(open_request(), grpc::StatusCode::RESOURCE_EXHAUSTED, "a smaller window");
  v1::EnhanceRequest small = open_request();
  small.mutable_open()->set_window(1);
  auto another = open(small);
  another->close();
  EXPECT_TRUE(another->finish().ok());
  client->close();
  EXPECT_TRUE(client->finish().ok());
  EXPECT_TRUE(eventually([&] {
    Client next(*stub_);
    next.send(open_request());
    return next.receive().has_opened();
  }));
}

TEST_F(LiveSessionTest, ASessionGoesOnInAnotherCoordinatorWithTheSameBits) {
  fakes_.bundle().replace([](v1::ModelDescription& model) {
    model.mutable_representation()->set_window(3);
    model.mutable_representation()->set_window_stride(2);
  });
  for (const v1::Detail detail : {v1::DETAIL_NETWORK, v1::DETAIL_FOLD, v1::DETAIL_BOTH}) {
    start();
    v1::EnhanceRequest request = open_request();
    request.mutable_open()->set_detail(detail);
    request.mutable_open()->set_checkpoint_interval(4);
    v1::EnhanceRequest bad = frame_request(5);
    bad.mutable_frame()->mutable_coarse()->clear_positions();
    const auto frame = [&](std::uint64_t i) { return i == 5 ? bad : frame_request(i); };
    std::vector<v1::EnhanceResponse> whole;
    std::map<std::uint64_t, std::string> checkpoints;
    auto client = open(request);
    for (std::uint64_t i = 0; i < 16; ++i) {
      client->send(frame(i));
      whole.push_back(client->receive());
      ASSERT_EQ(whole.back().has_error(), i == 5) << whole.back().error().message();
      if (!whole.back().checkpoint().empty()) checkpoints[i + 1] = whole.back().checkpoint();
    }
    ASSERT_EQ(checkpoints.size(), 4U);
    client.reset();
    stop();
    start();
    for (const auto& [next, checkpoint] : checkpoints) {
      request.mutable_open()->set_checkpoint(checkpoint);
      const auto again = open(request);
      for (std::uint64_t i = next; i < 16; ++i) {
        again->send(frame(i));
        const v1::EnhanceResponse response = again->receive();
        ASSERT_EQ(response.has_error(), i == 5);
        EXPECT_EQ(response.frame().fine().index(), whole[i].frame().fine().index());
        ASSERT_EQ(positions_from_message(response.frame().fine()), positions_from_message(whole[i].frame().fine()))
            << "frame " << i << " after " << next << ", detail " << detail;
      }
      again->close();
      EXPECT_TRUE(again->finish().ok());
    }
    stop();
  }
}

TEST_F(LiveSessionTest, ACheckpointIsCheckedLikeAnyInput) {
  start();
  v1::EnhanceRequest request = open_request();
  request.mutable_open()->set_checkpoint("\x0f");
  expect_refused(request, grpc::StatusCode::INVALID_ARGUMENT, "open.checkpoint");
  request.mutable_open()->clear_checkpoint();
  request.mutable_open()->set_checkpoint_interval(1);
  const auto client = open(request);
  client->send(frame_request(0));
  v1::SessionCheckpoint checkpoint;
  ASSERT_TRUE(checkpoint.ParseFromString(client->receive().checkpoint()));
  checkpoint.mutable_earlier(0)->set_positions(4, std::numeric_limits<float>::infinity());
  request.mutable_open()->set_checkpoint(checkpoint.SerializeAsString());
  expect_refused(request, grpc::StatusCode::INVALID_ARGUMENT, "open.checkpoint: its frames are damaged");
}

TEST_F(LiveSessionTest, AWatcherSeesTheNewestFrames) {
  start();
  const auto list = [&](bool live_sessions) {
    grpc::ClientContext context;
    v1::ListJobsRequest request;
    request.set_live_sessions(live_sessions);
    v1::ListJobsResponse response;
    EXPECT_TRUE(stub_->ListJobs(&context, request, &response).ok());
    return response;
  };
  const auto client = open(open_request());
  client->send(frame_request(700));
  client->receive();
  EXPECT_EQ(list(false).jobs_size(), 0);
  ASSERT_TRUE(eventually([&] { return list(true).jobs(0).frames_complete() == 1; }));
  ASSERT_EQ(list(true).jobs_size(), 1);
  const v1::Job job = get(list(true).jobs(0).id());
  EXPECT_EQ(job.state(), v1::Job::STATE_RUNNING);
  EXPECT_EQ(job.summary().model(), "fake");
  EXPECT_EQ(job.summary().fine_vertices(), static_cast<std::uint32_t>(subdivision_.fine.vertex_count()));
  EXPECT_EQ(job.result_path(), "");

  std::vector<v1::JobEvent> frames;
  std::atomic<int> seen = 0;
  std::string fine_hash;
  v1::Job last;
  grpc::Status status;
  std::thread watcher([&] {
    status = watch(job.id(), 0, true, [&](const v1::JobEvent& event) {
      if (event.has_opened()) fine_hash = topology_hash(from_message(event.opened().fine()));
      if (event.has_progress()) last = event.progress();
      if (event.has_frame() || event.has_error()) frames.push_back(event);
      ++seen;
    });
  });
  // The first events say how far it is and what frames refer to.
  EXPECT_TRUE(eventually([&] { return seen >= 2; }));
  for (const std::uint64_t index : {12, 12, 3}) {
    const int before = seen;
    client->send(frame_request(index));
    EXPECT_EQ(client->receive().frame().fine().index(), index);
    EXPECT_TRUE(eventually([&] { return seen > before; }));
  }
  const int before = seen;
  v1::EnhanceRequest bad = frame_request(4);
  bad.mutable_frame()->mutable_coarse()->clear_positions();
  client->send(bad);
  EXPECT_TRUE(client->receive().has_error());
  EXPECT_TRUE(eventually([&] { return seen > before; }));
  client->close();
  EXPECT_TRUE(client->finish().ok());
  watcher.join();
  EXPECT_TRUE(status.ok()) << status.error_message();

  EXPECT_EQ(fine_hash, topology_hash(subdivision_.fine));
  ASSERT_GE(frames.size(), 4U);
  for (std::size_t i = 0; i < 3; ++i) {
    const v1::EnhancedFrame& frame = frames[i].frame();
    EXPECT_EQ(frame.fine().index(), i + 1) << "the place in the session";
    EXPECT_EQ(frame.fine().positions_size(), 3 * subdivision_.fine.vertex_count());
    EXPECT_EQ(frame.coarse().positions_size(), 3 * coarse_.vertex_count());
    EXPECT_EQ(frame.obstacles_size(), 1);
    EXPECT_EQ(frame.stage_times_size(), 4);
  }
  EXPECT_EQ(frames[3].error().index(), 4U);
  EXPECT_EQ(last.state(), v1::Job::STATE_DONE);
  EXPECT_EQ(last.frames_complete(), 5U);
  EXPECT_EQ(last.summary().frame_errors(), 1U);
  EXPECT_TRUE(eventually([&] { return list(true).jobs_size() == 0; }));
  EXPECT_EQ(watch(job.id(), 0, true).error_code(), grpc::StatusCode::NOT_FOUND);
}

TEST_F(LiveSessionTest, AStoppingCoordinatorAnswersWhatIsInFlight) {
  start();
  fakes_.superres().faults.delay(30ms);
  const auto client = open(open_request());
  client->send(frame_request(0));
  ASSERT_TRUE(eventually([&] { return fakes_.conversion().frames > 0; }));
  service_->drain();
  expect_frame(client->receive(), 0);
  EXPECT_EQ(client->finish().error_code(), grpc::StatusCode::UNAVAILABLE);
  expect_refused(open_request(), grpc::StatusCode::UNAVAILABLE, "stopping");
}

}  // namespace
}  // namespace pleat::coordinator
