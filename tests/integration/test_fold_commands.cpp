// `pleat run` and `pleat enhance` with the fold step: no bundle, no network, for a scene and for frames of another
// tool.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>

#include "common/store/result.hpp"
#include "tests/support/executable.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/evaluation/evaluation_dataset.hpp"

namespace pleat::test {
namespace {

namespace fs = std::filesystem;

constexpr int kFrames = 14;

class FoldCommands : public testing::Test {
 protected:
  FoldCommands() {
    fs::create_directories(folder_ / "models");
    if (const char* source = std::getenv("PLEAT_SOURCE_DIR")) source_ = source;
  }

  void expect_done(const std::vector<std::string>& arguments, const std::string& out) {
    std::vector<std::string> all = arguments;
    all.insert(all.end(), {"--detail", "fold", "--out", (folder_ / out).string()});
    // No bundle anywhere.
    const Outcome outcome =
        run(built("pleat"), all, folder_ / (out + "-outcome"), {{"PLEAT_MODELS", (folder_ / "models").string()}});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
    std::ifstream file(folder_ / out / "report.json");
    const auto report = nlohmann::json::parse(file);
    EXPECT_EQ(report.at("frames"), kFrames);
    EXPECT_EQ(report.at("detail"), "fold");
    EXPECT_EQ(report.at("penetrations"), 0);
    EXPECT_EQ(report.at("self_intersections"), 0);
    EXPECT_EQ(report.at("frame_errors"), 0);
    EXPECT_EQ(report.at("fold_restarts"), 1) << "the first frame alone begins anew";
    EXPECT_GT(report.at("fold_steps"), 0);
    EXPECT_TRUE(report.at("stages").contains("fold"));
    EXPECT_FALSE(report.at("stages").contains("superres"));
    EXPECT_FALSE(fs::exists(folder_ / out / "logs" / "superres.log")) << "started for nothing";
  }

  const TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
  fs::path source_ = ".";
};

TEST_F(FoldCommands, NeedNoBundle) {
  expect_done({"run", (source_ / "deploy/scenes/draping.json").string(), "--frames", std::to_string(kFrames)}, "ours");
  if (HasFailure()) return;
  const std::string result = (folder_ / "ours" / "result.h5").string();
  // The same coarse frames, as if another tool had made them; no rounds given: as fine as a bundle would make them.
  expect_done({"enhance", "--rest", (source_ / "deploy/garments/tablecloth.obj").string(), "--frames", result,
               "--material", (source_ / "deploy/materials/gray-interlock.json").string(), "--held", "77"},
              "theirs");
  if (HasFailure()) return;
  const ResultReader ours(result), theirs(folder_ / "theirs" / "result.h5");
  EXPECT_EQ(ours.info().topology.fine.vertex_count(), theirs.info().topology.fine.vertex_count());
  const float differ =
      (ours.enhanced(kFrames - 1, kFrames)[0] - theirs.enhanced(kFrames - 1, kFrames)[0]).cwiseAbs().maxCoeff();
  EXPECT_LT(differ, 2e-2F) << "velocities are differences of rounded positions: almost the same frame";
}

class EvaluatesFold : public EvaluationDataset {};

TEST_F(EvaluatesFold, WithTheHandlesOfTheSequencesScene) {
  const Outcome outcome = run(built("pleat"),
                              {"eval", "--dataset", folder_.string(), "--detail", "fold", "--skip-refinement", "--json",
                               "--logs", (folder_ / "logs").string()},
                              folder_ / "outcome", {{"PLEAT_MODELS", folder_.string()}});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const nlohmann::json figures = nlohmann::json::parse(outcome.out).at("fold");
  EXPECT_EQ(figures.at("frames"), 2);
  EXPECT_NEAR(figures.at("rmse_m").get<double>(), kOffset, 1e-6) << "every vertex is held: the upsampled coarse cloth";
  EXPECT_TRUE(figures.at("fold_ms").is_number());
  EXPECT_EQ(figures.at("wrinkles").size(), 4U);
}

}  // namespace
}  // namespace pleat::test
