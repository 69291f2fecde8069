// Who may do what over the wire, by tokens.
#include "services/coordinator/service.hpp"

#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "common/frame/messages.hpp"
#include "common/telemetry/log.hpp"
#include "spdlog/sinks/ostream_sink.h"
#include "tests/unit/services/coordinator/coordinator_fixture.hpp"

namespace pleat::coordinator {
namespace {

using grpc::StatusCode;
namespace fs = std::filesystem;

class OwnersTest : public CoordinatorTest {
 protected:
  OwnersTest() : log_sink_(std::make_shared<spdlog::sinks::ostream_sink_mt>(log_)), before_(spdlog::default_logger()) {
    write_tokens(
        "alice user aaaaaaaaaaaaaaaa\nbob user bbbbbbbbbbbbbbbb\n"
        "dashboard watcher dddddddddddddddd\nroot admin rrrrrrrrrrrrrrrr\n");
    options_.token_file = token_file().string();
    auto logger = std::make_shared<spdlog::logger>("coordinator", log_sink_);
    logger->set_level(spdlog::level::off);
    spdlog::set_default_logger(logger);
  }
  ~OwnersTest() override {
    stop();
    spdlog::set_default_logger(before_);
  }

  fs::path token_file() { return fakes_.folder() / "tokens"; }
  void write_tokens(const std::string& text) {
    std::ofstream(token_file()) << text;
    ::chmod(token_file().c_str(), 0600);
  }

  /// name: whose token has 16 times its first letter.
  static void sign(grpc::ClientContext& context, const std::string& name) {
    if (!name.empty()) context.AddMetadata("authorization", "Bearer " + std::string(16, name[0]));
  }
  StatusCode create_as(const std::string& name, const std::string& id, std::uint32_t frames = 2) {
    grpc::ClientContext context;
    sign(context, name);
    v1::CreateJobRequest request;
    *request.mutable_scene() = testing::fake_scene(frames);
    request.set_job_id(id);
    request.set_detail(v1::DETAIL_NETWORK);
    v1::Job job;
    const grpc::Status status = stub_->CreateJob(&context, request, &job);
    EXPECT_TRUE(!status.ok() || job.owner() == name) << job.owner();
    message_ = status.error_message();
    return status.error_code();
  }
  template <typename Request, typename Call>
  StatusCode unary(const std::string& name, const std::string& id, Call call) {
    grpc::ClientContext context;
    sign(context, name);
    Request request;
    request.set_id(id);
    const grpc::Status status = (stub_.get()->*call)(&context, request, &job_);
    message_ = status.error_message();
    return status.error_code();
  }
  StatusCode get_as(const std::string& name, const std::string& id) {
    return unary<v1::GetJobRequest>(name, id, &v1::Coordinator::Stub::GetJob);
  }
  StatusCode cancel_as(const std::string& name, const std::string& id) {
    return unary<v1::CancelJobRequest>(name, id, &v1::Coordinator::Stub::CancelJob);
  }
  StatusCode remove_as(const std::string& name, const std::string& id) {
    return unary<v1::RemoveJobRequest>(name, id, &v1::Coordinator::Stub::RemoveJob);
  }
  StatusCode watch_as(const std::string& name, const std::string& id) {
    grpc::ClientContext context;
    sign(context, name);
    v1::WatchJobRequest request;
    request.set_id(id);
    const auto reader = stub_->WatchJob(&context, request);
    v1::JobEvent event;
    while (reader->Read(&event)) {
    }
    return reader->Finish().error_code();
  }
  StatusCode enhance_as(const std::string& name) {
    grpc::ClientContext context;
    sign(context, name);
    const auto stream = stub_->Enhance(&context);
    v1::EnhanceRequest request;
    *request.mutable_open()->mutable_coarse() = to_message(testing::sheet());
    request.mutable_open()->set_detail(v1::DETAIL_NETWORK);
    stream->Write(request);
    stream->WritesDone();
    v1::EnhanceResponse response;
    while (stream->Read(&response)) {
    }
    return stream->Finish().error_code();
  }
  std::set<std::string> listed_by(const std::string& name, bool live_sessions = false) {
    grpc::ClientContext context;
    sign(context, name);
    v1::ListJobsRequest request;
    request.set_live_sessions(live_sessions);
    v1::ListJobsResponse response;
    EXPECT_TRUE(stub_->ListJobs(&context, request, &response).ok());
    std::set<std::string> ids;
    for (const v1::Job& job : response.jobs()) ids.insert(job.id());
    return ids;
  }
  std::size_t audited(const std::string& text) {
    std::size_t count = 0;
    const std::string log = log_.str();
    for (std::size_t at = 0; (at = log.find(text, at)) != std::string::npos; ++at) ++count;
    return count;
  }

  std::ostringstream log_;
  std::shared_ptr<spdlog::sinks::ostream_sink_mt> log_sink_;
  std::shared_ptr<spdlog::logger> before_;
  v1::Job job_;
  std::string message_;
};

TEST_F(OwnersTest, NobodyWithoutAKnownToken) {
  start();
  EXPECT_EQ(create_as("", "a"), StatusCode::UNAUTHENTICATED);
  EXPECT_NE(message_.find("--token-file"), std::string::npos) << message_;
  EXPECT_EQ(create_as("x", "a"), StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(enhance_as(""), StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(watch_as("", "a"), StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(get_as("", "a"), StatusCode::UNAUTHENTICATED) << "whether there is such a job is not told either";
}

TEST_F(OwnersTest, OneSeesOnesOwnJobs) {
  start();
  ASSERT_EQ(create_as("alice", "a"), StatusCode::OK);
  ASSERT_EQ(create_as("bob", "b"), StatusCode::OK);
  EXPECT_EQ(listed_by("alice"), (std::set<std::string>{"a"}));
  EXPECT_EQ(listed_by("bob"), (std::set<std::string>{"b"}));
  EXPECT_EQ(listed_by("dashboard"), (std::set<std::string>{"a", "b"}));
  EXPECT_EQ(listed_by("root"), (std::set<std::string>{"a", "b"}));
  EXPECT_EQ(watch_as("alice", "a"), StatusCode::OK);
  EXPECT_EQ(get_as("bob", "a"), StatusCode::NOT_FOUND);
  EXPECT_EQ(watch_as("bob", "a"), StatusCode::NOT_FOUND);
  EXPECT_EQ(cancel_as("bob", "a"), StatusCode::NOT_FOUND);
  EXPECT_EQ(remove_as("bob", "a"), StatusCode::NOT_FOUND);
  EXPECT_EQ(create_as("bob", "a"), StatusCode::ALREADY_EXISTS) << "the same request makes it no job of bob's";
  EXPECT_EQ(get_as("alice", "a"), StatusCode::OK);
}

TEST_F(OwnersTest, SessionsOfOthersAreNotSeen) {
  start();
  grpc::ClientContext context;
  sign(context, "alice");
  const auto stream = stub_->Enhance(&context);
  v1::EnhanceRequest request;
  *request.mutable_open()->mutable_coarse() = to_message(testing::sheet());
  request.mutable_open()->set_detail(v1::DETAIL_NETWORK);
  v1::EnhanceResponse response;
  ASSERT_TRUE(stream->Write(request) && stream->Read(&response));
  const std::set<std::string> ids = listed_by("alice", true);
  ASSERT_EQ(ids.size(), 1U);
  EXPECT_EQ(listed_by("bob", true).size(), 0U);
  EXPECT_EQ(listed_by("dashboard", true), ids);
  EXPECT_EQ(get_as("bob", *ids.begin()), StatusCode::NOT_FOUND);
  EXPECT_EQ(watch_as("bob", *ids.begin()), StatusCode::NOT_FOUND);
  EXPECT_EQ(get_as("dashboard", *ids.begin()), StatusCode::OK);
  EXPECT_EQ(cancel_as("alice", *ids.begin()), StatusCode::NOT_FOUND) << "its client ends it";
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());
}

TEST_F(OwnersTest, AWatcherReadsAndChangesNothing) {
  start();
  ASSERT_EQ(create_as("alice", "a"), StatusCode::OK);
  EXPECT_EQ(watch_as("dashboard", "a"), StatusCode::OK);
  EXPECT_EQ(create_as("dashboard", "w"), StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(cancel_as("dashboard", "a"), StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(remove_as("dashboard", "a"), StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(enhance_as("dashboard"), StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(enhance_as("alice"), StatusCode::OK);
}

TEST_F(OwnersTest, WhatIsDoneIsInTheLogWhateverItsLevel) {
  start();
  ASSERT_EQ(create_as("alice", "a"), StatusCode::OK);
  EXPECT_EQ(watch_as("alice", "a"), StatusCode::OK);
  EXPECT_EQ(audited("audit: job a of alice created"), 1U);
  EXPECT_EQ(audited("read by"), 0U) << "by its owner";
  EXPECT_EQ(watch_as("root", "a"), StatusCode::OK);
  EXPECT_EQ(audited("audit: job a of alice read by root (admin) at unix"), 1U);
  EXPECT_EQ(cancel_as("root", "a"), StatusCode::OK);
  EXPECT_EQ(audited("audit: job a of alice cancelled by root (admin) at unix"), 1U);
  EXPECT_EQ(remove_as("root", "a"), StatusCode::OK);
  EXPECT_EQ(audited("audit: job a of alice removed by root (admin) at unix"), 1U);
}

TEST_F(OwnersTest, ARemovedJobIsGoneWithItsFiles) {
  start();
  ASSERT_EQ(create_as("alice", "a"), StatusCode::OK);
  ASSERT_EQ(watch_as("alice", "a"), StatusCode::OK);
  ASSERT_EQ(get_as("alice", "a"), StatusCode::OK);
  const fs::path folder = fs::path(job_.result_path()).parent_path();
  ASSERT_TRUE(fs::exists(folder / "result.h5"));
  EXPECT_GT(job_.ended_s(), job_.created_s());
  EXPECT_GE(job_.bytes(), fs::file_size(folder / "result.h5"));
  EXPECT_EQ(remove_as("alice", "a"), StatusCode::OK);
  EXPECT_EQ(job_.state(), v1::Job::STATE_DONE) << "as it was";
  EXPECT_FALSE(fs::exists(folder));
  EXPECT_EQ(get_as("alice", "a"), StatusCode::NOT_FOUND);
  EXPECT_EQ(create_as("bob", "a"), StatusCode::OK) << "its id is free";
}

TEST_F(OwnersTest, ATokenCanBeTakenBackWithoutARestart) {
  start();
  ASSERT_EQ(create_as("alice", "a"), StatusCode::OK);
  write_tokens("bob user bbbbbbbbbbbbbbbb\n");
  EXPECT_EQ(get_as("alice", "a"), StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(create_as("bob", "b"), StatusCode::OK);
}

TEST_F(OwnersTest, EachOwnerHasTheirOwnLimits) {
  options_.jobs.max_jobs_each = 1;
  options_.live.max_sessions_each = 1;
  fakes_.simulation().faults.hold(3);
  start();
  ASSERT_EQ(create_as("alice", "a", 500), StatusCode::OK);
  EXPECT_EQ(create_as("alice", "a2"), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_NE(message_.find("alice has 1 jobs"), std::string::npos) << message_;
  EXPECT_EQ(create_as("alice", "a", 500), StatusCode::OK) << "the one that is there, asked for again";
  EXPECT_EQ(create_as("bob", "b"), StatusCode::OK);
  EXPECT_EQ(cancel_as("alice", "a"), StatusCode::OK);
  EXPECT_EQ(create_as("alice", "a2"), StatusCode::OK);
}

}  // namespace
}  // namespace pleat::coordinator
