#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>

#include "common/store/dataset.hpp"
#include "tests/unit/services/dataset/small_set.hpp"

namespace pleat::dataset {
namespace {

class Verify : public SmallSet {
 protected:
  class Original : public SmallSet {
   public:
    Original() {
      options.scenes.train = 1;
      make();
    }
    using SmallSet::options;

   private:
    void TestBody() override {}
  };
  static std::unique_ptr<Original> original;

  /// One set for all tests; each works on a copy.
  static void SetUpTestSuite() { original = std::make_unique<Original>(); }
  static void TearDownTestSuite() { original.reset(); }
  void SetUp() override {
    std::filesystem::copy(original->options.folder, options.folder, std::filesystem::copy_options::recursive);
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

std::unique_ptr<Verify::Original> Verify::original;

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
  const Faces faces = DatasetReader(options.folder).topology().fine.faces;
  rewrite([&faces](std::uint64_t k, SequenceFrame& frame) {
    if (k != 1) return;
    // An edge of the first face is put through the last one.
    const auto corner = [&](Eigen::Index face, int c) { return static_cast<Eigen::Index>(faces(face, c)); };
    const Eigen::Index last = faces.rows() - 1;
    const Eigen::RowVector3f p = frame.fine.row(corner(last, 0)), q = frame.fine.row(corner(last, 1)),
                             r = frame.fine.row(corner(last, 2));
    const Eigen::RowVector3f normal = (q - p).cross(r - p).normalized();
    frame.fine.row(corner(0, 0)) = (p + q + r) / 3 + 0.01f * normal;
    frame.fine.row(corner(0, 1)) = (p + q + r) / 3 - 0.01f * normal;
  });
  expect_problem("draping-01, frame 1: fine mesh has");
  std::filesystem::resize_file(sequence("draping-01"), 900);
  expect_problem("draping-01.h5");
}

TEST_F(Verify, FindsWhatIsMissing) {
  std::filesystem::remove(sequence("draping-01"));
  expect_problem("draping-01: not made yet");
  DatasetMaster master = DatasetReader(options.folder).master();
  master.normalization->scale[1] = 0;
  write_dataset_master(options.folder, master);
  expect_problem("does not cover channel 1");
  master.normalization.reset();
  write_dataset_master(options.folder, master);
  expect_problem("no normalisation");
  EXPECT_THROW(verify(root / "nothing", {}, [](const std::string&) {}), Error);
}

TEST_F(Verify, DescribeSaysWhatIsThere) {
  const auto lines = to_lines(describe(options.folder));
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
