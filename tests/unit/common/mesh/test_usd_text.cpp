#include "common/mesh/usd_text.hpp"

#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

// As exporters write it: metadata of every kind around what matters.
constexpr const char* kStage = R"(#usda 1.0
(
    "a comment as documentation"
    doc = """three
lines ( with brackets [ and 'quotes'"""
    defaultPrim = "root"
    endTimeCode = 3
    metersPerUnit = 1
    startTimeCode = 1
    subLayers = [@./other.usda@]
    timeCodesPerSecond = 10
    upAxis = "Y"
)

class "_class_looks"
{
    def Mesh "never" { int[] faceVertexCounts = [3] }
}

def Xform "root" (
    assetInfo = { string name = "cloth" }
    prepend apiSchemas = ["MaterialBindingAPI"]
    customData = { dictionary Pleat = { int a = 1 } }
)
{
    custom string userProperties:blender:object_name = "Cloth; with } in it"
    double3 xformOp:translate = (0, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]

    def Mesh "cloth" (
        kind = "component"
    )
    {
        uniform bool doubleSided = 1
        float3[] extent = [(0, 0, 0), (1, 1, 0)]
        int[] faceVertexCounts = [4, 3]
        int[] faceVertexIndices = [0, 1, 2, 3, 2, 4, 3] # a square and a triangle on top
        rel material:binding = </root/_materials/Material>
        normal3f[] normals = [(0, 0, 1)] (
            interpolation = "constant"
        )
        point3f[] points.timeSamples = {
            1: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, 0)],
            2: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, -1e0)],
            3: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, 3)],
        }
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1), (7, 7)] (
            interpolation = "faceVarying"
        )
        int[] primvars:st:indices = [0, 1, 2, 3, 2, 4, 3]
        uniform token subdivisionScheme = "none"
        token visibility = "inherited"
    }

    def Mesh "hidden"
    {
        token visibility = "invisible"
        int[] faceVertexCounts = [3]
    }
    variantSet "look" = {
        "red" { color3f[] primvars:displayColor = [(1, 0, 0)] }
    }
}
)";

class UsdText : public testing::Test {
 protected:
  std::unique_ptr<AnimatedMesh> open(const std::string& text) const {
    std::ofstream(folder_.path() / "stage.usda") << text;
    return open_usd_text(folder_.path() / "stage.usda");
  }
  static std::string with(std::string from, const std::string& to) {
    std::string text = kStage;
    const auto place = text.find(from);
    EXPECT_NE(place, std::string::npos) << from;
    return text.replace(place, from.size(), to);
  }
  void expect_refused(const std::string& text, const std::string& cause) const {
    const Error error = test::error_of([&] {
      const auto mesh = open(text);
      for (std::size_t k = 0; k < mesh->frame_count(); ++k) mesh->positions(k);
    });
    EXPECT_NE(error.code(), ErrorCode::kInternal);
    EXPECT_NE(std::string(error.what()).find(cause), std::string::npos) << error.what();
  }

  const test::TemporaryFolder folder_;
};

TEST_F(UsdText, AMeshWithSamplesIsItsFrames) {
  const auto mesh = open(kStage);
  ASSERT_EQ(mesh->frame_count(), 3u);
  EXPECT_DOUBLE_EQ(mesh->frame_time_s(), 0.1);
  EXPECT_EQ(mesh->positions(0).row(4), Eigen::RowVector3f(0.5F, 2, 0));
  EXPECT_EQ(mesh->positions(1).row(4), Eigen::RowVector3f(0.5F, 2, -1));
  EXPECT_EQ(mesh->positions(2).row(4), Eigen::RowVector3f(0.5F, 2, 3));
  const Topology topology = to_topology(mesh->mesh(), "stage", MeshUse::kGarment);
  EXPECT_EQ(topology.vertex_count(), 5);
  EXPECT_EQ(topology.face_count(), 3) << "the square is two";
  EXPECT_EQ(topology.uv.row(topology.uv_faces(2, 1)), Eigen::RowVector2f(7, 7));
}

TEST_F(UsdText, TheStagesUnitAndAxisAreTurnedIntoOurs) {
  std::string text = with("metersPerUnit = 1", "");
  const std::string axis = "upAxis = \"Y\"";
  text.replace(text.find(axis), axis.size(), "upAxis = \"Z\"");
  EXPECT_LT((open(text)->positions(2).row(4) - Eigen::RowVector3f(0.005F, 0.03F, -0.02F)).cwiseAbs().maxCoeff(), 1e-8F)
      << "centimetres where nothing is said";
}

TEST_F(UsdText, PrimsAbovePlaceAMesh) {
  const std::string text =
      with("uniform token[] xformOpOrder = [\"xformOp:translate\"]",
           "float3 xformOp:rotateXYZ = (90, 0, 90)\n float3 xformOp:scale = (2, 2, 2)\n uniform token[] xformOpOrder = "
           "[\"xformOp:translate\", \"xformOp:rotateXYZ\", \"xformOp:scale\"]");
  // (x, y, z) doubled, then about x: (x, -z, y), then about z: (z, x, y).
  EXPECT_LT((open(text)->positions(2).row(4) - Eigen::RowVector3f(6, 1, 4)).cwiseAbs().maxCoeff(), 1e-5F);
  const std::string matrix =
      with("uniform token[] xformOpOrder = [\"xformOp:translate\"]",
           "matrix4d xformOp:transform = ( (0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (5, 6, 7, 1) )\n uniform token[] "
           "xformOpOrder = [\"xformOp:transform\"]");
  EXPECT_LT((open(matrix)->positions(2).row(4) - Eigen::RowVector3f(3, 6.5F, 10)).cwiseAbs().maxCoeff(), 1e-5F);
}

TEST_F(UsdText, GapsBetweenSamplesAreInterpolated) {
  const std::string text = with("2: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, -1e0)],",
                                "1.5: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, 1.5)],");
  const auto mesh = open(text);
  ASSERT_EQ(mesh->frame_count(), 5u) << "1, 1.5, 2, 2.5, 3";
  EXPECT_NEAR(mesh->positions(2)(4, 2), 2.0F, 1e-6F);
  EXPECT_NEAR(mesh->positions(4)(4, 2), 3.0F, 1e-6F);
}

TEST_F(UsdText, CoordinatesByVertexAreRead) {
  const std::string text = with("interpolation = \"faceVarying\"", "interpolation = \"vertex\"");
  std::string plain = text;
  const std::string indices = "int[] primvars:st:indices = [0, 1, 2, 3, 2, 4, 3]";
  plain.erase(plain.find(indices), indices.size());
  const Topology topology = to_topology(open(plain)->mesh(), "stage", MeshUse::kGarment);
  EXPECT_EQ(topology.uv_faces, topology.faces);
}

TEST_F(UsdText, ALeftHandedMeshIsTurnedOver) {
  const std::string text = with("uniform bool doubleSided = 1", "uniform token orientation = \"leftHanded\"");
  const PolygonMesh mesh = open(text)->mesh();
  EXPECT_EQ(mesh.corners[0].vertex, 3u);
  EXPECT_EQ(mesh.corners[1].vertex, 2u);
}

TEST_F(UsdText, WhatItDoesNotReadIsNamed) {
  expect_refused("PXR-USDC\1\2\3", "binary");
  expect_refused("v 1 2 3", "#usda");
  expect_refused("#usda 1.0\ndef Xform \"a\" { }", "no Mesh");
  expect_refused(
      with("double3 xformOp:translate = (0, 0, 0)", "double3 xformOp:translate.timeSamples = { 1: (0, 0, 0) }"),
      "animated as a whole");
  expect_refused(with("0, 1, 2, 3, 2, 4, 3] #", "0, 1, 2, 3, 2, 9, 3] #"), "point 9 of 5");
  expect_refused(with("[4, 3]", "[4, 4]"), "corners");
  expect_refused(with("(0.5, 2, 3)", "(0.5, 2)"), "threes");
  expect_refused(with("(0.5, 2, 3)", "(0.5, 2, nan)"), "finite");
  expect_refused(with("(0.5, 2, 3)],", "(0.5, 2, 3)"), "stage.usda:");
  expect_refused(with("3: [", "2.7: ["), "evenly");
  expect_refused("#usda 1.0\ndef Mesh \"a\" {", "ends too early");
}

}  // namespace
}  // namespace pleat
