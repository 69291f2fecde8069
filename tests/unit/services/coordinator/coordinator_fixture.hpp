// A coordinator service over fake stages, with a client.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "common/rpc/channel.hpp"
#include "common/telemetry/metrics.hpp"
#include "services/coordinator/service.hpp"
#include "tests/support/fake_coordinator.hpp"

namespace pleat::coordinator {

class CoordinatorTest : public ::testing::Test {
 protected:
  CoordinatorTest() {
    options_.give_up_s = 1.5;
    options_.answer_timeout_s = 0.5;
    options_.jobs.checkpoint_interval = 5;
  }
  ~CoordinatorTest() override { stop(); }

  void start() {
    service_ = std::make_unique<CoordinatorService>(options_, &metrics_);
    const std::string address = "unix:" + (fakes_.folder() / "coordinator").string();
    grpc::ServerBuilder builder;
    builder.AddListeningPort(address, grpc::InsecureServerCredentials());
    builder.SetMaxReceiveMessageSize(rpc::kMaxMessageBytes);
    builder.RegisterService(service_.get());
    server_ = builder.BuildAndStart();
    ASSERT_NE(server_, nullptr);
    channel_ = rpc::create_channel(address);
    stub_ = v1::Coordinator::NewStub(channel_);
  }

  /// As the server runner does at a signal.
  void stop() {
    if (!service_) return;
    service_->drain();
    server_->Shutdown(std::chrono::system_clock::now() + std::chrono::seconds(5));
    server_.reset();
    service_.reset();
  }

  grpc::Status create(const v1::CreateJobRequest& request, v1::Job* job) {
    grpc::ClientContext context;
    return stub_->CreateJob(&context, request, job);
  }
  v1::Job create(std::uint32_t frames, const std::string& id, bool reference = false,
                 v1::Detail detail = v1::DETAIL_NETWORK) {
    v1::CreateJobRequest request;
    *request.mutable_scene() = testing::fake_scene(frames);
    request.set_job_id(id);
    request.set_reference(reference);
    request.set_detail(detail);
    v1::Job job;
    const grpc::Status status = create(request, &job);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return job;
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
  v1::Job cancel(const std::string& id) {
    grpc::ClientContext context;
    v1::CancelJobRequest request;
    request.set_id(id);
    v1::Job job;
    const grpc::Status status = stub_->CancelJob(&context, request, &job);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return job;
  }
  /// Watches to the end; every event goes to `see`.
  grpc::Status watch(
      const std::string& id, std::uint64_t from, bool frames,
      const std::function<void(const v1::JobEvent&)>& see = [](const v1::JobEvent&) {}) {
    grpc::ClientContext context;
    v1::WatchJobRequest request;
    request.set_id(id);
    request.set_from_index(from);
    request.set_include_frames(frames);
    const auto reader = stub_->WatchJob(&context, request);
    v1::JobEvent event;
    while (reader->Read(&event)) see(event);
    return reader->Finish();
  }
  /// Waits until it ends.
  v1::Job finished(const std::string& id) {
    EXPECT_TRUE(watch(id, 0, false).ok());
    return get(id);
  }
  /// Waits (at most 10 s) for what another thread or process does.
  static bool eventually(const std::function<bool()>& condition) {
    for (int i = 0; i < 2000; ++i) {
      if (condition()) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }

  testing::FakeStages fakes_;
  telemetry::Metrics metrics_{"coordinator"};
  CoordinatorOptions options_ = testing::coordinator_options(fakes_);
  std::unique_ptr<CoordinatorService> service_;
  std::unique_ptr<grpc::Server> server_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::Coordinator::Stub> stub_;
};

}  // namespace pleat::coordinator
