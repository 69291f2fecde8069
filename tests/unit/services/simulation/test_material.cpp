#include "services/simulation/material.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <numbers>

#include "common/base/error.hpp"

namespace pleat::simulation {
namespace {

using nlohmann::json;
using testing::HasSubstr;

json gray_interlock() {
  json j;
  const Material m = read_material("deploy/materials/gray-interlock.json");
  j["density"] = m.density;
  j["stretching"] = m.stretching;
  j["bending"] = m.bending;
  return j;
}

void expect_refused(const std::function<void(json&)>& spoil, const std::string& culprit) {
  json j = gray_interlock();
  spoil(j);
  try {
    parse_material(j.dump(), "cloth.json");
    FAIL() << "accepted: " << culprit;
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(e.what(), HasSubstr("cloth.json"));
    EXPECT_THAT(e.what(), HasSubstr(culprit));
  }
}

TEST(Material, ShippedOnesAreReadable) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator("deploy/materials")) {
    if (entry.path().extension() != ".json") continue;
    EXPECT_GT(read_material(entry.path()).density, 0) << entry.path();
    ++count;
  }
  EXPECT_GE(count, 3);
}

TEST(Material, RefusesWhatIsNotAMaterial) {
  expect_refused([](json& j) { j.erase("density"); }, "'density' is missing");
  expect_refused([](json& j) { j.erase("stretching"); }, "'stretching' is missing");
  expect_refused([](json& j) { j.erase("bending"); }, "'bending' is missing");
  expect_refused([](json& j) { j["densty"] = 1; }, "unknown key 'densty'");
  expect_refused([](json& j) { j["density"] = 0; }, "density must be positive");
  expect_refused([](json& j) { j["density"] = -1; }, "density must be positive");
  expect_refused([](json& j) { j["density"] = "heavy"; }, "density is not a number");
  expect_refused([](json& j) { j["density"] = 1e300; }, "density is out of range");
  expect_refused([](json& j) { j["stretching"].erase(5); }, "stretching must have 6 rows");
  expect_refused([](json& j) { j["bending"][1].push_back(1); }, "bending row 1 must have 5 numbers");
  expect_refused([](json& j) { j["bending"][2][0] = nullptr; }, "bending row 2 is not a number");
  expect_refused([](json& j) { j["stretching"][0] = {0, 0, 1, 1}; }, "row 0 needs positive");
  EXPECT_THROW(parse_material("", "x"), Error);
  EXPECT_THROW(parse_material("{", "x"), Error);
  EXPECT_THROW(parse_material("[]", "x"), Error);
  EXPECT_THROW(read_material("/nonexistent.json"), Error);
}

TEST(StretchingTable, AtRestAndAtFullStretch) {
  const Material m = read_material("deploy/materials/gray-interlock.json");
  // At rest: twice the file's row 0, negative entries as 0.
  const Moduli rest = StretchingTable::exact(m, 0, 0, 0);
  EXPECT_NEAR(rest.c11, 2 * 16.593832, 1e-4);
  EXPECT_EQ(rest.c12, 0);
  EXPECT_NEAR(rest.c22, 2 * 34.477123, 1e-4);
  EXPECT_NEAR(rest.c33, 2 * 36.860302, 1e-4);
  // Stretched by more than a sixth along u, and along v.
  const double g = (1.3 * 1.3 - 1) / 2;
  EXPECT_NEAR(StretchingTable::exact(m, g, 0, 0).c11, 2 * 46.364765, 1e-4);
  EXPECT_EQ(StretchingTable::exact(m, g, 0, 0).c33, 0);
  EXPECT_NEAR(StretchingTable::exact(m, 0, g, 0).c22, 2 * 405.872833, 1e-3);
  // Stretched at 45 degrees, whatever the sign of the shear.
  EXPECT_NEAR(StretchingTable::exact(m, g / 2, g / 2, g / 2).c11, 2 * 123.98922, 1e-3);
  EXPECT_NEAR(StretchingTable::exact(m, g / 2, g / 2, -g / 2).c11, 2 * 123.98922, 1e-3);
}

TEST(StretchingTable, InterpolatesTheModelAndClampsOutside) {
  const Material m = read_material("deploy/materials/gray-interlock.json");
  const StretchingTable table(m, 1.5);
  // Exact on the grid.
  for (const double g00 : {-0.25, 0.05, 0.35}) {
    const Moduli a = table.at(g00, 0.25, 0.1), b = StretchingTable::exact(m, g00, 0.25, 0.1);
    EXPECT_NEAR(a.c11, 1.5f * b.c11, 1e-2);
    EXPECT_NEAR(a.c22, 1.5f * b.c22, 1e-2);
    EXPECT_NEAR(a.c33, 1.5f * b.c33, 1e-2);
  }
  const Moduli far = table.at(50, 0, 0), edge = table.at(0.7166, 0, 0);
  EXPECT_NEAR(far.c11, edge.c11, 1e-2);
  EXPECT_TRUE(std::isfinite(table.at(-0.5, -0.5, 40).c33));
}

TEST(StretchingTable, EnergyIsConvexEverywhere) {
  const StretchingTable table(read_material("deploy/materials/gray-interlock.json"), 1);
  for (double a = -0.3; a < 0.8; a += 0.03) {
    for (double b = -0.3; b < 0.8; b += 0.03) {
      for (double c = -0.9; c < 0.9; c += 0.1) {
        const Moduli k = table.at(a, b, c);
        EXPECT_GE(k.c11, 0);
        EXPECT_GE(k.c33, 0);
        EXPECT_GE(k.c11 * k.c22 - k.c12 * k.c12, -1e-2f * k.c11 * k.c22);
      }
    }
  }
}

TEST(Bending, SamplesDirectionsAndSigns) {
  const Material m = read_material("deploy/materials/gray-interlock.json");
  EXPECT_NEAR(bending_stiffness(m, 1, 0, 0), 23.191698e-6, 1e-12);
  EXPECT_NEAR(bending_stiffness(m, -1, 0, 0), 23.191698e-6, 1e-12);
  EXPECT_NEAR(bending_stiffness(m, 0, 1, 0), 14.267624e-6, 1e-12);
  EXPECT_NEAR(bending_stiffness(m, 1, 1, 0), 24.749964e-6, 1e-12);
  EXPECT_NEAR(bending_stiffness(m, -1, 1, 0), 24.749964e-6, 1e-12);
  // Half the curvature counts: 10 1/m reads the sample of 5 1/m. Beyond the last sample it stays.
  EXPECT_NEAR(bending_stiffness(m, 1, 0, 10), 32.932217e-6, 1e-12);
  EXPECT_NEAR(bending_stiffness(m, 1, 0, 40), 23.382786e-6, 1e-12);
  EXPECT_NEAR(bending_stiffness(m, 1, 0, 400), 23.382786e-6, 1e-12);
  for (const double kappa : {3.0, 17.0, 60.0}) {
    EXPECT_EQ(bending_stiffness(m, 2, 1, kappa), bending_stiffness(m, 2, 1, -kappa));
  }
  const double between = std::tan(std::numbers::pi / 8);
  EXPECT_NEAR(bending_stiffness(m, 1, between, 0), (23.191698e-6 + 24.749964e-6) / 2, 1e-12);
}

}  // namespace
}  // namespace pleat::simulation
