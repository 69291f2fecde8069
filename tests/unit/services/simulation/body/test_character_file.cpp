#include "services/simulation/body/character_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "services/simulation/body/acclaim.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/simulation/body/figures.hpp"
#include "tests/unit/services/simulation/body/gltf_writer.hpp"

namespace pleat::body {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

/// A tube that stands: its joints hips and head, 2 m tall.
SkinnedMesh standing_tube() {
  SkinnedMesh body = tube();
  const Eigen::Quaterniond upright = turn(90, Vector3d::UnitZ());
  body.skeleton.joints[0] = {"Hips", -1, {0, 0.1, 0}, upright};
  body.skeleton.joints[1] = {"Head", 0, {0.9, 0, 0}, Eigen::Quaterniond::Identity()};
  for (Eigen::Index v = 0; v < body.mesh.vertex_count(); ++v) {
    const Vector3d x = upright * body.mesh.rest_positions.row(v).transpose().cast<double>();
    body.mesh.rest_positions.row(v) = x.cast<float>().transpose();
  }
  return body;
}

class CharacterFiles : public testing::Test {
 protected:
  fs::path write(const SkinnedMesh& body, const Motion* motion, const GltfOptions& options = {}) const {
    const fs::path path = folder_.path() / "a.gltf";
    GltfWriter(body, motion, options).write(path);
    return path;
  }
  fs::path write_text(const std::string& name, const std::string& text) const {
    std::ofstream(folder_.path() / name) << text;
    return folder_.path() / name;
  }
  std::string fault(const fs::path& path) const {
    const std::string message = message_of([&] { read_character_file(path); });
    const std::string folder = folder_.path().string() + "/";
    return message.starts_with(folder) ? message.substr(folder.size()) : message;
  }
  test::TemporaryFolder folder_;
};

/// Vertices and joints of the file are where ours are, at rest and in every frame.
void expect_same(const CharacterFile& file, const SkinnedMesh& body, const Motion& motion) {
  ASSERT_TRUE(file.body);
  ASSERT_EQ(file.body->mesh.vertex_count(), body.mesh.vertex_count());
  EXPECT_LT((file.body->mesh.rest_positions - body.mesh.rest_positions).cwiseAbs().maxCoeff(), 1e-5F);
  ASSERT_EQ(file.motions.size(), 1U);
  ASSERT_EQ(file.motions[0].frames.size(), motion.frames.size());
  EXPECT_NEAR(file.motions[0].frame_time_s, motion.frame_time_s, 1e-6);
  for (std::size_t k = 0; k < motion.frames.size(); ++k) {
    const Positions ours = skin(body, world_transforms(body.skeleton, motion.frames[k]), Skinning::kLinear);
    const auto world = world_transforms(file.body->skeleton, file.motions[0].frames[k]);
    const Positions theirs = skin(*file.body, world, Skinning::kLinear);
    EXPECT_LT((ours - theirs).cwiseAbs().maxCoeff(), 2e-5F) << "frame " << k;
  }
}

TEST_F(CharacterFiles, AGltfGivesMeshSkeletonAndMotion) {
  const SkinnedMesh body = standing_tube();
  const Motion motion = wild_motion(body.skeleton, 9);
  const CharacterFile file = read_character_file(write(body, &motion));
  expect_same(file, body, motion);
  EXPECT_TRUE(file.notes.empty());
  EXPECT_EQ(file.body->skeleton.joints[1].name, "Head");
}

TEST_F(CharacterFiles, ScaledNodesAboveTheJointsAreApplied) {
  const SkinnedMesh body = standing_tube();
  const Motion motion = wild_motion(body.skeleton, 9);
  GltfOptions options;
  options.parent = "Armature";
  expect_same(read_character_file(write(body, &motion, options)), body, motion);
}

TEST_F(CharacterFiles, VerticesThatAnExporterSplitBecomeOneAgain) {
  const SkinnedMesh body = standing_tube();
  GltfOptions options;
  options.split = true;
  const CharacterFile file = read_character_file(write(body, nullptr, options));
  EXPECT_EQ(file.body->mesh.vertex_count(), body.mesh.vertex_count());
  EXPECT_EQ(file.body->mesh.face_count(), body.mesh.face_count());
}

TEST_F(CharacterFiles, CentimetresAreRecognisedAndSaid) {
  const SkinnedMesh body = standing_tube();
  const Motion motion = wild_motion(body.skeleton, 4);
  GltfOptions options;
  options.unit = 0.01;
  const CharacterFile file = read_character_file(write(body, &motion, options));
  expect_same(file, body, motion);
  EXPECT_THAT(file.notes, testing::ElementsAre("a body 200 units tall is read as centimetres"));
  options.unit = 0.07;
  EXPECT_EQ(fault(write(body, nullptr, options)), "a.gltf: a body 28.6 m tall is neither in metres nor in centimetres");
}

TEST_F(CharacterFiles, ZUpIsTurnedAndSaid) {
  SkinnedMesh body = standing_tube();
  const SkinnedMesh upright = body;
  const Eigen::Quaterniond z_up = turn(90, Vector3d::UnitX());
  body.skeleton.joints[0].translation = z_up * body.skeleton.joints[0].translation;
  body.skeleton.joints[0].rotation = z_up * body.skeleton.joints[0].rotation;
  body.mesh.rest_positions = (body.mesh.rest_positions * z_up.cast<float>().toRotationMatrix().transpose()).eval();
  const CharacterFile file = read_character_file(write(body, nullptr));
  EXPECT_THAT(file.notes, testing::ElementsAre("Z is up: turned"));
  EXPECT_LT((file.body->mesh.rest_positions - upright.mesh.rest_positions).cwiseAbs().maxCoeff(), 1e-5F);
}

TEST_F(CharacterFiles, BadCharactersAreOneClearLine) {
  SkinnedMesh body = standing_tube();
  GltfOptions options;
  options.weights = false;
  EXPECT_THAT(fault(write(body, nullptr, options)),
              testing::EndsWith("follows no skeleton: it has no skinning weights"));
  const SkinnedMesh whole = body;
  body.weights.row(5).setZero();
  EXPECT_THAT(fault(write(body, nullptr)),
              testing::EndsWith("1 vertices have no skinning weights, the first is vertex 5"));
  body.weights.row(5).setConstant(7);
  EXPECT_THAT(fault(write(body, nullptr)), testing::HasSubstr("vertex 5: its skinning weights sum to 28"));
  body = whole;
  body.mesh.rest_positions(3, 1) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(fault(write(body, nullptr)), testing::EndsWith("vertex 3 is not finite"));
  EXPECT_EQ(fault(folder_.path() / "none.glb"), "none.glb: no such file");
  EXPECT_THAT(fault(write_text("b.dae", "nothing")), testing::StartsWith("b.dae: can't be read: "));
  EXPECT_THAT(fault(write_text("b.fbx", "nothing")), testing::StartsWith("b.fbx: can't be read: "));
  Motion motion = wild_motion(whole.skeleton, 5);
  motion.frames[3].rotations[1].x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(fault(write(whole, &motion)), testing::HasSubstr("joint 'Head' is not finite"));
}

constexpr const char* kBvh = R"(HIERARCHY
ROOT root
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT lhumerus
  {
    OFFSET 0.2 0.4 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    JOINT lradius
    {
      OFFSET 0.3 0 0
      CHANNELS 3 Zrotation Yrotation Xrotation
      End Site
      {
        OFFSET 0.25 0 0
      }
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.008333333
0 1 0 0 0 0 0 0 0 0 0 0
0.1 1.1 0.2 30 20 10 -40 15 25 -70 0 0
0.2 1.2 0.4 31 21 11 -41 16 26 -71 0 0
)";
constexpr const char* kAsf = R"(:units
  length 0.0254
  angle deg
:root
  order TX TY TZ RX RY RZ
:bonedata
  begin
    name lclavicle
    direction 1 2 0
    length 0.4472135955
    axis 0 0 0 XYZ
  end
  begin
    name lhumerus
    direction 1 0 0
    length 0.3
    axis 0 0 0 XYZ
    dof rx ry rz
  end
  begin
    name lradius
    direction 1 0 0
    length 0.25
    axis 0 0 0 XYZ
    dof rx ry rz
  end
:hierarchy
  begin
    root lclavicle
    lclavicle lhumerus
    lhumerus lradius
  end
)";
constexpr const char* kAmc = R"(1
root 0 1 0 0 0 0
2
root 0.1 1.1 0.2 10 20 30
lhumerus 25 15 -40
lradius 0 0 -70
3
root 0.2 1.2 0.4 11 21 31
lhumerus 26 16 -41
lradius 0 0 -71
)";

TEST_F(CharacterFiles, ABvhMovesAsTheAsfAndAmcOfTheSameMotion) {
  std::vector<std::string> notes;
  const Motion bvh = read_motion(write_text("a.bvh", kBvh), notes);
  EXPECT_TRUE(notes.empty());
  write_text("a.asf", kAsf);
  const Motion amc = read_motion(write_text("a.amc", kAmc), notes);
  EXPECT_THAT(notes, testing::ElementsAre(testing::HasSubstr("120 frames a second")));
  ASSERT_EQ(bvh.frames.size(), amc.frames.size());
  EXPECT_NEAR(bvh.frame_time_s, amc.frame_time_s, 1e-6);
  for (std::size_t k = 0; k < amc.frames.size(); ++k) {
    const auto a = world_transforms(bvh.skeleton, bvh.frames[k]), b = world_transforms(amc.skeleton, amc.frames[k]);
    for (const char* name : {"root", "lhumerus", "lradius"}) {
      const RigidTransform& x = a[static_cast<std::size_t>(bvh.skeleton.find(name))];
      const RigidTransform& y = b[static_cast<std::size_t>(amc.skeleton.find(name))];
      EXPECT_LT((x.translation - y.translation).norm(), 1e-5) << name << " in frame " << k;
      EXPECT_LT(x.rotation.angularDistance(y.rotation), 1e-5) << name << " in frame " << k;
    }
  }
}

TEST_F(CharacterFiles, AnAmcWithoutItsSkeletonSaysSo) {
  std::vector<std::string> notes;
  const fs::path amc = write_text("walk.amc", kAmc);
  EXPECT_THAT(message_of([&] { read_motion(amc, notes); }),
              testing::HasSubstr("walk.asf does not exist (--asf names another)"));
  write_text("other.asf", kAsf);
  EXPECT_EQ(read_motion(amc, notes).frames.size(), 3U);  // the only one beside it
}

}  // namespace
}  // namespace pleat::body
