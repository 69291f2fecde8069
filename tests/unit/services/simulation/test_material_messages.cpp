#include "services/simulation/material_messages.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "tests/support/errors.hpp"

namespace pleat::simulation {
namespace {

constexpr const char* kJson = R"({"density": 0.2,
  "stretching": [[50, 10, 60, 20], [51, 10, 60, 20], [52, 10, 60, 20], [53, 10, 60, 20], [54, 10, 60, 20],
                 [55, 10, 60, 20]],
  "bending": [[1e-5, 2e-5, 3e-5, 4e-5, 5e-5], [1e-5, 2e-5, 3e-5, 4e-5, 5e-5], [1e-5, 2e-5, 3e-5, 4e-5, 5e-5]]})";

TEST(MaterialMessages, NothingSetIsTheOther) {
  EXPECT_EQ(material_from_message(v1::ClothMaterial(), kJson, "material").stretching[3][0], 53);
  v1::ClothMaterial message;
  message.set_json(kJson);
  EXPECT_EQ(material_from_message(message, "{}", "material").density, 0.2);
}

TEST(MaterialMessages, ScalesTheTables) {
  v1::ClothMaterial message;
  message.set_json(kJson);
  message.mutable_options()->set_density_scale(2);
  message.mutable_options()->set_stretching_scale(3);
  message.mutable_options()->set_bending_scale(0);
  const Material scaled = material_from_message(message, "", "material");
  EXPECT_DOUBLE_EQ(scaled.density, 0.4);
  EXPECT_DOUBLE_EQ(scaled.stretching[5][2], 180);
  EXPECT_EQ(scaled.bending[2][4], 0);
}

TEST(MaterialMessages, IsotropicConstantsAreTheScenes) {
  v1::ClothMaterial message;
  v1::IsotropicMaterial& constants = *message.mutable_isotropic();
  constants.set_density(500);
  constants.set_youngs_modulus(1e6);
  constants.set_poissons_ratio(0.3);
  constants.set_thickness(5e-4);
  const Material made = material_from_message(message, "", "material");
  EXPECT_EQ(made.stretching, isotropic_material({500, 1e6, 0.3, 5e-4}, "").stretching);
  EXPECT_DOUBLE_EQ(made.density, 0.25);
}

TEST(MaterialMessages, BadValuesAreNamed) {
  v1::ClothMaterial message;
  message.set_json("{}");
  EXPECT_NE(std::string(test::error_of([&] { material_from_message(message, kJson, "open.material"); }).what())
                .find("open.material.json"),
            std::string::npos);
  message.set_json(kJson);
  for (const double bad : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()}) {
    message.mutable_options()->set_stretching_scale(bad);
    const auto error = test::error_of([&] { material_from_message(message, kJson, "open.material"); });
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    EXPECT_STREQ(error.what(), "open.material.options.stretching_scale: must be above 0");
  }
}

}  // namespace
}  // namespace pleat::simulation
