#include "services/coordinator/pipeline_session.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "common/frame/messages.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/fake_stages.hpp"

namespace pleat::coordinator {
namespace {

using ::testing::HasSubstr;

v1::ModelDescription model_of(const Topology& mesh) {
  v1::ModelDescription model;
  model.set_model("mine");
  model.set_topology_hash(topology_hash(mesh));
  model.mutable_rest_positions()->Assign(mesh.rest_positions.data(),
                                         mesh.rest_positions.data() + mesh.rest_positions.size());
  return model;
}

Topology moved(Topology mesh) {
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(2.0F, Eigen::Vector3f(1, 2, -0.5F).normalized()).toRotationMatrix();
  mesh.rest_positions =
      Positions((mesh.rest_positions * turn.transpose()).rowwise() + Eigen::RowVector3f(3, -0.25F, 1));
  return mesh;
}

TEST(CoarseForNetwork, TheBundlesOwnMeshAndAnyMeshNeedNone) {
  const Topology mesh = testing::sheet();
  EXPECT_FALSE(coarse_for_network(model_of(mesh), mesh));
  EXPECT_FALSE(coarse_for_network({}, mesh));
}

TEST(CoarseForNetwork, AMeshThatWasMovedAndTurnedIsTheBundles) {
  const Topology mesh = testing::sheet();
  const auto known = coarse_for_network(model_of(mesh), moved(mesh));
  ASSERT_TRUE(known);
  EXPECT_EQ(known->hash(), topology_hash(mesh));
  EXPECT_EQ(from_message(*known).rest_positions, mesh.rest_positions);
}

TEST(CoarseForNetwork, AnotherShapeOrAnotherMeshIsRefused) {
  const Topology mesh = testing::sheet();
  const auto refusal = [&](const v1::ModelDescription& model, const Topology& other) {
    const Error error = test::error_of([&] { coarse_for_network(model, other); });
    EXPECT_EQ(error.code(), ErrorCode::kFailedPrecondition);
    EXPECT_THAT(error.what(), HasSubstr(topology_hash(other)));
    return std::string(error.what());
  };
  Topology bent = moved(mesh);
  bent.rest_positions(0, 1) += 0.01F;
  EXPECT_THAT(refusal(model_of(mesh), bent), HasSubstr("another shape"));
  Topology larger = mesh;
  larger.rest_positions *= 1.01F;
  EXPECT_THAT(refusal(model_of(mesh), larger), HasSubstr("another shape"));
  Topology stretched = moved(mesh);
  stretched.uv *= 1.01F;
  refusal(model_of(mesh), stretched);
  v1::ModelDescription silent = model_of(mesh);
  silent.clear_rest_positions();
  refusal(silent, moved(mesh));
}

}  // namespace
}  // namespace pleat::coordinator
