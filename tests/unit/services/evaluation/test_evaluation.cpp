// Evaluation on a data set of two short sequences.
#include "services/evaluation/evaluation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/error.hpp"
#include "common/base/statistics.hpp"
#include "tests/support/executable.hpp"
#include "tests/unit/services/evaluation/evaluation_dataset.hpp"

namespace pleat::evaluation {
namespace {

using test::kOffset;
using Evaluation = test::EvaluationDataset;

TEST_F(Evaluation, OfTheBaselineOnTheTestSplit) {
  const DatasetReader dataset(folder_);
  std::uint64_t last = 0, total = 0;
  const auto figures = evaluate(dataset, {barycentric_method()}, {}, [&](std::uint64_t done, std::uint64_t of) {
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
  const auto figures = evaluate(dataset, {barycentric_method()}, {{}, 1}, [](auto, auto) {});
  EXPECT_EQ(figures[0].metrics.frames, 1u);
}

TEST_F(Evaluation, NamesAnUnknownSequence) {
  const DatasetReader dataset(folder_);
  try {
    evaluate(dataset, {barycentric_method()}, {{"jump"}, 0}, [](auto, auto) {});
    ADD_FAILURE() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kNotFound);
    EXPECT_THAT(error.what(), testing::HasSubstr("jump"));
  }
}

TEST_F(Evaluation, FindsTheRoundsOfSubdivision) {
  const DatasetReader dataset(folder_);
  EXPECT_EQ(subdivision_of(dataset.topology()), SubdivisionSpec{2});
  MeshPair other = dataset.topology();
  other.fine.rest_positions(20, 1) += 0.1f;
  EXPECT_THROW(subdivision_of(other), Error);
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
  EXPECT_FALSE(figures.contains("refinement_ms")) << "the method has no refinement";
  EXPECT_TRUE(figures.at("examples_ms").is_number());
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

TEST_F(Evaluation, OfSeveralGarmentsIsEachOnItsOwnMeshes) {
  add_garment();
  const DatasetReader dataset(folder_);
  const Method half_way{"half", [](const MethodInput& input, const auto& sink) {
                          const float offset = input.sequence == "wide" ? 0.03f : 0.01f;  // a quarter, a half lacks
                          for (std::uint64_t k = 0; k < input.frames; ++k) {
                            MethodFrame frame{input.meshes->fine.rest_positions, {}};
                            frame.positions.col(1).array() += offset;
                            sink(k, frame);
                          }
                        }};
  const auto garments = evaluate_garments(dataset, {barycentric_method(), half_way}, {}, [](auto, auto) {});
  ASSERT_EQ(garments.size(), 2u);
  EXPECT_EQ(garments[0].sequences, std::vector<std::string>{"fall"});
  EXPECT_EQ(garments[1].sequences, std::vector<std::string>{"wide"});
  EXPECT_NEAR(garments[0].methods[0].metrics.rmse_m, kOffset, 1e-6);
  EXPECT_NEAR(garments[1].methods[0].metrics.rmse_m, 2 * kOffset, 1e-6);
  EXPECT_TRUE(garments[0].methods[0].metrics.psnr_db.has_value());
  EXPECT_FALSE(garments[1].methods[0].metrics.psnr_db.has_value()) << "the ranges are of the other garment";
  EXPECT_NEAR(gain_db(garments[0], "half").value(), 20 * std::log10(2), 1e-3);
  EXPECT_NEAR(gain_db(garments[1], "half").value(), 20 * std::log10(4), 1e-3);
  EXPECT_FALSE(gain_db(garments[1], "other").has_value());

  const nlohmann::json json = to_json(garments);
  EXPECT_EQ(json.at("garments").size(), 2u);
  EXPECT_NEAR(json.at("garments")[1].at("methods").at("half").at("rmse_m").get<double>(), 0.01, 1e-6);
  EXPECT_NEAR(json.at("gain_db").at("half").at("mean").get<double>(), 30 * std::log10(2), 1e-3);
  EXPECT_EQ(json.at("gain_db").at("half").at("least_of"), "fall");
  EXPECT_THAT(to_table(garments), testing::HasSubstr("6.02 (fall)"));

  try {
    evaluate(dataset, {barycentric_method()}, {}, [](auto, auto) {});
    ADD_FAILURE() << "one row of figures for two garments";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(error.what(), testing::HasSubstr("fall and wide"));
  }
}

TEST_F(Evaluation, AsACommandServesSeveralGarments) {
  add_garment();
  const test::Outcome outcome = test::run(
      test::built("pleat"), {"eval", "--dataset", folder_.string(), "--detail", "fold", "--json"}, folder_ / "outcome");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const nlohmann::json json = nlohmann::json::parse(outcome.out);
  ASSERT_EQ(json.at("garments").size(), 2u);
  for (const nlohmann::json& garment : json["garments"]) EXPECT_EQ(garment.at("methods").at("fold").at("frames"), 2);
  EXPECT_TRUE(json.at("gain_db").contains("fold"));
}

}  // namespace
}  // namespace pleat::evaluation
