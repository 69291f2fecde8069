#include "common/mesh/fbx.hpp"

#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

// Text FBX, Z up, in metres: a square and a triangle with a blend shape over three frames, 10 above the ground.
constexpr const char* kScene = R"(; FBX 7.4.0 project file
FBXHeaderExtension:  {
 FBXHeaderVersion: 1003
 FBXVersion: 7400
}
GlobalSettings:  {
 Version: 1000
 Properties70:  {
  P: "UpAxis", "int", "Integer", "",2
  P: "UpAxisSign", "int", "Integer", "",1
  P: "FrontAxis", "int", "Integer", "",1
  P: "FrontAxisSign", "int", "Integer", "",-1
  P: "CoordAxis", "int", "Integer", "",0
  P: "CoordAxisSign", "int", "Integer", "",1
  P: "UnitScaleFactor", "double", "Number", "",100
  P: "TimeMode", "enum", "", "",11
 }
}
Objects:  {
 Geometry: 1, "Geometry::cloth", "Mesh" {
  Vertices: *15 {
   a: 0,0,0,1,0,0,1,1,0,0,1,0,0.5,2,0
  }
  PolygonVertexIndex: *7 {
   a: 0,1,2,-4,3,2,-5
  }
  GeometryVersion: 124
  LayerElementUV: 0 {
   Version: 101
   Name: "UVMap"
   MappingInformationType: "ByPolygonVertex"
   ReferenceInformationType: "IndexToDirect"
   UV: *10 {
    a: 0,0,1,0,1,1,0,1,7,7
   }
   UVIndex: *7 {
    a: 0,1,2,3,3,2,4
   }
  }
  Layer: 0 {
   Version: 100
   LayerElement:  {
    Type: "LayerElementUV"
    TypedIndex: 0
   }
  }
 }
 Model: 2, "Model::cloth", "Mesh" {
  Version: 232
  Properties70:  {
   P: "Lcl Translation", "Lcl Translation", "", "A",0,0,10
  }
 }
 Deformer: 3, "Deformer::shapes", "BlendShape" {
  Version: 100
 }
 Deformer: 4, "SubDeformer::up", "BlendShapeChannel" {
  Version: 100
  DeformPercent: 0
  FullWeights: *1 {
   a: 100
  }
 }
 Geometry: 5, "Geometry::up", "Shape" {
  Version: 100
  Indexes: *1 {
   a: 4
  }
  Vertices: *3 {
   a: 0,0,1
  }
  Normals: *3 {
   a: 0,0,0
  }
 }
 AnimationStack: 6, "AnimStack::take", "" {
  Properties70:  {
   P: "LocalStop", "KTime", "Time", "",46186158000
   P: "ReferenceStop", "KTime", "Time", "",46186158000
  }
 }
 AnimationLayer: 7, "AnimLayer::base", "" {
 }
 AnimationCurveNode: 8, "AnimCurveNode::DeformPercent", "" {
  Properties70:  {
   P: "d|DeformPercent", "Number", "", "A",0
  }
 }
 AnimationCurve: 9, "AnimCurve::", "" {
  Default: 0
  KeyVer: 4009
  KeyTime: *3 {
   a: 0,1924423250,3848846500
  }
  KeyValueFloat: *3 {
   a: 0,50,100
  }
 }
}
Connections:  {
 C: "OO",2,0
 C: "OO",1,2
 C: "OO",3,1
 C: "OO",4,3
 C: "OO",5,4
 C: "OO",7,6
 C: "OO",8,7
 C: "OP",8,4, "DeformPercent"
 C: "OP",9,8, "d|DeformPercent"
}
)";

class Fbx : public testing::Test {
 protected:
  std::unique_ptr<AnimatedMesh> open(const std::string& text) const {
    std::ofstream(folder_.path() / "cloth.fbx") << text;
    return open_fbx(folder_.path() / "cloth.fbx");
  }
  static std::string with(const std::string& from, const std::string& to) {
    std::string text = kScene;
    const auto place = text.find(from);
    EXPECT_NE(place, std::string::npos) << from;
    return text.replace(place, from.size(), to);
  }
  void expect_refused(const std::string& text, const std::string& cause) const {
    const Error error = test::error_of([&] { to_topology(open(text)->mesh(), "cloth.fbx", MeshUse::kGarment); });
    EXPECT_NE(error.code(), ErrorCode::kInternal);
    EXPECT_NE(std::string(error.what()).find(cause), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("cloth.fbx"), std::string::npos) << error.what();
  }

  const test::TemporaryFolder folder_;
};

TEST_F(Fbx, BlendShapesAreFramesInMetresWithYUp) {
  const auto mesh = open(kScene);
  ASSERT_EQ(mesh->frame_count(), 3u);
  EXPECT_NEAR(mesh->frame_time_s(), 1.0 / 24, 1e-6);
  for (int t = 0; t < 3; ++t) {
    const Positions positions = mesh->positions(static_cast<std::size_t>(t));
    ASSERT_EQ(positions.rows(), 5) << "corners at one place are one vertex";
    // (0.5, 2, height) with Z up is (0.5, height, -2).
    EXPECT_LT((positions.row(4) - Eigen::RowVector3f(0.5F, 10 + 0.5F * static_cast<float>(t), -2)).norm(), 1e-5F) << t;
    EXPECT_LT((positions.row(1) - Eigen::RowVector3f(1, 10, 0)).norm(), 1e-5F);
  }
  const Topology topology = to_topology(mesh->mesh(), "cloth", MeshUse::kGarment);
  Faces faces(3, 3);
  faces << 0, 1, 2, 0, 2, 3, 3, 2, 4;
  EXPECT_EQ(topology.faces, faces);
  EXPECT_EQ(topology.uv.rows(), 5) << "one island";
  EXPECT_EQ(topology.uv.row(topology.uv_faces(2, 2)), Eigen::RowVector2f(7, 7));
}

TEST_F(Fbx, ItsUnitIsRead) {
  const auto mesh = open(with("\"UnitScaleFactor\", \"double\", \"Number\", \"\",100",
                              "\"UnitScaleFactor\", \"double\", \"Number\", \"\",1"));
  EXPECT_LT((mesh->positions(0).row(1) - Eigen::RowVector3f(0.01F, 0.1F, 0)).norm(), 1e-6F) << "centimetres";
}

TEST_F(Fbx, FramesAreMatchedByPolygonsHoweverVerticesAreNumbered) {
  Topology rest;
  rest.rest_positions.setZero(5, 3);
  rest.faces.resize(3, 3);
  rest.faces << 4, 3, 2, 4, 2, 1, 1, 2, 0;  // theirs, numbered backwards
  open(kScene);
  const MatchedFrames frames(folder_.path() / "cloth.fbx", rest);
  EXPECT_NEAR(frames.positions(2)(0, 1), 11, 1e-5F);
}

TEST_F(Fbx, WhatItDoesNotReadIsNamed) {
  expect_refused("not FBX at all", "can't be read");
  expect_refused("", "can't be read");
  expect_refused(with("C: \"OO\",1,2", ""), "no mesh");
  EXPECT_EQ(test::error_of([&] { open_fbx(folder_.path() / "none.fbx"); }).code(), ErrorCode::kNotFound);
  const std::string text = kScene;
  for (std::size_t length = 0; length < text.size(); length += 97) {
    try {
      open(text.substr(0, length));
    } catch (const Error& error) {
      EXPECT_NE(error.code(), ErrorCode::kInternal) << error.what();
    }
  }
}

}  // namespace
}  // namespace pleat
