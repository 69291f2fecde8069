#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <thread>

#include "common/base/error.hpp"
#include "services/coordinator/job_table.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::coordinator {
namespace {

namespace fs = std::filesystem;

class JobTableTest : public ::testing::Test {
 protected:
  static JobRequest request(const std::string& id = "") {
    return {.id = id, .scene_name = "draping", .frames = 10, .reference = false, .model = "", .request = "bytes\0more"};
  }

  const test::TemporaryFolder temporary_;
  const fs::path data_ = temporary_.path();
};

void expect_code(ErrorCode code, const std::function<void()>& action) {
  try {
    action();
    ADD_FAILURE() << "nothing was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), code) << e.what();
  }
}

TEST_F(JobTableTest, ARetriedRequestMakesOneJob) {
  JobTable table(data_);
  const auto [first, made] = table.create(request("a"));
  const auto [again, made_again] = table.create(request("a"));
  EXPECT_TRUE(made);
  EXPECT_FALSE(made_again);
  EXPECT_EQ(first, again);
  JobRequest other = request("a");
  other.request = "different";
  expect_code(ErrorCode::kAlreadyExists, [&] { table.create(other); });
  expect_code(ErrorCode::kInvalidArgument, [&] { table.create(request("../a")); });
}

TEST_F(JobTableTest, AFolderHasOneCoordinator) {
  {
    JobTable table(data_);
    expect_code(ErrorCode::kUnavailable, [&] { JobTable second(data_); });
    EXPECT_NO_THROW(table.create(request("a"))) << "the first one goes on";
  }
  EXPECT_TRUE(JobTable(data_).contains("a"));
}

TEST_F(JobTableTest, ChosenIdsDiffer) {
  JobTable table(data_);
  const std::string first = table.create(request()).first.id;
  EXPECT_NE(first, table.create(request()).first.id);
  EXPECT_TRUE(first.starts_with("draping-")) << first;
}

TEST_F(JobTableTest, ListsNewestFirstAndUnfinishedOldestFirst) {
  JobTable table(data_);
  for (const char* id : {"a", "b", "c"}) table.create(request(id));
  table.update("b", [](JobRecord& job) { job.state = JobState::kCancelled; });
  std::string all, unfinished;
  for (const auto& job : table.list()) all += job.id;
  for (const auto& job : table.unfinished()) unfinished += job.id;
  EXPECT_EQ(all, "cba");
  EXPECT_EQ(unfinished, "ac");
}

TEST_F(JobTableTest, ANewTableKnowsTheJobsOfTheOld) {
  {
    JobTable table(data_);
    table.create(request("a"));
    table.update("a", [](JobRecord& job) { job.state = JobState::kRunning; });
    table.update("a", [](JobRecord& job) {
      job.state = JobState::kFailed;
      job.error = "why";
      job.frames_complete = 4;
    });
  }
  JobTable table(data_);
  EXPECT_TRUE(table.warnings().empty());
  EXPECT_EQ(table.get("a").error, "why");
  EXPECT_EQ(table.get("a").frames_complete, 4U);
  EXPECT_EQ(table.request("a"), request().request);
  table.create(request("b"));
  EXPECT_EQ(table.list().front().id, "b") << "the order goes on after a restart";
}

TEST_F(JobTableTest, ADamagedRecordIsReportedAndHurtsNoOther) {
  {
    JobTable table(data_);
    table.create(request("a"));
    table.create(request("b"));
  }
  std::ofstream(data_ / "jobs/a/job.json", std::ios::trunc) << "{";
  JobTable table(data_);
  ASSERT_EQ(table.warnings().size(), 1U);
  EXPECT_NE(table.warnings()[0].find("jobs/a/job.json"), std::string::npos);
  EXPECT_TRUE(table.contains("b"));
  EXPECT_FALSE(table.contains("a"));
}

TEST_F(JobTableTest, WhatLiesWhereAJobShouldIsSetAside) {
  JobTable table(data_);
  fs::create_directories(data_ / "jobs/a");
  std::ofstream(data_ / "jobs/a/request.pb") << "mine";
  table.create(request("a"));
  EXPECT_EQ(table.request("a"), request().request);
  std::ifstream kept(data_ / "jobs/a.aside-1/request.pb");
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(kept), {}), "mine");
}

class RemovalTest : public JobTableTest {
 protected:
  void end(JobTable& table, const std::string& id) {
    table.update(id, [](JobRecord& job) { job.state = JobState::kCancelled; });
  }
  void write(const std::string& file) {
    fs::create_directories((data_ / file).parent_path());
    std::ofstream(data_ / file) << "x";
  }
};

TEST_F(RemovalTest, OnlyWhatHasEndedCanBeRemoved) {
  JobTable table(data_);
  table.create(request("a"));
  expect_code(ErrorCode::kFailedPrecondition, [&] { table.remove("a"); });
  end(table, "a");
  write("jobs/a/result.h5");
  EXPECT_EQ(table.remove("a").state, JobState::kCancelled);
  EXPECT_FALSE(fs::exists(data_ / "jobs/a"));
  expect_code(ErrorCode::kNotFound, [&] { table.remove("a"); });
}

TEST_F(RemovalTest, WhatNoCoordinatorMadeStays) {
  JobTable table(data_);
  table.create(request("a"));
  end(table, "a");
  write("jobs/a/notes.txt");
  table.remove("a");
  EXPECT_TRUE(fs::exists(data_ / "jobs/a/notes.txt"));
  EXPECT_FALSE(fs::exists(data_ / "jobs/a/request.pb"));
  table.create(request("a"));
  EXPECT_TRUE(fs::exists(data_ / "jobs/a.aside-1/notes.txt"));
}

TEST_F(RemovalTest, OneThatWasInterruptedIsFinishedAtTheNextStart) {
  {
    JobTable table(data_);
    table.create(request("a"));
    end(table, "a");
  }
  fs::rename(data_ / "jobs/a", data_ / "jobs/.removing-a");
  write("jobs/.removing-b/mine");
  EXPECT_FALSE(JobTable(data_).contains("a"));
  EXPECT_FALSE(fs::exists(data_ / "jobs/.removing-a"));
  EXPECT_TRUE(fs::exists(data_ / "jobs/.removing-b/mine")) << "nothing says that it was a job's";
}

TEST_F(JobTableTest, OwnersShareNoJob) {
  JobTable table(data_);
  JobRequest mine = request("a");
  mine.owner = "alice";
  mine.bytes = 100;
  table.create(mine);
  mine.owner = "bob";
  expect_code(ErrorCode::kAlreadyExists, [&] { table.create(mine); });
  EXPECT_EQ(table.holdings("alice").unfinished, 1U);
  EXPECT_EQ(table.holdings("alice").bytes, 100U);
  EXPECT_EQ(table.holdings("bob").unfinished, 0U);
  table.update("a", [](JobRecord& job) { job.state = JobState::kRunning; });
  table.update("a", [](JobRecord& job) { job.frames_complete = 4; });
  EXPECT_EQ(table.promised_bytes(), 60U) << "of 10 frames 6 are to come";
  table.update("a", [](JobRecord& job) { job.state = JobState::kFailed; });
  EXPECT_EQ(table.promised_bytes(), 0U);
  EXPECT_EQ(table.holdings("alice").unfinished, 0U);
  EXPECT_GT(table.get("a").ended_s, 0);
  EXPECT_EQ(JobTable(temporary_.path() / "other").holdings("alice").bytes, 0U);
}

TEST_F(JobTableTest, FoldersAreTheUsersAlone) {
  JobTable table(data_);
  table.create(request("a"));
  EXPECT_EQ(fs::status(data_ / "jobs").permissions(), fs::perms::owner_all);
  EXPECT_EQ(fs::status(data_ / "jobs/a").permissions(), fs::perms::owner_all);
}

TEST_F(JobTableTest, AForbiddenChangeOfStateChangesNothing) {
  JobTable table(data_);
  table.create(request("a"));
  expect_code(ErrorCode::kFailedPrecondition, [&] {
    table.update("a", [](JobRecord& job) {
      job.state = JobState::kDone;
      job.error = "half";
    });
  });
  EXPECT_EQ(table.get("a").state, JobState::kQueued);
  EXPECT_TRUE(table.get("a").error.empty());
  expect_code(ErrorCode::kNotFound, [&] { table.get("nobody"); });
}

TEST_F(JobTableTest, WaitersWakeAtAChange) {
  JobTable table(data_);
  table.create(request("a"));
  const auto [record, revision] = table.wait("a", 0, std::chrono::milliseconds(0));
  EXPECT_EQ(record.state, JobState::kQueued);
  std::thread changer([&] { table.update("a", [](JobRecord& job) { job.frames_complete = 3; }); });
  const auto [changed, later] = table.wait("a", revision, std::chrono::seconds(30));
  changer.join();
  EXPECT_EQ(changed.frames_complete, 3U);
  EXPECT_GT(later, revision);
}

TEST_F(JobTableTest, AFolderThatIsAFileIsRefused) {
  std::ofstream(data_ / "file") << "x";
  expect_code(ErrorCode::kInvalidArgument, [&] { JobTable table(data_ / "file"); });
}

}  // namespace
}  // namespace pleat::coordinator
