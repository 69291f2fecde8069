#include "common/client/client.hpp"

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

namespace pleat {
namespace {

using namespace std::chrono_literals;

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
  grpc::Status GetJob(grpc::ServerContext*, const v1::GetJobRequest* request, v1::Job* job) override {
    return rpc::guard([&] { *job = find(request->id()); });
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
      for (std::uint64_t k = request->from_index(); k < 5; ++k) {
        v1::JobEvent event;
        event.mutable_frame()->mutable_fine()->set_index(k);
        if (!writer->Write(event)) return;
      }
    });
  }
  grpc::Status Enhance(grpc::ServerContext* context,
                       grpc::ServerReaderWriter<v1::EnhanceResponse, v1::EnhanceRequest>* stream) override {
    return rpc::serve_frames(context, stream, {}, [](const v1::EnhanceOpen& open, v1::EnhanceOpened* opened) {
      const Topology coarse = from_message(open.coarse(), "open.coarse");
      const Subdivision subdivision = subdivide(coarse, static_cast<int>(open.subdivision_rounds()));
      *opened->mutable_fine() = to_message(subdivision.fine);
      opened->set_window(open.window());
      return [coarse, subdivision](const v1::EnhanceFrame& frame, v1::EnhancedFrame* enhanced) {
        Frame fine = from_message(frame.coarse(), coarse.vertex_count(), "coarse");
        fine.positions = upsample(subdivision, coarse.faces, fine.positions);
        to_message(fine, enhanced->mutable_fine());
      };
    });
  }

  std::atomic<int> failures_ = 0;
  std::map<std::string, v1::Job> jobs_;

 private:
  v1::Job& find(const std::string& id) {
    const auto found = jobs_.find(id);
    if (found == jobs_.end()) throw_not_found("no job " + id);
    return found->second;
  }
  std::mutex mutex_;
};

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
  std::vector<std::uint64_t> indices;
  EXPECT_TRUE(client->watch_job(job.id(), 2, true, [&](const v1::JobEvent& event) {
    indices.push_back(event.frame().fine().index());
    return true;
  }));
  EXPECT_EQ(indices, (std::vector<std::uint64_t>{2, 3, 4}));
  EXPECT_FALSE(client->watch_job(job.id(), 0, true, [](const v1::JobEvent&) { return false; }));
  EXPECT_EQ(client->cancel_job(job.id()).state(), v1::Job::STATE_CANCELLED);
}

TEST_F(ClientTest, ErrorsNameTheCoordinator) {
  EXPECT_EQ(code_of([&] { client->get_job("x"); }, server->address() + ": no job x"), ErrorCode::kNotFound);
  EXPECT_EQ(code_of([&] { client->create_job({}); }, "scene.name"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { client->watch_job("x", 0, false, [](const auto&) { return true; }); }, "no job x"),
            ErrorCode::kNotFound);
  coordinator.failures_ = 3;
  EXPECT_EQ(code_of([&] { client->create_job({}); }, "not now"), ErrorCode::kUnavailable);
  const std::string address = server->address();
  server->stop();
  EXPECT_EQ(code_of([&] { client->get_job("x"); }, address), ErrorCode::kUnavailable);
  EXPECT_EQ(code_of([&] { client->wait_ready(100ms); }, address), ErrorCode::kUnavailable);
}

TEST_F(ClientTest, EnhanceAsPushAndPop) {
  EnhanceOptions options;
  options.coarse = triangle();
  EnhanceSession session = client->enhance(options);
  const Subdivision expected = subdivide(triangle());
  EXPECT_EQ(topology_hash(session.fine()), topology_hash(expected.fine));
  constexpr std::uint64_t kFrames = 30;
  std::thread producer([&] {
    Frame frame;
    for (std::uint64_t k = 0; k < kFrames; ++k) {
      frame.index = k;
      frame.positions = triangle().rest_positions * static_cast<float>(k + 1);
      if (k == 7) frame.positions.conservativeResize(2, 3);
      session.push(frame);
    }
    session.close();
  });
  std::uint64_t next = 0;
  while (const auto result = session.pop()) {
    EXPECT_EQ(result->index, next);
    if (next == 7) {
      ASSERT_TRUE(result->error.has_value());
      EXPECT_EQ(result->error->code(), ErrorCode::kInvalidArgument);
    } else {
      EXPECT_FALSE(result->error.has_value());
      EXPECT_EQ(result->fine.positions, expected.fine.rest_positions * static_cast<float>(next + 1));
    }
    ++next;
  }
  producer.join();
  EXPECT_EQ(next, kFrames);
}

TEST_F(ClientTest, EnhanceErrors) {
  EnhanceOptions options;
  options.coarse = triangle();
  options.coarse.faces(0, 0) = 9;
  EXPECT_EQ(code_of([&] { client->enhance(options); }, "open.coarse"), ErrorCode::kInvalidArgument);
  options.coarse = triangle();
  options.window = 1;
  EnhanceSession session = client->enhance(options);
  Frame frame;
  frame.positions = triangle().rest_positions;
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
}  // namespace pleat
