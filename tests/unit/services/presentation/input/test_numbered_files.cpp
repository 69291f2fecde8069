// Names of frames, one rule for folders, globs and patterns.
#include "services/presentation/input/numbered_files.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::presentation {
namespace {

using Names = std::vector<std::string>;

class NumberedFiles : public testing::Test {
 protected:
  void make(const Names& names) const {
    for (const std::string& name : names) std::ofstream(folder_.path() / name) << "v 0 0 0\n";
  }
  /// `spelling`: what comes after the folder.
  Names order(const std::string& spelling = "") const {
    Names names;
    for (const auto& file : numbered_files((folder_.path() / spelling).string())) names.push_back(file.filename());
    return names;
  }
  std::string cause(const std::string& spelling = "") const {
    try {
      order(spelling);
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  }

  const pleat::test::TemporaryFolder folder_;
};

TEST_F(NumberedFiles, ComeByValueNotByText) {
  const Names names{"take2-cloth_-01.obj", "take2-cloth_0.obj", "take2-cloth_1.ply", "take2-cloth_002.obj"};
  make({names[3], names[1], names[0]});
  EXPECT_EQ(cause(), "" + folder_.path().string() + "/: frame 1 is missing");
  make({"take2-cloth_1.obj"});
  const Names all{names[0], names[1], "take2-cloth_1.obj", names[3]};
  for (const char* spelling : {"", "take2*.obj", "take2-cloth_%d.obj", "take2-cloth_%04d.obj"}) {
    EXPECT_EQ(order(spelling), all) << spelling;
  }
}

TEST_F(NumberedFiles, AMinusAfterALetterOrDigitIsAHyphen) {
  make({"cloth-1.obj", "cloth-2.obj"});
  EXPECT_EQ(order(), (Names{"cloth-1.obj", "cloth-2.obj"}));
}

TEST_F(NumberedFiles, NumbersBeyondAllFramesAreNoSequence) {
  make({"c99999999999999999999998.obj", "c99999999999999999999999.obj"});
  EXPECT_THAT(cause("*.obj"), testing::HasSubstr("c99999999999999999999998.obj"));
}

TEST_F(NumberedFiles, FoldersMayHoldOtherFiles) {
  make({"c1.obj", "c2.obj", "c1.mtl", "notes.txt"});
  EXPECT_EQ(order().size(), 2u);
}

TEST_F(NumberedFiles, WhatIsNotThereIsNamed) {
  EXPECT_THAT(cause(), testing::HasSubstr("no .obj, .ply or other mesh file"));
  EXPECT_THAT(cause("*.obj"), testing::HasSubstr("no file matches"));
  EXPECT_THAT(cause("c%d.obj"), testing::HasSubstr("no file matches"));
  EXPECT_THAT(cause("c%d_%d.obj"), testing::HasSubstr("exactly one %d"));
  EXPECT_THAT(cause("c%s.obj"), testing::HasSubstr("exactly one %d"));
  EXPECT_THAT(cause("none"), testing::HasSubstr("no such file or folder"));
}

}  // namespace
}  // namespace pleat::presentation
