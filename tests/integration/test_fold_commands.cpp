// Commands without any bundle: `pleat run` and `pleat enhance` with the fold step or without any detail, for a scene
// and for frames of another tool; `pleat simulate`.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common/store/result.hpp"
#include "tests/support/executable.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/evaluation/evaluation_dataset.hpp"

namespace pleat::test {
namespace {

namespace fs = std::filesystem;

constexpr int kFrames = 14;

nlohmann::json report_in(const fs::path& folder) {
  std::ifstream file(folder / "report.json");
  return nlohmann::json::parse(file);
}

class FoldCommands : public testing::Test {
 protected:
  FoldCommands() {
    fs::create_directories(folder_ / "models");
    if (const char* source = std::getenv("PLEAT_SOURCE_DIR")) source_ = source;
  }

  void expect_clean(std::vector<std::string> arguments, const std::string& out, const std::string& detail) {
    arguments.insert(arguments.end(), {"--out", (folder_ / out).string()});
    // No bundle anywhere.
    const Outcome outcome =
        run(built("pleat"), arguments, folder_ / (out + "-outcome"), {{"PLEAT_MODELS", (folder_ / "models").string()}});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
    const auto report = report_in(folder_ / out);
    EXPECT_EQ(report.at("frames"), kFrames);
    EXPECT_EQ(report.at("detail"), detail);
    EXPECT_EQ(report.at("penetrations"), 0);
    EXPECT_EQ(report.at("self_intersections"), 0);
    EXPECT_EQ(report.at("frame_errors"), 0);
    EXPECT_TRUE(fs::exists(folder_ / out / "report.html"));
  }

  void expect_done(const std::vector<std::string>& arguments, const std::string& out) {
    std::vector<std::string> all = arguments;
    all.insert(all.end(), {"--detail", "fold"});
    expect_clean(all, out, "fold");
    if (HasFailure()) return;
    const auto report = report_in(folder_ / out);
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

TEST_F(FoldCommands, TakeTheTraceOfTheEnvironment) {
  const std::string id = "4bf92f3577b34da6a3ce929d0e0e4736", scene = (source_ / "deploy/scenes/draping.json").string();
  const auto verbose = [&](const std::string& out, const std::string& traceparent) {
    return run(built("pleat"),
               {"run", scene, "--frames", "2", "--detail", "fold", "--verbose", "--out", (folder_ / out).string()},
               folder_ / (out + "-outcome"), {{"TRACEPARENT", traceparent}});
  };
  const Outcome outcome = verbose("traced", "00-" + id + "-00f067aa0ba902b7-01");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.err.find("trace " + id + " of $TRACEPARENT"), std::string::npos) << outcome.err;
  for (const char* service : {"coordinator", "simulation", "fold", "refinement"}) {
    std::ostringstream log;
    log << std::ifstream(folder_ / "traced" / "logs" / (std::string(service) + ".log")).rdbuf();
    EXPECT_NE(log.str().find("trace=" + id), std::string::npos) << service << ": " << log.str();
  }
  const Outcome made = verbose("untraced", "00-" + std::string(32, '0') + "-00f067aa0ba902b7-01");
  ASSERT_EQ(made.exit_code, 0) << made.err;
  EXPECT_NE(made.err.find("trace "), std::string::npos) << made.err;
  EXPECT_EQ(made.err.find("$TRACEPARENT"), std::string::npos) << "an invalid one counts for nothing: " << made.err;
  const ResultReader a(folder_ / "traced" / "result.h5"), b(folder_ / "untraced" / "result.h5");
  EXPECT_EQ(a.enhanced(1, 2)[0], b.enhanced(1, 2)[0]) << "the bits don't depend on it";
}

TEST_F(FoldCommands, ALookBeforeTraining) {
  const std::string scene = (source_ / "deploy/scenes/draping.json").string(), frames = std::to_string(kFrames);
  expect_clean({"simulate", scene, "--frames", frames}, "coarse", "coarse");
  expect_clean({"simulate", scene, "--frames", frames, "--mode", "free"}, "free", "free");
  expect_clean({"run", scene, "--frames", frames, "--model", "none"}, "smooth", "none");
  if (HasFailure()) return;
  EXPECT_FALSE(fs::exists(folder_ / "coarse" / "logs" / "fold.log")) << "started for nothing";
  const ResultReader coarse(folder_ / "coarse" / "result.h5"), free(folder_ / "free" / "result.h5"),
      smooth(folder_ / "smooth" / "result.h5");
  const std::uint64_t last = kFrames - 1;
  EXPECT_EQ(coarse.enhanced(last, kFrames)[0], coarse.coarse(last, kFrames)[0]);
  EXPECT_EQ(free.coarse(last, kFrames)[0], coarse.coarse(last, kFrames)[0]) << "one simulation, three looks";
  EXPECT_EQ(smooth.coarse(last, kFrames)[0], coarse.coarse(last, kFrames)[0]);
  EXPECT_EQ(free.info().topology.fine.vertex_count(), smooth.info().topology.fine.vertex_count());
  EXPECT_NE(free.enhanced(last, kFrames)[0], smooth.enhanced(last, kFrames)[0]);
  EXPECT_TRUE(report_in(folder_ / "free").at("stages").contains("simulation.fine"));

  expect_clean({"enhance", "--rest", (source_ / "deploy/garments/tablecloth.obj").string(), "--frames",
                (folder_ / "coarse" / "result.h5").string(), "--detail", "none"},
               "theirs", "none");
  if (HasFailure()) return;
  const ResultReader theirs(folder_ / "theirs" / "result.h5");
  EXPECT_LT((theirs.enhanced(last, kFrames)[0] - smooth.enhanced(last, kFrames)[0]).cwiseAbs().maxCoeff(), 1e-6F);
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
