#include "services/cli/result_recorder.hpp"

#include <gtest/gtest.h>

#include "common/client/adapter/adapter.hpp"
#include "common/mesh/subdivision.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/evaluation/evaluation_dataset.hpp"

namespace pleat::cli {
namespace {

class ResultRecorderTest : public testing::Test {
 protected:
  ResultRecorder recorder() {
    return ResultRecorder({folder_.path() / "result.h5",
                           {coarse_, subdivision_.fine, subdivision_.feature_vertices},
                           3,
                           0.04,
                           "draping",
                           "",
                           {}});
  }
  client::EnhancedFrame frame(std::uint64_t index) const {
    client::EnhancedFrame frame;
    frame.index = index;
    frame.time_s = 0.04 * static_cast<double>(index);
    frame.positions = client::from_positions(subdivision_.fine.rest_positions);
    frame.stage_times = {{"superres", 2}, {"superres.part", 1}, {"refinement", 3}};
    return frame;
  }
  ResultReader reader() const { return ResultReader(folder_.path() / "result.h5"); }

  const Topology coarse_ = test::sheet();
  const Subdivision subdivision_ = subdivide(coarse_, 1);
  const test::TemporaryFolder folder_;
};

TEST_F(ResultRecorderTest, AFailedFrameIsCountedAndTheOthersFollow) {
  ResultRecorder recorder = this->recorder();
  for (std::uint64_t k = 0; k < 3; ++k) {
    client::EnhancedFrame enhanced = frame(k);
    if (k == 1) {
      enhanced.error.emplace(ErrorCode::kInternal, "frame 1: no");
      enhanced.stage_times.clear();
    }
    enhanced.report.input_intersects = k == 2;
    recorder.add(enhanced, coarse_.rest_positions, {});
  }
  recorder.finish();
  EXPECT_EQ(recorder.frame_errors(), 1u);
  EXPECT_EQ(reader().frames_complete(), 3u);
  EXPECT_EQ(reader().counts("frame_errors", 0, 3), (std::vector<std::uint32_t>{0, 1, 0}));
  EXPECT_EQ(reader().counts("input_intersects", 0, 3), (std::vector<std::uint32_t>{0, 0, 1}));
  EXPECT_EQ(reader().info().stages, (std::vector<std::string>{"refinement", "superres"}))
      << "by name, as files list them";
  EXPECT_EQ(reader().stage_ms("superres", 0, 3), (std::vector<float>{2, 0, 2}));
  EXPECT_EQ(reader().enhanced(1, 2).at(0), subdivision_.fine.rest_positions);
}

TEST_F(ResultRecorderTest, AFirstFrameWithoutStagesLeavesThoseOfOthers) {
  ResultRecorder recorder = this->recorder();
  client::EnhancedFrame failed = frame(0);
  failed.error.emplace(ErrorCode::kInternal, "frame 0: no");
  failed.stage_times.clear();
  recorder.add(failed, coarse_.rest_positions, {});
  recorder.add(frame(1), coarse_.rest_positions, {});
  recorder.finish();
  EXPECT_EQ(reader().stage_ms("refinement", 0, 2), (std::vector<float>{0, 3}));
}

TEST_F(ResultRecorderTest, RefusesFramesOutOfOrderAndAnEmptyFile) {
  ResultRecorder recorder = this->recorder();
  EXPECT_EQ(test::error_of([&] { recorder.finish(); }).code(), ErrorCode::kFailedPrecondition);
  EXPECT_EQ(test::error_of([&] { recorder.add(frame(1), coarse_.rest_positions, {}); }).code(), ErrorCode::kInternal);
}

}  // namespace
}  // namespace pleat::cli
