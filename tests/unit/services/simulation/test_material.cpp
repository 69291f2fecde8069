#include "services/simulation/material.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>

#include "common/base/error.hpp"
#include "services/simulation/dynamics.hpp"
#include "tests/unit/services/simulation/garments.hpp"

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

// Constants of a sheet for which every part of the energy is well above rounding.
constexpr IsotropicConstants kPlate{900, 2e6, 0.35, 2e-3};

Dynamics dynamics_of(const Topology& mesh, const IsotropicConstants& constants) {
  Scene scene = sheet_scene();
  scene.garment = mesh;
  scene.material = isotropic_material(constants, "plate");
  return {mesh, scene};
}

// Energy of a sheet of 0.4 m x 0.4 m whose points are moved by a map.
template <typename Map>
double energy_of(const Dynamics& dynamics, const Topology& mesh, const Map& map) {
  Points x;
  for (Eigen::Index v = 0; v < mesh.vertex_count(); ++v) {
    x.push_back(map(Eigen::Vector3d(mesh.rest_positions.row(v).cast<double>().transpose())));
  }
  return dynamics.internal_energy(x);
}

TEST(IsotropicMaterial, StretchesAndShearsAsAPlateInPlaneStress) {
  const Topology mesh = sheet(6, 6, 0.4, 0.4);
  const Dynamics dynamics = dynamics_of(mesh, kPlate);
  const auto [density, young, ratio, thickness] = kPlate;
  const double area = 0.16, strain = 1e-3;
  const double stretched = energy_of(dynamics, mesh, [&](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(p.x() * (1 + strain), 0, p.z() * (1 - ratio * strain));
  });
  EXPECT_NEAR(stretched, young * thickness * strain * strain * area / 2, 0.005 * stretched);
  const double sheared = energy_of(
      dynamics, mesh, [&](const Eigen::Vector3d& p) { return Eigen::Vector3d(p.x() + strain * p.z(), 0, p.z()); });
  EXPECT_NEAR(sheared, young / (2 * (1 + ratio)) * thickness * strain * strain * area / 2, 0.005 * sheared);
  double mass = 0;
  for (const double m : dynamics.masses()) mass += m;
  EXPECT_NEAR(mass, density * thickness * area, 1e-6);
}

TEST(IsotropicMaterial, BendsAsAPlate) {
  // Rolled up without stretching: plane strips of the width of a cell, each turned against the last.
  const int cells = 20;
  const Topology mesh = sheet(cells, 5, 0.4, 0.4);
  const Dynamics dynamics = dynamics_of(mesh, kPlate);
  const auto [density, young, ratio, thickness] = kPlate;
  const double cell = 0.4 / cells, curvature = 2, turn = curvature * cell;
  const double energy = energy_of(dynamics, mesh, [&](const Eigen::Vector3d& p) {
    const int column = static_cast<int>(std::lround((p.x() + 0.2) / cell));
    Eigen::Vector3d rolled(0, 0, p.z());
    for (int i = 0; i < column; ++i) rolled += cell * Eigen::Vector3d(std::cos(i * turn), std::sin(i * turn), 0);
    return rolled;
  });
  const double rigidity = young * std::pow(thickness, 3) / (12 * (1 - ratio * ratio));
  // The outermost half cells are plane.
  const double expected = rigidity * curvature * curvature / 2 * 0.16 * (cells - 1) / cells;
  EXPECT_NEAR(energy, expected, 0.005 * expected);
}

TEST(IsotropicMaterial, ShippedFilesFollowTheFormula) {
  const std::pair<const char*, IsotropicConstants> shipped[] = {{"light", {400, 6e5, 0.3, 2e-4}},
                                                                {"medium", {375, 7.5e5, 0.3, 4e-4}},
                                                                {"heavy", {500, 1e6, 0.3, 8e-4}},
                                                                {"latex", {950, 1.2e6, 0.49, 4e-4}}};
  for (const auto& [name, constants] : shipped) {
    const Material file = read_material("deploy/materials/isotropic-" + std::string(name) + ".json");
    const Material computed = isotropic_material(constants, name);
    EXPECT_NEAR(file.density, computed.density, 1e-8 * computed.density) << name;
    for (std::size_t r = 0; r < 6; ++r) {
      for (std::size_t c = 0; c < 4; ++c) {
        EXPECT_NEAR(file.stretching[r][c], computed.stretching[r][c], 1e-8 * computed.stretching[r][c]) << name;
      }
    }
    for (std::size_t r = 0; r < 3; ++r) {
      for (std::size_t c = 0; c < 5; ++c) {
        EXPECT_NEAR(file.bending[r][c], computed.bending[r][c], 1e-8 * computed.bending[r][c]) << name;
      }
    }
  }
}

TEST(IsotropicMaterial, RefusesBadConstants) {
  const auto refused = [](IsotropicConstants constants, const std::string& key) {
    try {
      isotropic_material(constants, "sheet");
      FAIL() << "accepted: " << key;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
      EXPECT_THAT(e.what(), testing::HasSubstr("sheet: " + key));
    }
  };
  refused({-1, 1e6, 0.3, 1e-3}, "density");
  refused({300, 0, 0.3, 1e-3}, "Young's modulus");
  refused({300, 1e6, 0.51, 1e-3}, "Poisson's ratio");
  refused({300, 1e6, std::nan(""), 1e-3}, "Poisson's ratio");
  refused({300, 1e6, 0.3, std::numeric_limits<double>::infinity()}, "thickness");
}

}  // namespace
}  // namespace pleat::simulation
