#include <algorithm>
#include <cmath>
#include <fstream>

#include "common/store/dataset.hpp"
#include "tests/unit/services/cli/dataset/small_set.hpp"

namespace pleat::dataset {
namespace {

class Verify : public SmallSet {
 protected:
  void SetUp() override {
    options.scenes.train = 1;
    make();
  }
  /// Records sequence draping-01 again with frames changed by `spoil`.
  void rewrite(const std::function<void(std::uint64_t, SequenceFrame&)>& spoil) {
    const DatasetReader reader(options.folder);
    const SequenceInfo info = reader.sequences().at(1);
    SequenceOptions plan;
    plan.name = info.name;
    plan.split = info.split;
    plan.scene = info.scene;
    plan.frames = info.frames;
    plan.coarse_vertices = reader.topology().coarse.vertex_count();
    plan.fine_vertices = reader.topology().fine.vertex_count();
    plan.topology_hash = info.topology_hash;
    SequenceWriter writer(options.folder, plan);
    for (std::uint64_t k = 0; k < info.frames; ++k) {
      SequenceFrame frame;
      frame.time_s = reader.times(info.name, k, k + 1)[0];
      frame.coarse = reader.coarse(info.name, k, k + 1)[0];
      frame.fine = reader.fine(info.name, k, k + 1)[0];
      spoil(k, frame);
      writer.append(frame);
    }
    writer.finish();
  }
  void expect_problem(const std::string& part) {
    const VerifyReport report = check();
    const bool found = std::any_of(report.problems.begin(), report.problems.end(),
                                   [&](const auto& line) { return line.find(part) != std::string::npos; });
    EXPECT_TRUE(found) << part << " not among " << report.problems.size()
                       << " problems, the first: " << (report.problems.empty() ? "" : report.problems[0]);
  }
};

TEST_F(Verify, AGoodSetHasNoProblems) {
  const VerifyReport report = check();
  for (const std::string& problem : report.problems) ADD_FAILURE() << problem;
  EXPECT_EQ(report.sequences, 2u);
  EXPECT_EQ(report.frames, 10u);
  EXPECT_EQ(report.frames_judged, 10u);
  EXPECT_LT(report.feature_distance_max_m, 0.02);
  EXPECT_EQ(verify(options.folder, {5}, [](const std::string&) {}).frames_judged, 2u);
}

TEST_F(Verify, FindsWhatIsWrong) {
  rewrite([](std::uint64_t k, SequenceFrame& frame) {
    if (k == 3) frame.fine(10, 1) = std::nanf("");
  });
  expect_problem("draping-01, frame 3: a position is not finite");
  rewrite([](std::uint64_t k, SequenceFrame& frame) {
    if (k == 2) frame.coarse.array() += 1;
  });
  expect_problem("draping-01, frame 2: a feature vertex");
  rewrite([](std::uint64_t k, SequenceFrame& frame) {
    if (k == 4) frame.time_s = 7;
  });
  expect_problem("draping-01, frame 4: time 7");
  rewrite([](std::uint64_t k, SequenceFrame& frame) {
    // one corner through the middle of the cloth
    if (k == 1)
      frame.fine.row(0) = 2 * frame.fine.colwise().mean() - frame.fine.row(0) + Eigen::RowVector3f(0, -0.02f, 0);
  });
  expect_problem("draping-01, frame 1: fine mesh has");
  std::filesystem::resize_file(sequence("draping-01"), 900);
  expect_problem("draping-01.h5");
}

TEST_F(Verify, FindsWhatIsMissing) {
  std::filesystem::remove(sequence("draping-01"));
  expect_problem("draping-01: not made yet");
  DatasetMaster master = DatasetReader(options.folder).master();
  master.normalization->maximum[1] = master.normalization->minimum[1];
  write_dataset_master(options.folder, master);
  expect_problem("does not cover channel 1");
  master.normalization.reset();
  write_dataset_master(options.folder, master);
  expect_problem("no normalisation");
  EXPECT_THROW(verify(root / "nothing", {}, [](const std::string&) {}), Error);
}

TEST_F(Verify, DescribeSaysWhatIsThere) {
  const auto lines = describe(options.folder);
  const auto has = [&](const std::string& part) {
    return std::any_of(lines.begin(), lines.end(), [&](const auto& l) { return l.find(part) != std::string::npos; });
  };
  EXPECT_TRUE(has("coarse mesh: 35 vertices"));
  EXPECT_TRUE(has("split train: 1 sequences, 5 frames"));
  EXPECT_TRUE(has("draping-01: test, 5 of 5 frames"));
  EXPECT_TRUE(has("normalisation present"));
}

}  // namespace
}  // namespace pleat::dataset
