// Evaluation on a data set of two short sequences.
#include "services/cli/evaluation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/cli/median.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/cli/executable.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;

constexpr float kOffset = 0.02f;

Topology sheet() {
  Topology t;
  constexpr int n = 4;
  t.rest_positions.resize(n * n, 3);
  t.uv.resize(n * n, 2);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      t.rest_positions.row(j * n + i) << static_cast<float>(i) / 3, 0, -static_cast<float>(j) / 3;
      t.uv.row(j * n + i) << static_cast<float>(i) / 3, static_cast<float>(j) / 3;
    }
  }
  t.faces.resize(18, 3);
  for (std::uint32_t j = 0, f = 0; j < 3; ++j) {
    for (std::uint32_t i = 0; i < 3; ++i) {
      const std::uint32_t a = j * n + i;
      t.faces.row(f++) << a, a + 1, a + n + 1;
      t.faces.row(f++) << a, a + n + 1, a + n;
    }
  }
  t.uv_faces = t.faces;
  return t;
}

/// Two frames a sequence; the fine cloth lies kOffset above the upsampled coarse one, and a sphere touches the latter.
class Evaluation : public testing::Test {
 protected:
  void SetUp() override {
    const Topology coarse = sheet();
    const Subdivision subdivision = subdivide(coarse, 2);
    DatasetMaster master;
    master.time_step_s = 0.005;
    master.frame_time_s = 0.04;
    master.topology = {coarse, subdivision.fine, subdivision.feature_vertices};
    master.sequences = {"learn", "fall"};
    FeatureRange range;
    range.minimum.fill(-1);
    range.maximum.fill(1);
    master.normalization = range;
    write_dataset_master(folder_, master);
    for (const std::string sequence : {"learn", "fall"}) {
      SequenceOptions options;
      options.name = sequence;
      options.split = sequence == "fall" ? "test" : "train";
      options.frames = 2;
      options.coarse_vertices = coarse.vertex_count();
      options.fine_vertices = subdivision.fine.vertex_count();
      options.topology_hash = topology_hash(subdivision.fine);
      options.obstacles = {{"ball", {}}};
      options.obstacle_vertices = {0};
      SequenceWriter writer(folder_, options);
      for (int k = 0; k < 2; ++k) {
        SequenceFrame frame;
        frame.time_s = 0.04 * k;
        frame.coarse = coarse.rest_positions;
        frame.fine = subdivision.fine.rest_positions;
        frame.fine.col(1).array() += kOffset;
        frame.obstacles.resize(1);
        frame.obstacles[0].name = "ball";
        frame.obstacles[0].center = {0.5f, -0.1f, -0.5f};
        frame.obstacles[0].radius = 0.11f;  // reaches 1 cm through the coarse sheet, and stays below the fine one
        writer.append(frame);
      }
      writer.finish();
    }
  }

  const pleat::test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

TEST_F(Evaluation, OfTheBaselineOnTheTestSplit) {
  const DatasetReader dataset(folder_);
  std::uint64_t last = 0, total = 0;
  const auto figures =
      evaluate(dataset, {barycentric_method(dataset.topology())}, {}, [&](std::uint64_t done, std::uint64_t of) {
        EXPECT_EQ(done, last + 1);
        last = done;
        total = of;
      });
  ASSERT_EQ(figures.size(), 1u);
  const MetricValues& values = figures[0].metrics;
  EXPECT_EQ(figures[0].name, "barycentric");
  EXPECT_EQ(values.frames, 2u);
  EXPECT_EQ(last, 2u);
  EXPECT_EQ(total, 2u);
  EXPECT_NEAR(values.rmse_m, kOffset, 1e-6);
  EXPECT_NEAR(values.hausdorff_m, kOffset, 1e-6);
  EXPECT_NEAR(values.sted.combined, 0, 1e-5);
  ASSERT_TRUE(values.psnr_db.has_value());
  EXPECT_NEAR(*values.psnr_db, psnr_db(kOffset * kOffset / 4 / 3), 1e-3);
  EXPECT_GT(values.counts.penetrations, 0u);
  EXPECT_EQ(values.counts.self_intersections, 0u);
}

TEST_F(Evaluation, OfAMethodWithoutErrorHasNoPsnrAndItsTimes) {
  const DatasetReader dataset(folder_);
  const Method perfect{
      "perfect", [&](const MethodInput& input, const auto& sink) {
        for (std::uint64_t k = 0; k < input.frames; ++k)
          sink(k, {dataset.fine(input.sequence, k, k + 1).at(0), {{"think", 1.0 + static_cast<double>(k)}}});
      }};
  const auto figures = evaluate(dataset, {perfect}, {{"learn", "fall"}, 0}, [](auto, auto) {});
  EXPECT_EQ(figures[0].metrics.frames, 4u);
  EXPECT_EQ(figures[0].metrics.vmse_m2, 0);
  EXPECT_EQ(figures[0].metrics.counts.penetrations, 0u);
  ASSERT_EQ(figures[0].median_ms.size(), 1u);
  EXPECT_DOUBLE_EQ(figures[0].median_ms[0].second, 1.5);
  const nlohmann::json json = to_json(figures);
  EXPECT_TRUE(json.at("perfect").at("psnr_db").is_null());
  EXPECT_EQ(json.at("perfect").at("think_ms"), 1.5);
  for (const char* key : {"vmse_m2", "rmse_m", "hausdorff_m", "sted", "jitter", "penetrations", "self_intersections"})
    EXPECT_TRUE(json.at("perfect").at(key).is_number()) << key;
  EXPECT_THAT(to_table(figures), testing::HasSubstr("perfect"));
}

TEST_F(Evaluation, TakesTheFirstFramesOnly) {
  const DatasetReader dataset(folder_);
  const auto figures = evaluate(dataset, {barycentric_method(dataset.topology())}, {{}, 1}, [](auto, auto) {});
  EXPECT_EQ(figures[0].metrics.frames, 1u);
}

TEST_F(Evaluation, NamesAnUnknownSequence) {
  const DatasetReader dataset(folder_);
  try {
    evaluate(dataset, {barycentric_method(dataset.topology())}, {{"jump"}, 0}, [](auto, auto) {});
    ADD_FAILURE() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kNotFound);
    EXPECT_THAT(error.what(), testing::HasSubstr("jump"));
  }
}

TEST_F(Evaluation, FindsTheRoundsOfSubdivision) {
  const DatasetReader dataset(folder_);
  EXPECT_EQ(subdivision_rounds(dataset.topology()), 2);
  MeshPair other = dataset.topology();
  other.fine.rest_positions(20, 1) += 0.1f;
  EXPECT_THROW(subdivision_rounds(other), Error);
}

TEST_F(Evaluation, AsACommandPrintsJson) {
  const test::Outcome outcome =
      test::run(test::built("pleat"), {"eval", "--dataset", folder_.string(), "--json"}, folder_ / "outcome");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const nlohmann::json json = nlohmann::json::parse(outcome.out);
  EXPECT_NEAR(json.at("barycentric").at("rmse_m").get<double>(), kOffset, 1e-6);
  EXPECT_FALSE(json.contains("zurdo2013"));
}

TEST_F(Evaluation, ExamplesFromTheTrainingSplitAreABaseline) {
  // The training sequence has the offset that the test sequence has, so that the examples know the answer.
  const test::Outcome outcome = test::run(
      test::built("pleat"), {"eval", "--dataset", folder_.string(), "--baselines", "--json"}, folder_ / "outcome");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const nlohmann::json figures = nlohmann::json::parse(outcome.out).at("zurdo2013");
  EXPECT_NEAR(figures.at("rmse_m").get<double>(), 0, 1e-6);
  EXPECT_EQ(figures.at("penetrations_before"), figures.at("penetrations"));
  EXPECT_GE(figures.at("examples_ms").get<double>(), 0);
}

TEST_F(Evaluation, CountsBeforeRefinementAreTheMethodsOwn) {
  const DatasetReader dataset(folder_);
  const Method refined{"refined", [&](const MethodInput& input, const auto& sink) {
                         for (std::uint64_t k = 0; k < input.frames; ++k)
                           sink(k, {dataset.fine(input.sequence, k, k + 1).at(0), {}, true, 7, 9});
                       }};
  const MetricValues values = evaluate(dataset, {refined}, {}, [](auto, auto) {})[0].metrics;
  EXPECT_EQ(values.counts.penetrations_before, 14u);
  EXPECT_EQ(values.counts.penetrations, 0u);
  EXPECT_EQ(values.counts.self_intersections_before, 18u);
  EXPECT_EQ(values.counts.self_intersections, 0u);
}

TEST(Quantile, InterpolatesBetweenOrderStatistics) {
  EXPECT_DOUBLE_EQ(median({3, 1, 2}), 2);
  EXPECT_DOUBLE_EQ(median({4, 1, 2, 3}), 2.5);
  EXPECT_DOUBLE_EQ(quantile({0, 10}, 0.95), 9.5);
  EXPECT_DOUBLE_EQ(quantile({7}, 0.95), 7);
  EXPECT_DOUBLE_EQ(median({}), 0);
}

}  // namespace
}  // namespace pleat::cli
