#include <sys/resource.h>

#include <algorithm>
#include <csignal>
#include <fstream>
#include <optional>

#include "common/frame/messages.hpp"
#include "common/scene/animation_parts.hpp"
#include "common/store/result.hpp"
#include "tests/unit/services/coordinator/coordinator_fixture.hpp"

namespace pleat::coordinator {
namespace {

using testing::Faults;
using namespace std::chrono_literals;

class JobsTest : public CoordinatorTest {
 protected:
  /// Every array of a result against what the fakes make of the scene.
  void expect_right(const std::string& path, std::uint64_t frames, bool fine = false,
                    const std::vector<std::uint64_t>& failed = {}) {
    const ResultReader reader(path);
    ASSERT_EQ(reader.frames_complete(), frames);
    const Topology coarse = testing::sheet();
    const Subdivision subdivision = subdivide(coarse, 2);
    EXPECT_EQ(topology_hash(reader.info().topology.fine), topology_hash(subdivision.fine));
    EXPECT_EQ(reader.info().model, "fake");
    EXPECT_EQ(reader.info().has_fine, fine);
    EXPECT_EQ(reader.info().frame_time_s, 0.04);
    for (std::uint64_t i = 0; i < frames; ++i) {
      const v1::Frame frame = testing::fake_coarse_frame(coarse, i);
      const Positions positions = positions_from_message(frame);
      ASSERT_EQ(reader.coarse(i, i + 1)[0], positions) << i;
      const bool bad = std::find(failed.begin(), failed.end(), i) != failed.end();
      const Positions made = testing::fake_enhanced(subdivision, coarse.faces, frame);
      ASSERT_EQ(reader.enhanced(i, i + 1)[0], bad ? upsample(subdivision, coarse.faces, positions) : made) << i;
      if (fine) {
        ASSERT_EQ(reader.fine(i, i + 1)[0], made) << i;
      }
      ASSERT_EQ(reader.times(i, i + 1)[0], 0.04 * static_cast<double>(i));
      ASSERT_EQ(reader.obstacles(i, i + 1)[0][0].center.x(), 0.1F * static_cast<float>(i));
      ASSERT_EQ(reader.counts("frame_errors", i, i + 1)[0], bad ? 1U : 0U);
    }
    EXPECT_EQ(reader.stage_ms("superres", 0, 1)[0], 6.0F);
    EXPECT_EQ(reader.stage_ms("simulation", 0, 1)[0], 1.5F);
  }
};

TEST_F(JobsTest, AJobEndsInItsResultFile) {
  start();
  EXPECT_EQ(create(20, "a").id(), "a");
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  EXPECT_EQ(job.frames_complete(), 20U);
  EXPECT_EQ(job.summary().coarse_vertices(), 20U);
  EXPECT_EQ(job.summary().fine_vertices(), 221U);
  EXPECT_EQ(job.summary().penetrations(), 1U) << "the fake leaves one in frame 3";
  EXPECT_EQ(job.summary().self_intersections(), 0U);
  EXPECT_EQ(job.summary().model(), "fake");
  EXPECT_EQ(job.summary().precision(), "float32");
  EXPECT_GT(job.summary().wall_s(), 0);
  expect_right(job.result_path(), 20);
  EXPECT_FALSE(std::filesystem::exists(job.result_path() + ".partial"));
}

TEST_F(JobsTest, ARetriedRequestIsTheSameJob) {
  start();
  create(3, "a");
  EXPECT_EQ(create(3, "a").id(), "a");
  finished("a");
  EXPECT_EQ(create(3, "a").state(), v1::Job::STATE_DONE);
  v1::CreateJobRequest other;
  *other.mutable_scene() = testing::fake_scene(4);
  other.set_job_id("a");
  v1::Job job;
  EXPECT_EQ(create(other, &job).error_code(), grpc::StatusCode::ALREADY_EXISTS);
}

class PartsTest : public JobsTest {
 protected:
  PartsTest() {
    request_.set_job_id("parts");
    request_.set_detail(v1::DETAIL_NETWORK);
    *request_.mutable_scene() = testing::fake_scene(6);
    v1::Obstacle& ball = *request_.mutable_scene()->add_obstacles();
    ball.set_name("puppet");
    ball.mutable_sphere()->set_radius(1);
    ball.mutable_animation()->mutable_positions()->Resize(3 * 6, 0.5F);
    whole_ = request_;
    parts_ = take_animations(*request_.mutable_scene(), 0);
  }

  /// What the call says after the request and these parts; an empty optional is the request.
  grpc::Status send(const std::vector<std::optional<v1::AnimationPart>>& parts, v1::Job* job) {
    grpc::ClientContext context;
    const auto writer = stub_->CreateJobInParts(&context, job);
    for (const auto& animation : parts) {
      v1::CreateJobPart part;
      if (animation) {
        *part.mutable_animation() = *animation;
      } else {
        *part.mutable_request() = request_;
      }
      if (!writer->Write(part)) return writer->Finish();
    }
    writer->WritesDone();
    return writer->Finish();
  }

  v1::CreateJobRequest request_, whole_;
  std::vector<v1::AnimationPart> parts_;
};

TEST_F(PartsTest, AJobInPartsIsTheJob) {
  start();
  v1::Job job;
  ASSERT_TRUE(send({std::nullopt, parts_[0]}, &job).ok());
  EXPECT_EQ(finished("parts").state(), v1::Job::STATE_DONE);
  // The same request, whole or in parts, is the same job.
  EXPECT_TRUE(create(whole_, &job).ok());
  EXPECT_TRUE(send({std::nullopt, parts_[0]}, &job).ok());
  parts_[0].set_positions(0, 7);
  EXPECT_EQ(send({std::nullopt, parts_[0]}, &job).error_code(), grpc::StatusCode::ALREADY_EXISTS);
}

TEST_F(PartsTest, WrongPartsAreRefusedAndLeaveNoJob) {
  start();
  const auto refused = [&](const std::vector<std::optional<v1::AnimationPart>>& parts, const std::string& text) {
    v1::Job job;
    const grpc::Status status = send(parts, &job);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << text;
    EXPECT_NE(status.error_message().find(text), std::string::npos) << status.error_message();
  };
  refused({}, "must be its request");
  refused({parts_[0]}, "must be its request");
  refused({std::nullopt}, "'puppet' misses 6 samples");
  refused({std::nullopt, std::nullopt}, "only parts of animations");
  refused({std::nullopt, parts_[0], parts_[0]}, "no more parts");
  grpc::ClientContext context;
  v1::ListJobsResponse jobs;
  ASSERT_TRUE(stub_->ListJobs(&context, {}, &jobs).ok());
  EXPECT_EQ(jobs.jobs_size(), 0);
}

TEST_F(PartsTest, AClientThatSendsNothingMoreIsCutOff) {
  options_.live.idle_timeout_s = 0.2;
  options_.max_uploads = 1;
  start();
  v1::Job job;
  grpc::ClientContext silent;
  v1::CreateJobPart part;
  *part.mutable_request() = request_;
  const auto writer = stub_->CreateJobInParts(&silent, &job);
  ASSERT_TRUE(writer->Write(part));
  const grpc::StatusCode code = writer->Finish().error_code();
  EXPECT_TRUE(code == grpc::StatusCode::DEADLINE_EXCEEDED || code == grpc::StatusCode::CANCELLED);
  // Its place is free again.
  EXPECT_TRUE(eventually([&] { return send({std::nullopt, parts_[0]}, &job).ok(); }));
}

TEST_F(JobsTest, BadRequestsAreRefusedWithTheirCauseAndLeaveNoJob) {
  start();
  const auto refused = [&](grpc::StatusCode code, const std::string& cause,
                           const std::function<void(v1::CreateJobRequest&)>& spoil) {
    v1::CreateJobRequest request;
    *request.mutable_scene() = testing::fake_scene(4);
    spoil(request);
    v1::Job job;
    const grpc::Status status = create(request, &job);
    EXPECT_EQ(status.error_code(), code) << status.error_message();
    EXPECT_NE(status.error_message().find(cause), std::string::npos) << status.error_message();
  };
  using Request = v1::CreateJobRequest;
  using grpc::StatusCode;
  refused(StatusCode::INVALID_ARGUMENT, "scene", [](Request& r) { r.clear_scene(); });
  refused(StatusCode::INVALID_ARGUMENT, "scene.frames", [](Request& r) { r.mutable_scene()->set_frames(0); });
  refused(StatusCode::INVALID_ARGUMENT, "scene.name", [](Request& r) { r.mutable_scene()->set_name("../x"); });
  refused(StatusCode::INVALID_ARGUMENT, "scene.gravity", [](Request& r) { r.mutable_scene()->add_gravity(1); });
  refused(StatusCode::INVALID_ARGUMENT, "job_id", [](Request& r) { r.set_job_id("a b"); });
  refused(StatusCode::NOT_FOUND, "nobody", [](Request& r) { r.set_model("nobody"); });
  refused(StatusCode::RESOURCE_EXHAUSTED, "scene.frames", [](Request& r) { r.set_frames(2'000'000'000); });
  grpc::ClientContext context;
  v1::ListJobsResponse jobs;
  EXPECT_TRUE(stub_->ListJobs(&context, {}, &jobs).ok());
  EXPECT_EQ(jobs.jobs_size(), 0);
  EXPECT_EQ(watch("nobody", 0, false).error_code(), grpc::StatusCode::NOT_FOUND);
}

TEST_F(JobsTest, AReferenceIsSimulatedAfterThePipeline) {
  start();
  create(8, "a", true);
  bool referenced = false;
  EXPECT_TRUE(watch("a", 0, false, [&](const v1::JobEvent& event) {
                referenced = referenced || event.progress().state() == v1::Job::STATE_REFERENCE;
              }).ok());
  const v1::Job job = get("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  EXPECT_EQ(job.reference_frames_complete(), 8U);
  expect_right(job.result_path(), 8, true);
}

TEST_F(JobsTest, FaultsInEveryStageLeaveTheSameBits) {
  start();
  for (testing::FakeService* fake : fakes_.all()) {
    fake->faults.at(4, Faults::Kind::kBreak);
    fake->faults.at(11, Faults::Kind::kBreak);
  }
  fakes_.refinement().faults.at(13, Faults::Kind::kHang);
  create(16, "a");
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  EXPECT_EQ(job.summary().frame_errors(), 0U);
  ASSERT_EQ(job.warnings_size(), 1) << "a simulation that goes on after a fault says it again";
  EXPECT_EQ(job.warnings(0), "doubtful, on purpose");
  expect_right(job.result_path(), 16);
  EXPECT_NE(metrics_.text().find("pleat_reconnects_total"), std::string::npos);
}

TEST_F(JobsTest, AReplacedBundleFailsTheJobThatMeetsIt) {
  start();
  fakes_.simulation().faults.delay(2ms);
  create(100'000, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 5; }));
  fakes_.bundle().replace([](v1::ModelDescription& model) { model.mutable_representation()->set_window(2); });
  fakes_.superres().stop();
  fakes_.superres().start();
  const v1::Job job = finished("a");
  EXPECT_EQ(job.state(), v1::Job::STATE_FAILED);
  EXPECT_NE(job.error().find("replaced meanwhile by one with another representation"), std::string::npos)
      << job.error();
  expect_right(job.result_path(), job.frames_complete());
}

TEST_F(JobsTest, AFrameErrorKeepsTheJobAndTheUpsampledFrame) {
  start();
  fakes_.superres().faults.at(5, Faults::Kind::kFrameError);
  create(9, "a");
  std::vector<std::uint64_t> seen, errors;
  EXPECT_TRUE(watch("a", 0, true, [&](const v1::JobEvent& event) {
                if (event.has_frame()) seen.push_back(event.frame().fine().index());
                if (event.has_error()) errors.push_back(event.error().index());
              }).ok());
  EXPECT_EQ(seen, (std::vector<std::uint64_t>{0, 1, 2, 3, 4, 6, 7, 8}));
  EXPECT_EQ(errors, (std::vector<std::uint64_t>{5}));
  const v1::Job job = get("a");
  EXPECT_EQ(job.state(), v1::Job::STATE_DONE);
  EXPECT_EQ(job.summary().frame_errors(), 1U);
  expect_right(job.result_path(), 9, false, {5});
}

TEST_F(JobsTest, WatchersOfAFrameErrorGetWhatTheFileHolds) {
  start();
  fakes_.superres().faults.at(2, Faults::Kind::kFrameError);
  create(4, "a");
  std::vector<v1::EnhancedFrame> replacements;
  for (int time = 0; time < 2; ++time) {  // while it runs, and from the file
    EXPECT_TRUE(watch("a", 0, true, [&](const v1::JobEvent& event) {
                  EXPECT_EQ(event.has_replacement(), event.has_error());
                  if (event.has_error()) replacements.push_back(event.replacement());
                }).ok());
  }
  const Positions stored = ResultReader(get("a").result_path()).enhanced(2, 3).at(0);
  ASSERT_EQ(replacements.size(), 2u);
  for (const v1::EnhancedFrame& frame : replacements) {
    EXPECT_EQ(frame.fine().index(), 2u);
    ASSERT_EQ(frame.fine().positions_size(), stored.size());
    EXPECT_TRUE(std::equal(stored.data(), stored.data() + stored.size(), frame.fine().positions().begin()));
    EXPECT_GT(frame.coarse().positions_size(), 0);
  }
}

TEST_F(JobsTest, WatchersGetEveryFrameFromWhereTheyAsk) {
  start();
  fakes_.simulation().faults.delay(2ms);
  create(60, "a");
  const Topology coarse = testing::sheet();
  const Subdivision subdivision = subdivide(coarse, 2);
  const auto expect_all = [&](std::uint64_t from, std::chrono::milliseconds pause) {
    std::uint64_t next = from;
    bool opened = false;
    const grpc::Status status = watch("a", from, true, [&](const v1::JobEvent& event) {
      if (event.has_opened()) {
        opened = true;
        EXPECT_EQ(event.opened().fine().rest_positions_size(), 3 * subdivision.fine.vertex_count());
        EXPECT_EQ(event.opened().obstacles_size(), 1);
      }
      if (!event.has_frame()) return;
      EXPECT_TRUE(opened);
      ASSERT_EQ(event.frame().fine().index(), next);
      EXPECT_EQ(positions_from_message(event.frame().fine()),
                testing::fake_enhanced(subdivision, coarse.faces, testing::fake_coarse_frame(coarse, next)));
      EXPECT_EQ(event.frame().coarse().positions_size(), 60);
      EXPECT_EQ(event.frame().obstacles(0).name(), "ball");
      EXPECT_EQ(event.frame().report().penetrations_after(), next == 3 ? 1U : 0U);
      ++next;
      std::this_thread::sleep_for(pause);
    });
    EXPECT_TRUE(status.ok()) << status.error_message();
    EXPECT_EQ(next, 60U);
  };
  std::thread live([&] { expect_all(0, 0ms); });
  std::thread slow([&] { expect_all(0, 8ms); });
  std::thread late([&] { expect_all(31, 0ms); });
  finished("a");
  live.join();
  slow.join();
  late.join();
  expect_all(0, 0ms);
  stop();
  start();
  expect_all(57, 0ms);
}

TEST_F(JobsTest, ACancelledJobKeepsItsFrames) {
  start();
  fakes_.simulation().faults.delay(5ms);
  create(100'000, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 5; }));
  const v1::Job job = cancel("a");
  EXPECT_EQ(job.state(), v1::Job::STATE_CANCELLED);
  EXPECT_EQ(cancel("a").state(), v1::Job::STATE_CANCELLED);
  EXPECT_TRUE(eventually([&] {
    const auto fakes = fakes_.all();
    return std::all_of(fakes.begin(), fakes.end(), [](auto* fake) { return fake->sessions == 0; });
  }));
  const v1::Job ended = get("a");
  EXPECT_TRUE(ended.result_path().ends_with("result.h5")) << ended.result_path();
  expect_right(ended.result_path(), ended.frames_complete());
}

TEST_F(JobsTest, JobsBeyondTheLimitAreQueued) {
  options_.jobs.concurrency = 1;
  options_.jobs.max_queued = 2;
  start();
  fakes_.simulation().faults.delay(5ms);
  create(100'000, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() > 0; }));
  create(3, "b");
  EXPECT_EQ(get("b").state(), v1::Job::STATE_QUEUED);
  EXPECT_TRUE(service_->has_room());
  create(3, "c");
  EXPECT_EQ(get("b").queue_place(), 1U);
  EXPECT_EQ(get("c").queue_place(), 2U);
  EXPECT_EQ(get("a").queue_place(), 0U);
  EXPECT_FALSE(service_->has_room());
  EXPECT_NE(metrics_.text().find("pleat_queue_depth{edge=\"jobs\",service=\"coordinator\"} 2"), std::string::npos)
      << metrics_.text();
  v1::CreateJobRequest further;
  *further.mutable_scene() = testing::fake_scene(3);
  further.set_job_id("d");
  v1::Job job;
  EXPECT_EQ(create(further, &job).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(cancel("c").state(), v1::Job::STATE_CANCELLED);
  cancel("a");
  fakes_.simulation().faults.delay(0ms);
  EXPECT_EQ(finished("b").state(), v1::Job::STATE_DONE);
}

TEST_F(JobsTest, WhatWontFitOnTheDiskDoesNotBegin) {
  options_.jobs.max_frames = 2'000'000'000;
  start();
  v1::CreateJobRequest request;
  // 241 vertices a frame: more than any disk has.
  *request.mutable_scene() = testing::fake_scene(2'000'000'000);
  request.set_job_id("a");
  request.set_detail(v1::DETAIL_NETWORK);
  v1::Job job;
  const grpc::Status status = create(request, &job);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_NE(status.error_message().find("on disk"), std::string::npos) << status.error_message();
}

TEST_F(JobsTest, TheFilesOfAnOwnerAreLimited) {
  options_.jobs.max_gb_each = 1e-4;  // 100 kB; a job of 20 frames is 241 x 12 x 20 = 58 kB before it is compressed
  start();
  const std::uint64_t expected = create(20, "a").bytes();
  EXPECT_GE(expected, 241U * 12 * 20);
  finished("a");
  EXPECT_NE(get("a").bytes(), expected) << "measured, at the end";
  v1::CreateJobRequest request;
  *request.mutable_scene() = testing::fake_scene(40);
  request.set_job_id("b");
  v1::Job job;
  const grpc::Status status = create(request, &job);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_NE(status.error_message().find("the jobs of local have"), std::string::npos) << status.error_message();
}

TEST_F(JobsTest, JobsAreKeptAsLongAsWanted) {
  start();
  create(2, "old");
  finished("old");
  stop();
  start();
  EXPECT_EQ(get("old").state(), v1::Job::STATE_DONE) << "for ever, unless told otherwise";
  stop();
  options_.jobs.keep_days = 1e-9;
  start();
  EXPECT_TRUE(eventually([&] {
    grpc::ClientContext context;
    v1::ListJobsResponse response;
    return stub_->ListJobs(&context, v1::ListJobsRequest(), &response).ok() && response.jobs().empty();
  }));
  EXPECT_FALSE(std::filesystem::exists(options_.data + "/jobs/old"));
}

TEST_F(JobsTest, TwoJobsAtOnce) {
  start();
  fakes_.simulation().faults.delay(1ms);
  create(40, "a");
  create(30, "b");
  const v1::Job a = finished("a");
  const v1::Job b = finished("b");
  ASSERT_EQ(a.state(), v1::Job::STATE_DONE);
  ASSERT_EQ(b.state(), v1::Job::STATE_DONE);
  expect_right(a.result_path(), 40);
  expect_right(b.result_path(), 30);
}

TEST_F(JobsTest, ARestartedCoordinatorGoesOn) {
  start();
  fakes_.simulation().faults.hold(40);
  create(60, "a", true);
  create(2, "ended");
  finished("ended");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 20; }));
  stop();
  const int before = fakes_.simulation().frames;
  fakes_.simulation().faults.release();
  start();
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  expect_right(job.result_path(), 60, true);
  EXPECT_EQ(job.summary().penetrations(), 1U) << "counted once over both runs";
  EXPECT_LT(fakes_.simulation().frames - before, 60 + 60 - 10) << "it went on at a check-point";
  EXPECT_EQ(get("ended").state(), v1::Job::STATE_DONE);
}

TEST_F(JobsTest, AFoldedJobNeedsNoBundleAndARestartedCoordinatorGoesOn) {
  fakes_.conversion().stop();
  fakes_.superres().stop();
  start();
  fakes_.simulation().faults.hold(40);
  create(60, "a", false, v1::DETAIL_FOLD);
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 23; }));
  stop();
  const int before = fakes_.fold().frames;
  fakes_.simulation().faults.release();
  start();
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  EXPECT_EQ(job.summary().detail(), v1::DETAIL_FOLD);
  EXPECT_EQ(job.summary().model(), "");
  EXPECT_LT(fakes_.fold().frames - before, 45) << "it went on at a check-point";
  const ResultReader reader(job.result_path());
  EXPECT_EQ(reader.info().stages, (std::vector<std::string>{"fold", "refinement", "simulation", "store"}));
  EXPECT_EQ(reader.counts("fold_steps", 59, 60)[0], 7U);
  EXPECT_EQ(reader.counts("fold_restarts", 0, 2), (std::vector<std::uint32_t>{1, 0}));
  const Topology coarse = testing::sheet();
  const Subdivision subdivision = subdivide(coarse, 2);
  for (std::uint64_t i = 0; i < 60; ++i) {
    ASSERT_EQ(reader.enhanced(i, i + 1)[0],
              testing::fake_folded(subdivision, coarse.faces, testing::fake_coarse_frame(coarse, i), i + 1))
        << i;
  }
}

TEST_F(JobsTest, AFoldedJobWithoutItsCheckpointIsMadeAgainAndKeepsItsFrames) {
  start();
  fakes_.simulation().faults.hold(20);
  create(30, "a", false, v1::DETAIL_BOTH);
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 12; }));
  stop();
  std::filesystem::remove(std::filesystem::path(options_.data) / "jobs/a/checkpoint.bin");
  fakes_.simulation().faults.release();
  start();
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  const ResultReader reader(job.result_path());
  const auto restarts = reader.counts("fold_restarts", 0, 30);
  EXPECT_EQ(std::count(restarts.begin(), restarts.end(), 1U), 1);
}

TEST_F(JobsTest, ANetworkThatRemembersGoesOnAfterARestartWithTheSameBits) {
  fakes_.bundle().replace([](v1::ModelDescription& model) { model.set_state_values(1); });
  start();
  create(60, "calm");
  ASSERT_EQ(finished("calm").state(), v1::Job::STATE_DONE);
  fakes_.simulation().faults.hold(40);
  create(60, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 23; }));
  stop();
  const int before = fakes_.superres().frames;
  fakes_.simulation().faults.release();
  start();
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  EXPECT_LT(fakes_.superres().frames - before, 45) << "it went on at a check-point";

  fakes_.simulation().faults.hold(20);
  create(60, "b");
  ASSERT_TRUE(eventually([&] { return get("b").frames_complete() >= 12; }));
  stop();
  std::filesystem::remove(std::filesystem::path(options_.data) / "jobs/b/checkpoint.bin");
  fakes_.simulation().faults.release();
  start();
  ASSERT_EQ(finished("b").state(), v1::Job::STATE_DONE);

  const ResultReader calm(get("calm").result_path()), one(job.result_path()), anew(get("b").result_path());
  for (std::uint64_t i = 0; i < 60; ++i) {
    ASSERT_EQ(one.enhanced(i, i + 1)[0], calm.enhanced(i, i + 1)[0]) << i;
    ASSERT_EQ(anew.enhanced(i, i + 1)[0], calm.enhanced(i, i + 1)[0]) << i;
  }
}

TEST_F(JobsTest, WithoutDetailFramesAreUpsampledSmoothlyAndRefined) {
  fakes_.conversion().stop();
  fakes_.superres().stop();
  fakes_.fold().stop();
  start();
  create(12, "a", false, v1::DETAIL_NONE);
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  EXPECT_EQ(job.summary().detail(), v1::DETAIL_NONE);
  const ResultReader reader(job.result_path());
  EXPECT_EQ(reader.info().stages, (std::vector<std::string>{"refinement", "simulation", "store", "upsampling"}));
  const Topology coarse = testing::sheet();
  const SmoothUpsampling upsampling(coarse, subdivide(coarse, 2));
  for (std::uint64_t i = 0; i < 12; ++i) {
    Positions expected = upsampling(reader.coarse(i, i + 1)[0]);
    expected.array() += 0.001F;  // the fake refinement's
    ASSERT_EQ(reader.enhanced(i, i + 1)[0], expected) << i;
  }
}

TEST_F(JobsTest, ASimulationAloneIsJudgedAndKeptAsItIs) {
  fakes_.conversion().stop();
  fakes_.superres().stop();
  fakes_.fold().stop();
  start();
  const Topology coarse = testing::sheet();
  const Subdivision subdivision = subdivide(coarse, 2);
  for (const v1::Detail detail : {v1::DETAIL_COARSE, v1::DETAIL_TRACKED, v1::DETAIL_FREE}) {
    const std::string id(name_of(detail));
    create(8, id, false, detail);
    const v1::Job job = finished(id);
    ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
    EXPECT_EQ(job.summary().detail(), detail);
    EXPECT_EQ(job.summary().penetrations(), 1U) << "of frame 3, as the fake has them";
    const ResultReader reader(job.result_path());
    for (std::uint64_t i = 0; i < 8; ++i) {
      const Positions frame = reader.coarse(i, i + 1)[0];
      const Positions expected =
          detail == v1::DETAIL_COARSE
              ? frame
              : testing::fake_enhanced(subdivision, coarse.faces, testing::fake_coarse_frame(coarse, i));
      ASSERT_EQ(reader.enhanced(i, i + 1)[0], expected) << id << " " << i;
    }
  }
  v1::CreateJobRequest request;
  *request.mutable_scene() = testing::fake_scene(4);
  request.set_detail(v1::DETAIL_TRACKED);
  request.set_reference(true);
  v1::Job job;
  EXPECT_EQ(create(request, &job).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(JobsTest, ARestartedCoordinatorDoesNotMixBundles) {
  start();
  fakes_.simulation().faults.delay(3ms);
  create(100'000, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 20; }));
  stop();
  fakes_.bundle().replace([](v1::ModelDescription& model) { model.set_metadata_json("{}"); });
  start();
  const v1::Job job = finished("a");
  EXPECT_EQ(job.state(), v1::Job::STATE_FAILED);
  EXPECT_EQ(job.error(), "bundle fake was replaced meanwhile by one with another training; begin anew");
  EXPECT_GE(job.frames_complete(), 20U);
  expect_right(job.result_path(), job.frames_complete());
}

TEST_F(JobsTest, ADamagedNoteOfTheBundleStartsTheJobAnew) {
  start();
  fakes_.simulation().faults.hold(40);
  create(60, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 12; }));
  stop();
  const auto note = std::filesystem::path(options_.data) / "jobs/a/bundle.pb";
  ASSERT_TRUE(std::filesystem::exists(note));
  std::ofstream(note, std::ios::trunc) << "nothing";
  const int before = fakes_.simulation().frames;
  fakes_.simulation().faults.release();
  start();
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  expect_right(job.result_path(), 60);
  EXPECT_GE(fakes_.simulation().frames - before, 60) << "frames of an unknown bundle were kept";
}

TEST_F(JobsTest, AMissingServiceIsNamedWithItsAddress) {
  fakes_.refinement().stop();
  start();
  create(5, "a");
  const v1::Job job = finished("a");
  EXPECT_EQ(job.state(), v1::Job::STATE_FAILED);
  EXPECT_NE(job.error().find("refinement at " + fakes_.refinement().address()), std::string::npos) << job.error();
  fakes_.simulation().stop();
  v1::CreateJobRequest request;
  *request.mutable_scene() = testing::fake_scene(4);
  v1::Job refused;
  const grpc::Status status = create(request, &refused);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_NE(status.error_message().find("simulation at " + fakes_.simulation().address()), std::string::npos);
}

/// Files of this process can't grow beyond a size while it lives, as on a full disk.
class FullDisk {
 public:
  explicit FullDisk(std::uintmax_t size) {
    std::signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{static_cast<rlim_t>(size), before_.rlim_max};
    setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FullDisk() { setrlimit(RLIMIT_FSIZE, &before_); }
  FullDisk(const FullDisk&) = delete;
  FullDisk& operator=(const FullDisk&) = delete;

 private:
  rlimit before_{};
};

TEST_F(JobsTest, AFullDiskFailsTheJobNamesTheFileAndKeepsTheFrames) {
  start();
  fakes_.simulation().faults.hold(40);
  create(400, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 3; }));
  const auto partial = std::filesystem::path(options_.data) / "jobs/a/result.h5.partial";
  v1::Job job;
  {
    const FullDisk disk(std::filesystem::file_size(partial) / 2);
    fakes_.simulation().faults.release();
    job = finished("a");
  }
  EXPECT_EQ(job.state(), v1::Job::STATE_FAILED);
  EXPECT_NE(job.error().find("result.h5.partial"), std::string::npos) << job.error();
  EXPECT_GE(job.frames_complete(), 3U);
  EXPECT_LT(job.frames_complete(), 400U);
  expect_right(job.result_path(), job.frames_complete());
}

TEST_F(JobsTest, ADamagedPartialFileStartsTheJobAnew) {
  options_.jobs.concurrency = 1;
  start();
  fakes_.simulation().faults.hold(20);
  create(30, "a");
  ASSERT_TRUE(eventually([&] { return get("a").frames_complete() >= 12; }));
  stop();
  std::ofstream(std::filesystem::path(options_.data) / "jobs/a/result.h5.partial", std::ios::trunc) << "nothing";
  fakes_.simulation().faults.release();
  start();
  const v1::Job job = finished("a");
  ASSERT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
  expect_right(job.result_path(), 30);
  EXPECT_EQ(job.summary().penetrations(), 1U);
}

TEST_F(JobsTest, WatchersThatDoNotReadLockNobodyOut) {
  options_.max_watchers = 8;
  options_.live.reader_timeout_s = 0.3;
  start();
  create(3, "job");
  finished("job");
  // A job that nobody works on: its watchers would wait for ever.
  fakes_.refinement().faults.delay(std::chrono::milliseconds(200));
  create(500, "long");
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts;
  std::vector<std::unique_ptr<grpc::ClientReader<v1::JobEvent>>> watchers;
  v1::WatchJobRequest request;
  request.set_id("long");
  for (int i = 0; i < 8; ++i) {
    contexts.push_back(std::make_unique<grpc::ClientContext>());
    watchers.push_back(stub_->WatchJob(contexts.back().get(), request));
  }
  ASSERT_TRUE(eventually([&] { return metrics_.sessions() == 8; }));
  EXPECT_EQ(get("job").state(), v1::Job::STATE_DONE) << "unary calls have threads of their own";
  EXPECT_EQ(watch("job", 0, false).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  for (const auto& context : contexts) context->TryCancel();
  for (const auto& watcher : watchers) EXPECT_EQ(watcher->Finish().error_code(), grpc::StatusCode::CANCELLED);
  EXPECT_TRUE(eventually([&] { return watch("job", 0, false).ok(); }));
  cancel("long");
}

}  // namespace
}  // namespace pleat::coordinator
