// The shipped garments put onto the shipped body.
#include "services/simulation/dress/dress.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "common/mesh/garment.hpp"
#include "common/mesh/obj.hpp"
#include "services/simulation/body/character_file.hpp"
#include "tests/support/cgal_judge.hpp"
#include "tests/support/errors.hpp"

namespace pleat::dress {
namespace {

using testing::HasSubstr;

std::filesystem::path deploy() { return std::filesystem::path(std::getenv("PLEAT_SOURCE_DIR")) / "deploy"; }

const body::SkinnedMesh& woman() {
  static const body::SkinnedMesh body = *body::read_character_file(deploy() / "bodies/young-female.glb").body;
  return body;
}

Garment shipped(const std::string& name) { return {name, read_obj(deploy() / "garments" / (name + ".obj"))}; }

/// Scaled about its middle in space, not in the material, and moved.
Garment displaced(Garment garment, float scale, const Eigen::RowVector3f& way) {
  Positions& x = garment.mesh.rest_positions;
  const Eigen::RowVector3f middle = x.colwise().mean();
  x = (scale * (x.rowwise() - middle)).rowwise() + (middle + way);
  return garment;
}

DressOptions options() {
  DressOptions o;
  o.material = simulation::read_material(deploy() / "materials/isotropic-medium.json");
  o.threads = 1;
  return o;
}

void expect_clean(const std::vector<Garment>& garments, const Dressed& dressed) {
  std::vector<Topology> meshes;
  for (std::size_t g = 0; g < garments.size(); ++g) {
    meshes.push_back(garments[g].mesh);
    meshes.back().rest_positions = dressed.garments[g];
  }
  const Topology all = join_garments(meshes);
  ObstacleShape shape;
  shape.name = "body";
  shape.faces = woman().mesh.faces;
  ObstacleFrame frame;
  frame.name = "body";
  frame.positions = woman().mesh.rest_positions;
  const auto judgement = test::judge(all.rest_positions, all.faces, {&shape, 1}, {&frame, 1});
  EXPECT_TRUE(judgement.clean()) << judgement.first;
}

struct Placing {
  const char* garment;
  float scale;
  Eigen::RowVector3f way;
};

class Displaced : public testing::TestWithParam<Placing> {};

TEST_P(Displaced, GarmentsComeToWhereTheyAreWorn) {
  const Garment garment = shipped(GetParam().garment);
  const std::vector<Garment> garments{displaced(garment, GetParam().scale, GetParam().way)};
  const Dressed dressed = dress(garments, woman(), options());
  expect_clean(garments, dressed);
  EXPECT_LT(dressed.stretch[0], 1.1);
  // Relaxed, and where it ends from the place that it was made for.
  const Dressed expected = dress({garment}, woman(), options());
  EXPECT_LT((dressed.garments[0].colwise().mean() - expected.garments[0].colwise().mean()).norm(), 0.03f);
}

// Some 9 cm away, and larger or smaller.
INSTANTIATE_TEST_SUITE_P(Garments, Displaced,
                         testing::Values(Placing{"long-skirt", 1.1f, {0.05f, 0.06f, -0.05f}},
                                         Placing{"t-shirt", 0.92f, {-0.04f, -0.05f, 0.06f}},
                                         Placing{"trousers", 1.1f, {0.05f, 0.06f, -0.05f}},
                                         Placing{"skirt-219", 0.92f, {-0.04f, -0.05f, 0.06f}},
                                         Placing{"skirt-127", 1.1f, {0.05f, 0.06f, -0.05f}}),
                         [](const auto& values) {
                           std::string name = values.param.garment;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

TEST(Dress, SeveralGarmentsAreWornOverEachOtherAndIntoAPose) {
  const std::vector<Garment> garments{displaced(shipped("trousers"), 1.03f, {0.03f, 0.02f, 0}),
                                      displaced(shipped("t-shirt"), 1.05f, {0, 0.05f, 0.02f})};
  DressOptions o = options();
  std::size_t frames = 0;
  const Dressed dressed = dress(garments, woman(), o, [&](std::size_t done) { EXPECT_EQ(done, ++frames); });
  EXPECT_EQ(frames, static_cast<std::size_t>(2 * o.grow_frames + o.settle_frames));
  expect_clean(garments, dressed);
  // A step to the side: everything comes along.
  Positions there = woman().mesh.rest_positions;
  o.settle_frames = 1;
  for (int k = 0; k < 10; ++k) {
    there.col(0).array() += 0.01f;
    o.then.push_back(there);
  }
  const Dressed moved = dress({garments[0]}, woman(), o);
  EXPECT_NEAR(moved.garments[0].col(0).mean() - dressed.garments[0].col(0).mean(), 0.1f, 0.03f);
}

TEST(Dress, SaysWhatIsWrong) {
  const auto refusal = [](const Garment& garment, const DressOptions& o = options()) {
    const Error error = test::error_of([&] { dress({garment}, woman(), o); });
    EXPECT_THAT(error.what(), HasSubstr(garment.name));
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    return std::string(error.what());
  };
  Garment turned = shipped("trousers");
  turned.mesh.faces.col(1).swap(turned.mesh.faces.col(2));
  turned.mesh.uv_faces.col(1).swap(turned.mesh.uv_faces.col(2));
  EXPECT_THAT(refusal(turned), HasSubstr("inside out: 100 %"));
  EXPECT_THAT(refusal(displaced(shipped("t-shirt"), 1, {0, 0, 0.7f})), HasSubstr("not around the body"));
  EXPECT_THAT(refusal(displaced(shipped("t-shirt"), 1, {0.9f, 0, 0})), HasSubstr("0.90 m to the left"));
  DressOptions stay = options();
  stay.reach_m = 0;
  EXPECT_THAT(refusal(displaced(shipped("t-shirt"), 1, {0, 0.15f, 0}), stay), HasSubstr("within 0 cm"));
  EXPECT_THAT(refusal(displaced(shipped("t-shirt"), 100, {0, 0, 0})), HasSubstr("--scale"));
  EXPECT_THAT(refusal({"body", woman().mesh}), HasSubstr("no opening"));
  stay.reach_m = 2;
  EXPECT_THROW(dress({shipped("t-shirt")}, woman(), stay), Error);
  EXPECT_THROW(dress({}, woman(), options()), Error);
}

TEST(Dress, SaysWhereAGarmentIsStuck) {
  Garment child = shipped("trousers");  // for somebody of half the size
  child.mesh.uv *= 0.5f;
  const Error error = test::error_of([&] { dress({child}, woman(), options()); });
  EXPECT_EQ(error.code(), ErrorCode::kFailedPrecondition);
  EXPECT_THAT(error.what(), testing::AllOf(HasSubstr("trousers: is stuck: near joint '"), HasSubstr("stretched by")));
}

}  // namespace
}  // namespace pleat::dress
