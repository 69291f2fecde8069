#include "common/client/cpp/client.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <map>
#include <mutex>
#include <thread>

#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/rpc/server.hpp"
#include "common/rpc/stream.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"

namespace pleat::client {
namespace {

using namespace std::chrono_literals;

Topology triangle() {
  Topology topology;
  topology.rest_positions.resize(3, 3);
  topology.rest_positions << 0, 0, 0, 1, 0, 0, 0, 1, 0;
  topology.faces.resize(1, 3);
  topology.faces << 0, 1, 2;
  topology.uv = topology.rest_positions.leftCols(2);
  topology.uv_faces = topology.faces;
  return topology;
}

Mesh triangle_mesh() {
  const Topology mesh = triangle();
  return {{mesh.rest_positions.data(), mesh.rest_positions.data() + 9},
          {0, 1, 2},
          {mesh.uv.data(), mesh.uv.data() + 6},
          {0, 1, 2}};
}

std::vector<float> scaled(std::vector<float> values, float factor) {
  for (float& value : values) value *= factor;
  return values;
}

/// A coordinator whose enhancement is upsampling, and whose jobs are names.
class FakeCoordinator final : public v1::Coordinator::Service {
 public:
  grpc::Status CreateJob(grpc::ServerContext*, const v1::CreateJobRequest* request, v1::Job* job) override {
    return rpc::guard([&] {
      if (failures_ > 0) {
        --failures_;
        throw Error(ErrorCode::kUnavailable, "not now");
      }
      if (request->scene().name().empty()) throw_invalid_argument("scene.name: empty");
      const std::lock_guard lock(mutex_);
      v1::Job& made = jobs_[request->job_id()];
      made.set_id(request->job_id());
      made.set_scene_name(request->scene().name());
      made.set_state(v1::Job::STATE_RUNNING);
      *job = made;
    });
  }
  grpc::Status CreateJobInParts(grpc::ServerContext* context, grpc::ServerReader<v1::CreateJobPart>* reader,
                                v1::Job* job) override {
    v1::CreateJobPart part;
    reader->Read(&part);
    const v1::CreateJobRequest request = part.request();
    parts_ = 0;
    while (reader->Read(&part)) ++parts_;
    return CreateJob(context, &request, job);
  }
  grpc::Status GetJob(grpc::ServerContext* context, const v1::GetJobRequest* request, v1::Job* job) override {
    return rpc::guard([&] {
      *job = find(request->id());
      job->set_trace_id(rpc::trace_of(*context).trace_id);
    });
  }
  grpc::Status CancelJob(grpc::ServerContext*, const v1::CancelJobRequest* request, v1::Job* job) override {
    return rpc::guard([&] {
      find(request->id()).set_state(v1::Job::STATE_CANCELLED);
      *job = find(request->id());
    });
  }
  grpc::Status ListJobs(grpc::ServerContext*, const v1::ListJobsRequest*, v1::ListJobsResponse* response) override {
    for (const auto& [id, job] : jobs_) *response->add_jobs() = job;
    return grpc::Status::OK;
  }
  grpc::Status WatchJob(grpc::ServerContext*, const v1::WatchJobRequest* request,
                        grpc::ServerWriter<v1::JobEvent>* writer) override {
    return rpc::guard([&] {
      find(request->id());
      v1::JobEvent opened;
      *opened.mutable_opened()->mutable_fine() = pleat::to_message(triangle());
      *opened.mutable_opened()->mutable_coarse() = pleat::to_message(triangle());
      writer->Write(opened);
      for (std::uint64_t k = request->from_index(); k < 5; ++k) {
        if (k == 3 && breaks_ > 0) {
          --breaks_;
          throw Error(ErrorCode::kUnavailable, "going away");
        }
        v1::JobEvent event;
        v1::EnhancedFrame* frame = k == 2 ? event.mutable_replacement() : event.mutable_frame();
        if (k == 2) {
          event.mutable_error()->set_index(k);
          event.mutable_error()->set_code(grpc::StatusCode::DEADLINE_EXCEEDED);
          event.mutable_error()->set_message("too slow");
        }
        frame->mutable_fine()->set_index(k);
        for (int i = 0; i < 9; ++i) frame->mutable_fine()->add_positions(static_cast<float>(k));
        if (!writer->Write(event)) return;
      }
      v1::JobEvent last;
      *last.mutable_progress() = find(request->id());
      last.mutable_progress()->set_state(v1::Job::STATE_DONE);
      writer->Write(last);
    });
  }
  grpc::Status Enhance(grpc::ServerContext* context,
                       grpc::ServerReaderWriter<v1::EnhanceResponse, v1::EnhanceRequest>* stream) override {
    return rpc::serve_frames(context, stream, {}, [](const v1::EnhanceOpen& open, v1::EnhanceOpened* opened) {
      const Topology coarse = pleat::from_message(open.coarse(), "open.coarse");
      const Subdivision subdivision =
          subdivide(coarse, open.has_subdivision_rounds() ? static_cast<int>(open.subdivision_rounds()) : 2);
      *opened->mutable_fine() = pleat::to_message(subdivision.fine);
      opened->set_window(open.window());
      return [coarse, subdivision](const v1::EnhanceFrame& frame, v1::EnhancedFrame* enhanced) {
        pleat::Frame fine = pleat::from_message(frame.coarse(), coarse.vertex_count(), "coarse");
        fine.positions = upsample(subdivision, coarse.faces, fine.positions);
        pleat::to_message(fine, enhanced->mutable_fine());
      };
    });
  }

  std::atomic<int> failures_ = 0, breaks_ = 0, parts_ = 0;
  std::map<std::string, v1::Job> jobs_;

 private:
  v1::Job& find(const std::string& id) {
    const auto found = jobs_.find(id);
    if (found == jobs_.end()) throw_not_found("no job " + id);
    return found->second;
  }
  std::mutex mutex_;
};

class ClientTest : public ::testing::Test {
 protected:
  ClientTest() {
    rpc::ServerOptions options;
    options.listen = "unix:/tmp/pleat-test-client-" + std::to_string(getpid()) + ".sock";
    options.drain_s = 0.2;
    server =
        std::make_unique<rpc::Server>(options, std::vector<rpc::HostedService>{{&coordinator, "pleat.v1.Coordinator"}});
    client = std::make_unique<Client>(server->address());
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

  FakeCoordinator coordinator;
  std::unique_ptr<rpc::Server> server;
  std::unique_ptr<Client> client;
};

TEST_F(ClientTest, Jobs) {
  client->wait_ready(5s);
  v1::CreateJobRequest request;
  request.mutable_scene()->set_name("draping");
  coordinator.failures_ = 2;
  const v1::Job job = client->create_job(request);
  EXPECT_FALSE(job.id().empty()) << "an id is chosen, so that repeating makes no second job";
  EXPECT_EQ(client->get_job(job.id()).scene_name(), "draping");
  EXPECT_EQ(client->list_jobs().size(), 1u);
  EXPECT_EQ(client->cancel_job(job.id()).state(), v1::Job::STATE_CANCELLED);
}

TEST_F(ClientTest, CallsCarryTheTraceThatItIsGiven) {
  const std::string id = "4bf92f3577b34da6a3ce929d0e0e4736";
  coordinator.jobs_["a"].set_id("a");
  const Client traced(server->address(), {}, "00-" + id + "-00f067aa0ba902b7-01");
  EXPECT_EQ(traced.get_job("a").trace_id(), id);
  EXPECT_NE(client->get_job("a").trace_id(), id);
  EXPECT_EQ(code_of([&] { Client(server->address(), {}, "00-" + id); }, "traceparent '00-4bf92"),
            ErrorCode::kInvalidArgument);
}

TEST_F(ClientTest, LongAnimationsGoInParts) {
  v1::CreateJobRequest request;
  request.mutable_scene()->set_name("walk");
  v1::Obstacle& ball = *request.mutable_scene()->add_obstacles();
  ball.set_name("ball");
  ball.mutable_sphere()->set_radius(1);
  ball.mutable_animation()->mutable_positions()->Resize(3 * 1'500'000, 0);  // 17 MiB
  coordinator.failures_ = 1;
  EXPECT_EQ(client->create_job(request).scene_name(), "walk");
  EXPECT_EQ(coordinator.parts_, 5);
}

TEST_F(ClientTest, WatchingAJobGoesOnAfterALostConnectionAndAFailedFrame) {
  v1::CreateJobRequest request;
  request.mutable_scene()->set_name("draping");
  const v1::Job job = client->create_job(request);
  coordinator.breaks_ = 2;
  std::vector<EnhancedFrame> frames;
  std::size_t fine_vertices = 0;
  const JobWatcher watcher =
      client->watch_job(job.id(),
                        {.opened = [&](const JobMeshes& meshes) { fine_vertices = meshes.fine.vertex_count(); },
                         .frame = [&](const EnhancedFrame& frame) { frames.push_back(frame); }},
                        {.from_index = 1});
  JobProgress progress;
  for (int i = 0; i < 300 && !progress.over; ++i) progress = watcher.wait(100ms);
  ASSERT_TRUE(progress.over);
  EXPECT_EQ(state_name(progress.job.state()), "done");
  EXPECT_EQ(fine_vertices, 3u);
  ASSERT_EQ(frames.size(), 4u) << "frames 1 to 4, each once";
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(frames[i].index, i + 1);
    EXPECT_EQ(frames[i].positions, std::vector<float>(9, static_cast<float>(i + 1)));
    EXPECT_EQ(frames[i].error.has_value(), i == 1);
  }
  EXPECT_EQ(frames[1].error->code(), ErrorCode::kDeadlineExceeded);
  EXPECT_STREQ(frames[1].error->what(), "frame 2: too slow");
}

TEST_F(ClientTest, AnErrorOfASinkEndsTheWatching) {
  v1::CreateJobRequest request;
  request.mutable_scene()->set_name("draping");
  const v1::Job job = client->create_job(request);
  const JobWatcher watcher =
      client->watch_job(job.id(), {.opened = {}, .frame = [](const EnhancedFrame&) { throw_data_loss("disk"); }});
  EXPECT_EQ(code_of(
                [&] {
                  while (!watcher.wait(100ms).over) continue;
                },
                "disk"),
            ErrorCode::kDataLoss);
}

TEST_F(ClientTest, ErrorsNameTheCoordinator) {
  EXPECT_EQ(code_of([&] { client->get_job("x"); }, server->address() + ": no job x"), ErrorCode::kNotFound);
  EXPECT_EQ(code_of([&] { client->create_job({}); }, "scene.name"), ErrorCode::kInvalidArgument);
  const JobWatcher watcher = client->watch_job("x");
  EXPECT_EQ(code_of(
                [&] {
                  while (!watcher.wait(100ms).over) continue;
                },
                "no job x"),
            ErrorCode::kNotFound);
  coordinator.failures_ = 3;
  EXPECT_EQ(code_of([&] { client->create_job({}); }, "not now"), ErrorCode::kUnavailable);
  const std::string address = server->address();
  server->stop();
  EXPECT_EQ(code_of([&] { client->get_job("x"); }, address), ErrorCode::kUnavailable);
  EXPECT_EQ(code_of([&] { client->wait_ready(100ms); }, address), ErrorCode::kUnavailable);
}

TEST_F(ClientTest, EnhanceAsPushAndPop) {
  EnhanceSession session = client->enhance({.coarse = triangle_mesh(), .subdivision_rounds = 2});
  const Subdivision expected = subdivide(triangle());
  const std::vector<float> fine(expected.fine.rest_positions.data(),
                                expected.fine.rest_positions.data() + expected.fine.rest_positions.size());
  EXPECT_EQ(session.info().fine.positions, fine);
  EXPECT_EQ(session.info().fine.faces.size(), 3u * 16);
  constexpr std::uint64_t kFrames = 30;
  std::thread producer([&] {
    CoarseFrame frame;
    for (std::uint64_t k = 0; k < kFrames; ++k) {
      frame.index = k;
      frame.positions = scaled(triangle_mesh().positions, static_cast<float>(k + 1));
      if (k == 7) frame.positions.resize(6);
      session.push(frame);
    }
    session.close();
  });
  std::uint64_t next = 0;
  while (const auto answer = session.pop()) {
    EXPECT_EQ(answer->index, next);
    if (next == 7) {
      ASSERT_TRUE(answer->error.has_value());
      EXPECT_EQ(answer->error->code(), ErrorCode::kInvalidArgument);
      EXPECT_TRUE(answer->positions.empty());
    } else {
      EXPECT_FALSE(answer->error.has_value());
      EXPECT_EQ(answer->positions, scaled(fine, static_cast<float>(next + 1)));
    }
    ++next;
  }
  producer.join();
  EXPECT_EQ(next, kFrames);
}

TEST_F(ClientTest, EnhanceInOneThreadGivesEveryAnswerWithItsInput) {
  EnhanceSession session = client->enhance({.coarse = triangle_mesh(), .window = 3});
  std::uint64_t next = 0;
  session.run(
      20,
      [](std::uint64_t k) {
        CoarseFrame frame;
        frame.index = k;
        frame.positions = scaled(triangle_mesh().positions, static_cast<float>(k + 1));
        if (k == 5) frame.positions.clear();
        return frame;
      },
      [&](const EnhancedFrame& answer, const CoarseFrame& input) {
        EXPECT_EQ(answer.index, next);
        EXPECT_EQ(input.index, next);
        EXPECT_EQ(answer.error.has_value(), next == 5) << "a failed frame does not end the session";
        ++next;
      });
  EXPECT_EQ(next, 20u);
}

TEST_F(ClientTest, EnhanceErrors) {
  EnhanceOptions options;
  options.coarse = triangle_mesh();
  options.coarse.faces[0] = 9;
  EXPECT_EQ(code_of([&] { client->enhance(options); }, "open.coarse"), ErrorCode::kInvalidArgument);
  options.coarse = triangle_mesh();
  options.window = 1;
  EnhanceSession session = client->enhance(options);
  CoarseFrame frame;
  frame.positions = triangle_mesh().positions;
  EXPECT_TRUE(session.try_push(frame));
  EXPECT_FALSE(session.try_push(frame));
  session.cancel();
  EXPECT_EQ(code_of(
                [&] {
                  while (session.pop()) {
                  }
                },
                "cancelled"),
            ErrorCode::kCancelled);
}

}  // namespace
}  // namespace pleat::client
