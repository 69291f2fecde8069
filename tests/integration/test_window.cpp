// Networks that read several frames, through real processes that are killed: models/delayed.pt
// answers the oldest of three, the shipped sheet reads its vertex features.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <thread>

#include "common/mesh/subdivision.hpp"
#include "common/store/result.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "tests/integration/service_processes.hpp"

namespace pleat::testing {
namespace {

using namespace std::chrono_literals;

constexpr std::uint32_t kFrames = 24;
constexpr std::uint64_t kDelay = 2;

class KilledServices : public ::testing::Test {
 protected:
  KilledServices(const char* models, const char* model, const char* scene) : model_(model), scene_(scene) {
    const std::filesystem::path source = std::getenv("PLEAT_SOURCE_DIR");
    ::setenv("PLEAT_MODELS", (source / models).c_str(), 1);
    ::setenv("PLEAT_SUPERRES_MODEL", model, 1);  // the default one may not be in that folder
    processes_ = std::make_unique<ServiceProcesses>();
    stub_ = processes_->client();
  }

  void create(const std::string& id) {
    v1::CreateJobRequest request;
    *request.mutable_scene() = presentation::read_scene_file(scene_);
    request.set_frames(kFrames);
    request.set_model(model_);
    request.set_job_id(id);
    grpc::ClientContext context;
    v1::Job job;
    const grpc::Status status = stub_->CreateJob(&context, request, &job);
    ASSERT_TRUE(status.ok()) << status.error_message();
  }
  v1::Job get(const std::string& id) {
    grpc::ClientContext context;
    v1::GetJobRequest request;
    request.set_id(id);
    v1::Job job;
    const grpc::Status status = stub_->GetJob(&context, request, &job);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return job;
  }
  /// Waits until a job has these frames, or has ended.
  v1::Job wait(const std::string& id, std::uint32_t frames) {
    v1::Job job = get(id);
    for (int i = 0; i < 6000; ++i, job = get(id)) {
      if (job.state() >= v1::Job::STATE_DONE || job.frames_complete() >= frames) break;
      std::this_thread::sleep_for(10ms);
    }
    return job;
  }
  v1::Job finished(const std::string& id) {
    v1::Job job = get(id);
    for (int i = 0; i < 6000 && job.state() < v1::Job::STATE_DONE; ++i, job = get(id))
      std::this_thread::sleep_for(10ms);
    EXPECT_EQ(job.state(), v1::Job::STATE_DONE) << job.error();
    return job;
  }

  /// A job during which each of these services is killed. One that ended before a kill proves nothing: another one is
  /// tried.
  v1::Job stormy() {
    for (int attempt = 0; attempt < 50; ++attempt) {
      const std::string id = "stormy-" + std::to_string(attempt);
      create(id);
      bool met = true;
      std::uint32_t frames = 3;
      for (const std::string service : {"conversion", "superres", "coordinator"}) {
        wait(id, frames);
        met = met && processes_->kill_within_job(service, id);
        frames += 5;
      }
      v1::Job job = finished(id);
      if (met) return job;
    }
    ADD_FAILURE() << "no kill met a running job";
    return {};
  }

  const std::string model_, scene_;
  std::unique_ptr<ServiceProcesses> processes_;
  std::unique_ptr<v1::Coordinator::Stub> stub_;
};

class WindowTest : public KilledServices {
 protected:
  WindowTest() : KilledServices("tests/integration/models", "delayed", "deploy/scenes/draping.json") {}
};

/// A network that remembers: its last answers travel with the frames.
class VertexFeaturesTest : public KilledServices {
 protected:
  VertexFeaturesTest() : KilledServices("deploy/models", "sheet-81", "tests/integration/scenes/sheet-81.json") {}
};

double rms(const Positions& a, const Positions& b) {
  return std::sqrt((a - b).cast<double>().squaredNorm() / static_cast<double>(a.rows()));
}

TEST_F(WindowTest, KillingServicesLeavesTheSameBits) {
  create("calm");
  const v1::Job calm = finished("calm");
  const v1::Job stormy = this->stormy();
  EXPECT_EQ(stormy.summary().frame_errors(), 0U);
  const ResultReader a(calm.result_path()), b(stormy.result_path());
  const Topology& coarse = a.info().topology.coarse;
  const Subdivision subdivision = subdivide(coarse);
  ASSERT_EQ(a.frames_complete(), kFrames);
  ASSERT_EQ(b.frames_complete(), kFrames);
  for (std::uint64_t i = 0; i < kFrames; ++i) {
    const Positions enhanced = a.enhanced(i, i + 1)[0];
    ASSERT_EQ(enhanced, b.enhanced(i, i + 1)[0]) << "frame " << i;
    const std::uint64_t oldest = i < kDelay ? 0 : i - kDelay;
    const Positions delayed = upsample(subdivision, coarse.faces, a.coarse(oldest, oldest + 1)[0]);
    EXPECT_LT(rms(enhanced, delayed), 0.005) << "frame " << i;
  }
  const Positions last = upsample(subdivision, coarse.faces, a.coarse(kFrames - 1, kFrames)[0]);
  EXPECT_GT(rms(a.enhanced(kFrames - 1, kFrames)[0], last), 0.02) << "the cloth falls meanwhile";
}

TEST_F(VertexFeaturesTest, KillingServicesLeavesTheSameBits) {
  create("calm");
  const v1::Job calm = finished("calm");
  const v1::Job stormy = this->stormy();
  EXPECT_EQ(stormy.summary().frame_errors(), 0U);
  const ResultReader a(calm.result_path()), b(stormy.result_path());
  ASSERT_EQ(a.frames_complete(), kFrames);
  ASSERT_EQ(b.frames_complete(), kFrames);
  for (std::uint64_t i = 0; i < kFrames; ++i) {
    ASSERT_EQ(a.enhanced(i, i + 1)[0], b.enhanced(i, i + 1)[0]) << "frame " << i;
  }
}

}  // namespace
}  // namespace pleat::testing
