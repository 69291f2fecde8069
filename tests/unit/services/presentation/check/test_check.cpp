// Findings about files as people have them.
#include "services/presentation/check/check.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace pleat::presentation {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

const std::string kCases = "tests/cases/";

TEST(Check, AGoodGarmentHasFactsOnly) {
  const Findings findings = check_file("deploy/garments/skirt.obj");
  EXPECT_THAT(findings.faults, IsEmpty());
  EXPECT_THAT(findings.notes, IsEmpty());
  EXPECT_THAT(findings.facts, Contains(HasSubstr("1 pieces")));
  const Findings shirt = check_file(kCases + "25-shirt-with-button/shirt-button.obj");
  EXPECT_THAT(shirt.facts, Contains(HasSubstr("edges on seams, smallest island")));
}

TEST(Check, UnitsAndLayoutsAreNamedWithWhatMendsThem) {
  EXPECT_THAT(check_file(kCases + "11-garment-centimetres/skirt-cm.obj").notes, Contains(HasSubstr("--scale 0.01")));
  EXPECT_THAT(check_file(kCases + "11-garment-centimetres/skirt-cm.obj", {.rest = "", .scale = 0.01}).notes, IsEmpty());
  EXPECT_THAT(check_file(kCases + "11-garment-centimetres/skirt-mm-uv-m.obj").faults,
              Contains(HasSubstr("times as long in space")));
  EXPECT_THAT(check_file(kCases + "09-garment-mirrored-panel/skirt.obj").notes, ElementsAre(HasSubstr("mirrored")));
}

TEST(Check, AnObstacleNeedsNoMaterialCoordinates) {
  const Findings findings = check_file(kCases + "18-body-mesh-with-holes/open-neck.obj");
  EXPECT_THAT(findings.faults, IsEmpty());
  EXPECT_THAT(findings.notes, ElementsAre(HasSubstr("hole")));
}

TEST(Check, FramesAreHeldAgainstTheirMesh) {
  const std::string folder = kCases + "14-pc2-other-vertex-order/";
  const CheckOptions options{.rest = folder + "garment.obj"};
  EXPECT_THAT(check_file(folder + "right.pc2", options).faults, IsEmpty());
  EXPECT_THAT(check_file(folder + "shuffled.pc2", options).faults, ElementsAre(HasSubstr("vertex order")));
  EXPECT_THAT(check_file(kCases + "34-mdd-and-big-endian-caches/cut-short.pc2").faults, ElementsAre(testing::_));
}

TEST(Check, ScenesAreReadWithAllTheyName) {
  const std::string folder = kCases + "28-placeholder-files-and-materials/";
  EXPECT_THAT(check_file(folder + "scene-comments.json").faults, IsEmpty());
  EXPECT_THAT(check_file(folder + "scene-pointer.json").faults,
              ElementsAre(AllOf(HasSubstr("material-pointer.json"), HasSubstr("placeholder"))));
}

TEST(Check, WhatIsNotThereIsAFault) {
  EXPECT_THAT(check_file("no/such/file.obj").faults, ElementsAre(HasSubstr("no/such/file.obj")));
}

}  // namespace
}  // namespace pleat::presentation
