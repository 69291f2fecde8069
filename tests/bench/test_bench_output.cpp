// The shape of `pleat bench NAME --json`, which scripts depend on. Times are measured, never judged.
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/support/executable.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::test {
namespace {

using nlohmann::json;

json bench(const std::string& name) {
  const pleat::test::TemporaryFolder folder;
  const Outcome outcome = run(built("pleat"), {"bench", name, "--json", "--frames", "2"}, folder.path() / "bench");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  return json::parse(outcome.out);
}

void expect_figures(const json& report, const std::string& name, const std::vector<std::string>& figures) {
  ASSERT_TRUE(report.contains(name)) << report.dump();
  for (const std::string& figure : figures) {
    SCOPED_TRACE(figure);
    ASSERT_TRUE(report[name].contains(figure));
    const json& value = report[name][figure];
    EXPECT_TRUE(std::isfinite(value.at("median").get<double>()));
    EXPECT_GE(value.at("runs").get<int>(), 1);
    EXPECT_FALSE(value.at("unit").get<std::string>().empty());
  }
  EXPECT_TRUE(report.at("machine").contains("processor"));
  EXPECT_GE(report.at("machine").at("processors").get<int>(), 1);
  EXPECT_FALSE(report.at("git_revision").get<std::string>().empty());
}

TEST(BenchOutput, Simulation) {
  expect_figures(bench("simulation"), "simulation", {"coarse_frame", "tracked_frame", "fine_frame"});
}

TEST(BenchOutput, Conversion) {
  const json report = bench("conversion");
  expect_figures(report, "conversion", {"to_image", "to_mesh", "build_map", "round_trip_rms", "round_trip_max"});
  // The images carry 5 mm wrinkles: what is lost must be a small part of them.
  EXPECT_LT(report["conversion"]["round_trip_rms"]["median"].get<double>(), 1e-4);
  EXPECT_LE(report["conversion"]["round_trip_rms"]["median"], report["conversion"]["round_trip_max"]["median"]);
}

TEST(BenchOutput, Refinement) {
  const json report = bench("refinement");
  expect_figures(report, "refinement", {"refine", "refine_p95", "penetrations", "self_intersections"});
  EXPECT_EQ(report["refinement"]["penetrations"]["median"], 0);
  EXPECT_EQ(report["refinement"]["self_intersections"]["median"], 0);
}

}  // namespace
}  // namespace pleat::test
