#include <gtest/gtest.h>

#include <array>

#include "common/base/error.hpp"
#include "services/coordinator/job.hpp"

namespace pleat::coordinator {
namespace {

constexpr std::array kStates{JobState::kQueued, JobState::kRunning, JobState::kReference,
                             JobState::kDone,   JobState::kFailed,  JobState::kCancelled};

JobRecord sample() {
  JobRecord record;
  record.id = "draping-1";
  record.scene_name = "draping";
  record.state = JobState::kReference;
  record.order = 7;
  record.frames = 120;
  record.frames_complete = 120;
  record.reference = true;
  record.reference_frames_complete = 11;
  record.detail = "both";
  record.error = "a \"quoted\" cause";
  record.model = "tablecloth";
  record.device = "cpu";
  record.precision = "bfloat16";
  record.coarse_vertices = 749;
  record.fine_vertices = 11393;
  record.wall_s = 1.0 / 3;
  record.penetrations = 1;
  record.self_intersections = 2;
  record.frame_errors = 3;
  record.pinched_frames = 4;
  record.pinch_depth_m = 0.0125F;
  record.trace = *telemetry::parse_traceparent("00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01");
  record.trace.state = "congo=t61rcWkgMzE";
  record.warnings = {"handle 0 can't follow", "a second"};
  return record;
}

TEST(Job, NothingFollowsAnEnd) {
  for (const JobState from : {JobState::kDone, JobState::kFailed, JobState::kCancelled}) {
    EXPECT_TRUE(has_ended(from));
    for (const JobState to : kStates) EXPECT_FALSE(may_become(from, to)) << to_string(from) << " " << to_string(to);
  }
}

TEST(Job, StatesFollowTheirOrder) {
  EXPECT_TRUE(may_become(JobState::kQueued, JobState::kRunning));
  EXPECT_TRUE(may_become(JobState::kRunning, JobState::kReference));
  EXPECT_TRUE(may_become(JobState::kRunning, JobState::kDone));
  EXPECT_TRUE(may_become(JobState::kReference, JobState::kDone));
  EXPECT_TRUE(may_become(JobState::kReference, JobState::kQueued));
  EXPECT_FALSE(may_become(JobState::kQueued, JobState::kDone));
  EXPECT_FALSE(may_become(JobState::kQueued, JobState::kReference));
  EXPECT_FALSE(may_become(JobState::kReference, JobState::kRunning));
  for (const JobState from : {JobState::kQueued, JobState::kRunning, JobState::kReference}) {
    EXPECT_TRUE(may_become(from, JobState::kFailed));
    EXPECT_TRUE(may_become(from, JobState::kCancelled));
  }
}

TEST(Job, IdsAreSafeFolderNames) {
  EXPECT_TRUE(is_valid_job_id("Draping_01-b"));
  for (const char* bad : {"", "..", "a/b", "a b", "\xc3\xa4"}) EXPECT_FALSE(is_valid_job_id(bad)) << bad;
  EXPECT_TRUE(is_valid_job_id(std::string(64, 'a')));
  EXPECT_FALSE(is_valid_job_id(std::string(65, 'a')));
}

TEST(Job, RecordsSurviveTheirJson) { EXPECT_EQ(job_from_json(to_json(sample()), "job.json"), sample()); }

TEST(Job, RecordsFromBeforeThereWereWarningsAreRead) {
  JobRecord old = sample();
  old.warnings.clear();
  std::string json = to_json(old);
  const std::size_t entry = json.find(",\n  \"warnings\": []");
  ASSERT_NE(entry, std::string::npos) << json;
  json.erase(entry, std::string(",\n  \"warnings\": []").size());
  EXPECT_EQ(job_from_json(json, "job.json"), old);
}

TEST(Job, ARecordThatIsNotUtf8IsStillWritten) {
  JobRecord record = sample();
  record.error = "broken \xff byte";
  EXPECT_NE(job_from_json(to_json(record), "job.json").error.find("broken"), std::string::npos);
}

TEST(Job, DamagedRecordsNameTheirFile) {
  const std::string good = to_json(sample());
  for (const std::string& bad : {std::string(), good.substr(0, good.size() / 2), std::string("[]"),
                                 std::string(R"({"format":"pleat.job","version":2})"),
                                 std::string(good).replace(good.find("draping-1"), 9, "../escape")}) {
    try {
      job_from_json(bad, "jobs/x/job.json");
      FAIL() << bad;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kDataLoss);
      EXPECT_NE(std::string(e.what()).find("jobs/x/job.json"), std::string::npos) << e.what();
    }
  }
}

}  // namespace
}  // namespace pleat::coordinator
