// Obstacles from the command line.
#include "services/presentation/input/obstacle_input.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

class ObstacleInputTest : public testing::Test {
 protected:
  void SetUp() override {
    for (const int k : {0, 1}) {
      std::ofstream(folder_ / ("body" + std::to_string(k) + ".obj"))
          << "v 0 " << k << " 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    }
  }

  const pleat::test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

TEST_F(ObstacleInputTest, ReadsSpheresWithNamesOfTheirOwn) {
  const ObstacleInput input({"sphere:0,-0.5,1e-1,0.25", "sphere:1,2,3,4"});
  ASSERT_EQ(input.shapes().size(), 2u);
  EXPECT_EQ(input.shapes()[0].name, "sphere");
  EXPECT_EQ(input.shapes()[1].name, "sphere2");
  const auto frame = input.at(7);
  EXPECT_EQ(frame[0].center, Eigen::Vector3f(0, -0.5f, 0.1f));
  EXPECT_EQ(frame[0].radius, 0.25f);
  EXPECT_EQ(frame[1].name, "sphere2");
}

TEST_F(ObstacleInputTest, ReadsCapsules) {
  const ObstacleInput input({"capsule:0,-0.5,1e-1,1,2,3,0.25"});
  ASSERT_EQ(input.shapes().size(), 1u);
  EXPECT_EQ(input.shapes()[0].name, "capsule");
  EXPECT_EQ(input.shapes()[0].capsules, 1u);
  const auto frame = input.at(3);
  ASSERT_EQ(frame[0].capsule_ends.rows(), 2);
  EXPECT_EQ(frame[0].capsule_ends.row(0), Eigen::RowVector3f(0, -0.5f, 0.1f));
  EXPECT_EQ(frame[0].capsule_ends.row(1), Eigen::RowVector3f(1, 2, 3));
  EXPECT_EQ(frame[0].capsule_radii, std::vector<float>{0.25f});
}

TEST_F(ObstacleInputTest, FilesInAnotherUnitAndAxisAreTurnedIntoOurs) {
  const std::string body = (folder_ / "body0.obj").string();
  const ObstacleInput input({body + "@" + (folder_ / "body*.obj").string(), "sphere:1,2,3,4"}, {0.01, true});
  // (0, 1, 0) and (0, 0, 1) of the file.
  EXPECT_EQ(input.at(0)[0].positions.row(2), Eigen::RowVector3f(0, 0, -0.01F));
  EXPECT_EQ(input.at(1)[0].positions.row(3), Eigen::RowVector3f(0, 0.01F, 0));
  EXPECT_EQ(input.at(1)[0].positions.row(0), Eigen::RowVector3f(0, 0, -0.01F)) << "moved";
  EXPECT_EQ(input.at(0)[1].center, Eigen::Vector3f(1, 2, 3)) << "metres as they are";
}

TEST_F(ObstacleInputTest, ReadsAMeshAtRestAndAMovedOne) {
  const std::string body = (folder_ / "body0.obj").string();
  const ObstacleInput input({body, body + "@" + (folder_ / "body*.obj").string()});
  EXPECT_EQ(input.shapes()[0].faces.rows(), 4);
  EXPECT_EQ(input.shapes()[1].name, "body02");
  EXPECT_EQ(input.at(1)[0].positions(0, 1), 0);
  EXPECT_EQ(input.at(0)[1].positions(0, 1), 0);
  EXPECT_EQ(input.at(1)[1].positions(0, 1), 1);
  EXPECT_EQ(input.at(9)[1].positions(0, 1), 1) << "the last frame stays";
}

TEST_F(ObstacleInputTest, NamesWhatIsWrong) {
  for (const char* text :
       {"sphere:", "sphere:1,2,3", "sphere:1,2,3,0", "sphere:1,2,3,-1", "sphere:1,2,3,4,5", "sphere:nan,0,0,1",
        "capsule:0,0,0,1", "capsule:0,0,0,1,1,1,0", "sphere:1 2 3 4", "none.obj"}) {
    try {
      const ObstacleInput input({text});
      ADD_FAILURE() << "accepted " << text;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr(text));
    }
  }
}

}  // namespace
}  // namespace pleat::presentation
