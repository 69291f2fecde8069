// The whole pipeline as its users run it: processes on one host.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "common/client/cpp/client.hpp"
#include "common/client/cpp/messages.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/channel.hpp"
#include "common/store/result.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "tests/integration/service_processes.hpp"

namespace pleat::testing {
namespace {

using namespace std::chrono_literals;

constexpr std::uint32_t kFrames = 40;

class ServicesTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    processes_ = std::make_unique<ServiceProcesses>();
    scene_ = presentation::read_scene_file("deploy/scenes/draping.json");
    stub_ = processes_->client();
  }
  static void TearDownTestSuite() {
    stub_.reset();
    processes_.reset();
  }

  static v1::Job create(const std::string& id, std::uint32_t frames, bool reference = false,
                        v1::Coordinator::Stub* stub = stub_.get(), v1::Detail detail = v1::DETAIL_NETWORK) {
    v1::CreateJobRequest request;
    *request.mutable_scene() = scene_;
    request.set_frames(frames);
    request.set_reference(reference);
    request.set_detail(detail);
    request.set_job_id(id);
    grpc::ClientContext context;
    v1::Job job;
    const grpc::Status status = stub->CreateJob(&context, request, &job);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return job;
  }
  static v1::Job get(const std::string& id) {
    grpc::ClientContext context;
    v1::GetJobRequest request;
    request.set_id(id);
    v1::Job job;
    const grpc::Status status = stub_->GetJob(&context, request, &job);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return job;
  }
  /// Watches to the end of the job and returns its last state.
  static v1::Job finished(const std::string& id, v1::Coordinator::Stub* stub = stub_.get()) {
    grpc::ClientContext context;
    v1::WatchJobRequest request;
    request.set_id(id);
    const auto reader = stub->WatchJob(&context, request);
    v1::JobEvent event;
    v1::Job job;
    while (reader->Read(&event)) job = event.progress();
    const grpc::Status status = reader->Finish();
    EXPECT_TRUE(status.ok()) << status.error_message();
    return job;
  }
  static bool eventually(const std::function<bool()>& condition, std::chrono::milliseconds limit = 30s) {
    const auto deadline = std::chrono::steady_clock::now() + limit;
    while (!condition()) {
      if (std::chrono::steady_clock::now() > deadline) return false;
      std::this_thread::sleep_for(20ms);
    }
    return true;
  }
  static bool all_stages_free() {
    for (const std::string& stage : ServiceProcesses::stages()) {
      if (processes_->connections(stage) > 0) return false;
    }
    return true;
  }
  static std::string logs() {
    std::string all;
    for (const std::string& stage : ServiceProcesses::stages()) all += stage + ": " + processes_->log(stage) + "\n";
    return all + "coordinator: " + processes_->log("coordinator");
  }

  /// A job that the kill met in its middle, finished. One that ended before it is left and another is tried.
  static v1::Job killed(const std::string& service, const std::string& prefix, v1::Detail detail) {
    for (int attempt = 0; attempt < 50; ++attempt) {
      const std::string id = prefix + "-without-" + service + "-" + std::to_string(attempt);
      create(id, kFrames, false, stub_.get(), detail);
      EXPECT_TRUE(eventually([&] { return get(id).frames_complete() >= 4; })) << logs();
      const bool met = processes_->kill_within_job(service, id);
      const v1::Job job = finished(id);
      EXPECT_EQ(job.state(), v1::Job::STATE_DONE) << service << ": " << job.error() << "\n" << logs();
      EXPECT_EQ(job.summary().frame_errors(), 0U) << service;
      if (met) return job;
    }
    ADD_FAILURE() << "no kill of " << service << " met a running job";
    return {};
  }

  /// What a live session answers to the coarse frames of a job's result; `at` is called behind each answer.
  static std::vector<std::vector<float>> enhance_again(const client::Client& client, const ResultReader& made,
                                                       v1::Detail detail, std::chrono::seconds patience,
                                                       const std::function<void(std::uint64_t)>& at) {
    client::EnhanceSession session = client.enhance(
        {.coarse = client::from_message(scene_.garment_mesh(), "garment"), .detail = detail, .patience = patience});
    std::vector<std::vector<float>> fine;
    session.run(
        kFrames,
        [&](std::uint64_t k) {
          client::CoarseFrame frame;
          frame.index = k;
          frame.time_s = 0.04 * static_cast<double>(k);
          const Positions coarse = made.coarse(k, k + 1)[0];
          frame.positions.assign(coarse.data(), coarse.data() + coarse.size());
          return frame;
        },
        [&](const client::EnhancedFrame& answer, const client::CoarseFrame&) {
          EXPECT_FALSE(answer.error) << answer.error->what();
          EXPECT_EQ(answer.index, fine.size());
          fine.push_back(answer.positions);
          at(answer.index);
        });
    return fine;
  }

  /// The undisturbed job that the others are compared with; made once.
  static v1::Job calm() {
    static const v1::Job job = [] {
      create("calm", kFrames, true);
      return finished("calm");
    }();
    return job;
  }

  static void expect_same_bits(const std::string& path, const std::string& other) {
    const ResultReader a(path), b(other);
    ASSERT_EQ(a.frames_complete(), b.frames_complete());
    for (std::uint64_t i = 0; i < a.frames_complete(); ++i) {
      ASSERT_EQ(a.coarse(i, i + 1)[0], b.coarse(i, i + 1)[0]) << "coarse, frame " << i;
      ASSERT_EQ(a.enhanced(i, i + 1)[0], b.enhanced(i, i + 1)[0]) << "enhanced, frame " << i;
    }
  }

  static std::unique_ptr<ServiceProcesses> processes_;
  static v1::Scene scene_;
  static std::unique_ptr<v1::Coordinator::Stub> stub_;
};

std::unique_ptr<ServiceProcesses> ServicesTest::processes_;
v1::Scene ServicesTest::scene_;
std::unique_ptr<v1::Coordinator::Stub> ServicesTest::stub_;

TEST_F(ServicesTest, AJobWithReferenceEndsInACleanResult) {
  const v1::Job job = calm();
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error() << "\n" << logs();
  EXPECT_EQ(job.frames_complete(), kFrames);
  EXPECT_EQ(job.reference_frames_complete(), kFrames);
  EXPECT_EQ(job.summary().coarse_vertices(), 749U);
  EXPECT_EQ(job.summary().fine_vertices(), 11393U);
  EXPECT_EQ(job.summary().penetrations(), 0U);
  EXPECT_EQ(job.summary().self_intersections(), 0U);
  EXPECT_EQ(job.summary().frame_errors(), 0U);
  const ResultReader reader(job.result_path());
  EXPECT_EQ(reader.frames_complete(), kFrames);
  EXPECT_TRUE(reader.info().has_fine);
  for (const char* stage : {"simulation", "to_image", "superres", "to_mesh", "refinement"}) {
    EXPECT_GT(reader.stage_ms(stage, 5, 6)[0], 0.0F) << stage;
  }
  const Positions first = reader.enhanced(0, 1)[0];
  const Positions last = reader.enhanced(kFrames - 1, kFrames)[0];
  EXPECT_TRUE(last.allFinite());
  EXPECT_LT(last.col(1).mean(), first.col(1).mean() - 0.1F) << "the cloth falls";
}

TEST_F(ServicesTest, KillingEveryServiceLeavesTheSameBits) {
  const v1::Job undisturbed = calm();
  for (const std::string service : {"simulation", "conversion", "superres", "refinement", "coordinator"}) {
    expect_same_bits(killed(service, "stormy", v1::DETAIL_NETWORK).result_path(), undisturbed.result_path());
  }
}

TEST_F(ServicesTest, TheFoldStepMakesCleanFramesAndAKillLeavesTheirBits) {
  for (const v1::Detail detail : {v1::DETAIL_FOLD, v1::DETAIL_BOTH}) {
    const std::string name = detail == v1::DETAIL_FOLD ? "folded" : "folded-network";
    create(name, kFrames, false, stub_.get(), detail);
    const v1::Job undisturbed = finished(name);
    ASSERT_EQ(undisturbed.state(), v1::Job::STATE_DONE) << undisturbed.error() << "\n" << logs();
    EXPECT_EQ(undisturbed.summary().penetrations(), 0U);
    EXPECT_EQ(undisturbed.summary().self_intersections(), 0U);
    EXPECT_EQ(undisturbed.summary().frame_errors(), 0U);
    const ResultReader reader(undisturbed.result_path());
    EXPECT_GT(reader.stage_ms("fold", 5, 6)[0], 0.0F);
    const auto restarts = reader.counts("fold_restarts", 0, kFrames);
    EXPECT_EQ(std::count(restarts.begin(), restarts.end(), 1U), 1) << "the first frame alone begins anew";
    // A coordinator that goes on makes the frames again that lie behind its check-point.
    for (const std::string service : {"fold", "coordinator"}) {
      expect_same_bits(killed(service, name, detail).result_path(), undisturbed.result_path());
    }
  }
}

TEST_F(ServicesTest, TwoJobsAtOnceAreBothRight) {
  const v1::Job undisturbed = calm();
  create("one", 15);
  create("two", 15);
  for (const char* id : {"one", "two"}) {
    const v1::Job job = finished(id);
    ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error() << "\n" << logs();
    const ResultReader made(job.result_path()), expected(undisturbed.result_path());
    for (std::uint64_t i = 0; i < 15; ++i) {
      ASSERT_EQ(made.coarse(i, i + 1)[0], expected.coarse(i, i + 1)[0]) << id << " " << i;
      ASSERT_EQ(made.enhanced(i, i + 1)[0], expected.enhanced(i, i + 1)[0]) << id << " " << i;
    }
  }
}

TEST_F(ServicesTest, ACancelledJobKeepsItsFramesAndFreesTheStages) {
  create("cancelled", 100'000);
  ASSERT_TRUE(eventually([] { return get("cancelled").frames_complete() >= 3; })) << logs();
  grpc::ClientContext context;
  v1::CancelJobRequest request;
  request.set_id("cancelled");
  v1::Job job;
  ASSERT_TRUE(stub_->CancelJob(&context, request, &job).ok());
  EXPECT_EQ(job.state(), v1::Job::STATE_CANCELLED);
  EXPECT_TRUE(eventually(all_stages_free)) << logs();
  EXPECT_EQ(ResultReader(get("cancelled").result_path()).frames_complete(), get("cancelled").frames_complete());
}

/// One live session on the calm job's coarse frames.
class Session {
 public:
  Session(v1::Coordinator::Stub& stub, const v1::Topology& coarse) : stream_(stub.Enhance(&context_)) {
    v1::EnhanceRequest request;
    *request.mutable_open()->mutable_coarse() = coarse;
    request.mutable_open()->set_detail(v1::DETAIL_NETWORK);  // as the job that it is compared with
    stream_->Write(request);
    stream_->Read(&response_);
  }
  bool opened() const { return response_.has_opened(); }
  const v1::EnhanceResponse& exchange(std::uint64_t index, const Positions& positions) {
    send(index, positions);
    response_.Clear();
    stream_->Read(&response_);
    return response_;
  }
  void send(std::uint64_t index, const Positions& positions) {
    v1::EnhanceRequest request;
    request.mutable_frame()->mutable_coarse()->set_index(index);
    to_message(positions, request.mutable_frame()->mutable_coarse()->mutable_positions());
    stream_->Write(request);
  }
  grpc::Status finish() {
    stream_->WritesDone();
    while (stream_->Read(&response_)) {
    }
    return stream_->Finish();
  }
  void vanish() { context_.TryCancel(); }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::EnhanceRequest, v1::EnhanceResponse>> stream_;
  v1::EnhanceResponse response_;
};

TEST_F(ServicesTest, ALiveSessionEnhancesAndSurvivesABadFrame) {
  const ResultReader made(calm().result_path());
  Session session(*stub_, scene_.garment_mesh());
  ASSERT_TRUE(session.opened()) << session.finish().error_message() << "\n" << logs();
  for (std::uint64_t i = 0; i < 10; ++i) {
    const Positions coarse = made.coarse(i, i + 1)[0];
    if (i == 5) {
      const auto& answer = session.exchange(99, coarse.topRows(700));
      ASSERT_TRUE(answer.has_error());
      EXPECT_EQ(answer.error().index(), 99U);
      EXPECT_NE(answer.error().message().find("749 vertices"), std::string::npos) << answer.error().message();
    }
    const auto& answer = session.exchange(i, coarse);
    ASSERT_TRUE(answer.has_frame()) << answer.error().message();
    EXPECT_EQ(answer.frame().fine().index(), i);
    EXPECT_EQ(answer.frame().report().self_intersections_after(), 0U);
    const Positions fine = positions_from_message(answer.frame().fine());
    // The job's velocities were the simulation's, these are differences of rounded positions: almost the same frame.
    EXPECT_LT((fine - made.enhanced(i, i + 1)[0]).cwiseAbs().maxCoeff(), 1e-2F) << i;
  }
  const grpc::Status status = session.finish();
  EXPECT_TRUE(status.ok()) << status.error_message();
}

TEST_F(ServicesTest, AClientThatDisappearsFreesTheStages) {
  const ResultReader made(calm().result_path());
  ASSERT_TRUE(eventually(all_stages_free));
  Session session(*stub_, scene_.garment_mesh());
  ASSERT_TRUE(session.opened());
  EXPECT_FALSE(all_stages_free());
  for (std::uint64_t i = 0; i < 4; ++i) session.send(i, made.coarse(i, i + 1)[0]);
  session.vanish();
  EXPECT_TRUE(eventually(all_stages_free)) << logs();
  EXPECT_EQ(session.finish().error_code(), grpc::StatusCode::CANCELLED);
}

TEST_F(ServicesTest, ALiveSessionOutlivesAKilledCoordinatorWithTheSameBits) {
  const ResultReader made(calm().result_path());
  const client::Client client(processes_->address("coordinator"));
  for (const v1::Detail detail : {v1::DETAIL_NETWORK, v1::DETAIL_FOLD}) {
    const auto enhance = [&](const std::set<std::uint64_t>& kills) {
      return enhance_again(client, made, detail, 60s, [&](std::uint64_t k) {
        if (!kills.contains(k)) return;
        processes_->kill("coordinator");
        processes_->start("coordinator");
      });
    };
    const auto undisturbed = enhance({});
    ASSERT_EQ(undisturbed.size(), kFrames);
    EXPECT_EQ(enhance({3, 31}), undisturbed) << logs();
  }
  processes_->wait_until_healthy("coordinator");
}

/// One id in the logs of all six processes, before and after a kill of the coordinator.
TEST_F(ServicesTest, ATraceIsInTheLogsOfAllServices) {
  const std::string id = "4bf92f3577b34da6a3ce929d0e0e4736";
  const auto lines = [&](const std::string& service, const std::string& trace) {
    const std::string log = processes_->whole_log(service);
    int count = 0;
    for (std::size_t at = log.find("trace=" + trace); at != std::string::npos; at = log.find(trace, at + 1)) ++count;
    return count;
  };
  v1::CreateJobRequest request;
  *request.mutable_scene() = scene_;
  request.set_frames(4 * kFrames);
  request.set_detail(v1::DETAIL_BOTH);
  request.set_job_id("traced");
  {
    const client::Client client(processes_->address("coordinator"), {}, "00-" + id + "-00f067aa0ba902b7-01");
    EXPECT_EQ(client.create_job(request).trace_id(), id);
  }
  ASSERT_TRUE(eventually([] { return get("traced").frames_complete() >= 4; })) << logs();
  const std::vector<std::string> stages = ServiceProcesses::stages();
  for (const std::string& stage : stages) EXPECT_GT(lines(stage, id), 0) << stage << ": " << processes_->log(stage);
  const int before = lines("coordinator", id);
  EXPECT_GT(before, 0);
  processes_->kill("coordinator");
  processes_->start("coordinator");
  processes_->wait_until_healthy("coordinator");
  const v1::Job job = finished("traced");
  EXPECT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  EXPECT_EQ(job.trace_id(), id);
  EXPECT_TRUE(eventually([&] { return lines("coordinator", id) > before; })) << logs();

  // A live session, of a client that says nothing: the coordinator makes one.
  const client::Client client(processes_->address("coordinator"));
  const client::EnhanceSession session =
      client.enhance({.coarse = client::from_message(scene_.garment_mesh(), "garment"), .detail = v1::DETAIL_BOTH});
  std::string made;
  for (const v1::Job& live : client.list_jobs(true)) {
    if (live.id().starts_with("live:")) made = live.trace_id();
  }
  ASSERT_EQ(made.size(), id.size());
  EXPECT_NE(made, id);
  for (const std::string& stage : stages) {
    if (stage == "simulation") continue;
    EXPECT_GT(lines(stage, made), 0) << stage << ": " << processes_->log(stage);
  }
  EXPECT_GT(lines("coordinator", made), 0) << processes_->log("coordinator");
}

/// Every stage has two replicas, and each of them is told to stop while a job and a live session are at work.
class DrainTest : public ServicesTest {
 protected:
  static constexpr const char* kCoordinator = "pair";
  static constexpr std::uint32_t kLong = 4 * kFrames;

  static void start_pair() {
    std::map<std::string, std::string> links;
    for (const std::string& stage : ServiceProcesses::stages()) {
      for (const char* replica : {"-1", "-2"}) processes_->start_replica(stage + replica);
    }
    for (const std::string& stage : ServiceProcesses::stages()) {
      for (const char* replica : {"-1", "-2"}) processes_->wait_until_healthy(stage + replica);
      links[stage] = processes_->address(stage + "-1") + "," + processes_->address(stage + "-2");
    }
    processes_->start_coordinator(kCoordinator, links);
  }

  static v1::Job get_of(v1::Coordinator::Stub& stub, const std::string& id) {
    grpc::ClientContext context;
    v1::GetJobRequest request;
    request.set_id(id);
    v1::Job job;
    const grpc::Status status = stub.GetJob(&context, request, &job);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return job;
  }
};

TEST_F(DrainTest, AReplicaThatIsToldToStopLosesNoFrame) {
  start_pair();
  const auto stub = processes_->client(kCoordinator);
  const client::Client client(processes_->address(kCoordinator));
  create("undrained", kLong, false, stub.get(), v1::DETAIL_BOTH);
  const v1::Job undrained = finished("undrained", stub.get());
  ASSERT_EQ(undrained.state(), v1::Job::STATE_DONE) << undrained.error();
  const ResultReader made(undrained.result_path());
  const auto undisturbed = enhance_again(client, made, v1::DETAIL_BOTH, 0s, [](std::uint64_t) {});
  ASSERT_EQ(undisturbed.size(), kFrames);

  for (const std::string& stage : ServiceProcesses::stages()) {
    bool met = false;
    for (int attempt = 0; attempt < 20 && !met; ++attempt) {
      const std::string id = "drained-" + stage + "-" + std::to_string(attempt);
      // Between the two the job and the session are with both replicas, whichever they began with.
      const auto drain = [&](const std::string& replica) {
        EXPECT_EQ(processes_->terminate(replica), "exit code 0") << processes_->log(replica);
        const bool at_work = get_of(*stub, id).state() == v1::Job::STATE_RUNNING;
        processes_->start(replica);
        processes_->wait_until_healthy(replica);
        return at_work;
      };
      const auto answers = enhance_again(client, made, v1::DETAIL_BOTH, 0s, [&](std::uint64_t index) {
        if (index == 5) {
          create(id, kLong, false, stub.get(), v1::DETAIL_BOTH);
          EXPECT_TRUE(eventually([&] { return get_of(*stub, id).frames_complete() >= 4; }));
          met = drain(stage + "-1");
        }
        if (index == 20) met = drain(stage + "-2") || (met && stage == "superres");
      });
      EXPECT_EQ(answers, undisturbed) << stage;
      const v1::Job job = finished(id, stub.get());
      EXPECT_EQ(job.state(), v1::Job::STATE_DONE) << stage << ": " << job.error();
      EXPECT_EQ(job.summary().frame_errors(), 0U) << stage;
      expect_same_bits(job.result_path(), undrained.result_path());
    }
    EXPECT_TRUE(met) << "no drain of " << stage << " met a running job";
  }
}

TEST_F(ServicesTest, AMissingServiceIsNamedWithItsAddress) {
  const std::string nowhere = "unix:" + (processes_->folder() / "nowhere.sock").string();
  processes_->start_coordinator("lonely", {{"simulation", processes_->address("simulation")},
                                           {"conversion", processes_->address("conversion")},
                                           {"superres", processes_->address("superres")},
                                           {"refinement", nowhere},
                                           {"give-up-s", "1"}});
  const auto stub = processes_->client("lonely");
  create("doomed", 3, false, stub.get());
  const v1::Job job = finished("doomed", stub.get());
  EXPECT_EQ(job.state(), v1::Job::STATE_FAILED);
  EXPECT_NE(job.error().find("refinement at " + nowhere), std::string::npos) << job.error();
  EXPECT_EQ(processes_->terminate("lonely"), "exit code 0");
}

}  // namespace
}  // namespace pleat::testing
