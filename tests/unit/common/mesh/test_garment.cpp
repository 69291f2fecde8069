// Inputs that fit in size only are refused, in words that name the likely cause.
#include "common/mesh/garment.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/error.hpp"

namespace pleat {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

const std::filesystem::path kCases = "tests/cases";

std::string cause_of(const std::function<void()>& body) {
  try {
    body();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    return error.what();
  }
  return "";
}

TEST(Garment, AnotherUnitIsNoticed) {
  std::vector<std::string> notes;
  const Topology centimetres = read_garment(kCases / "11-garment-centimetres" / "skirt-cm.obj", notes);
  EXPECT_THAT(notes, ElementsAre(testing::AllOf(HasSubstr("m large"), HasSubstr("--scale 0.01"))));
  EXPECT_NO_THROW(require_rest_lengths(centimetres, "skirt"));
  notes.clear();
  const Topology metres = read_garment(kCases / "11-garment-centimetres" / "skirt-cm.obj", notes, 0.01);
  EXPECT_TRUE(notes.empty());
  EXPECT_NEAR(material_ratios(metres).median, material_ratios(centimetres).median, 1e-3);
  EXPECT_FLOAT_EQ(100 * metres.uv(3, 0), centimetres.uv(3, 0));

  const Topology mixed = read_garment(kCases / "11-garment-centimetres" / "skirt-mm-uv-m.obj", notes);
  EXPECT_THAT(cause_of([&] { require_rest_lengths(mixed, "skirt.obj"); }), HasSubstr("times as long in space"));
  notes.clear();
  const Topology scaled = read_garment(kCases / "11-garment-centimetres" / "skirt-mm-uv-m.obj", notes, 0.001);
  EXPECT_NO_THROW(require_rest_lengths(scaled, "skirt.obj"));
  EXPECT_TRUE(notes.empty());
}

TEST(Garment, FramesOfAnotherMeshAreNoticed) {
  std::vector<std::string> notes;
  const Topology rest = read_garment("deploy/garments/tablecloth.obj", notes);
  EXPECT_TRUE(notes.empty());
  const auto cause = [&](const Positions& frame) {
    return cause_of([&] { require_frame_of(frame, rest, "frame 0", "tablecloth.obj"); });
  };
  Positions moved = rest.rest_positions;
  moved.rowwise() += Eigen::RowVector3f(1, 2, 3);
  EXPECT_EQ(cause(moved), "");
  EXPECT_EQ(cause(1.5f * moved), "");
  EXPECT_THAT(cause(100 * rest.rest_positions), HasSubstr("are both in metres?"));
  EXPECT_THAT(cause(0.001f * rest.rest_positions), HasSubstr("are both in metres?"));
  EXPECT_THAT(cause(rest.rest_positions.colwise().reverse().eval().cwiseProduct(rest.rest_positions)),
              testing::Not(""));
  Positions shuffled = rest.rest_positions;
  for (Eigen::Index v = 0; v < shuffled.rows(); ++v)
    shuffled.row(v) = rest.rest_positions.row(v * 263 % shuffled.rows());
  EXPECT_THAT(cause(shuffled), HasSubstr("is the vertex order that of tablecloth.obj?"));
}

}  // namespace
}  // namespace pleat
