#include "services/refinement/refiner.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <limits>

#include "common/base/error.hpp"
#include "services/refinement/judge.hpp"
#include "tests/unit/services/refinement/independent_judge.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
namespace {

using test::Cloth;
using test::load_cloth;

void expect_clean(const RefinedMesh& result, const Faces& faces) {
  EXPECT_TRUE(result.report.clean()) << result.report.pairs_after << " pairs, " << result.report.penetrations_after
                                     << " penetrations";
  EXPECT_TRUE(result.positions.allFinite());
  EXPECT_EQ(test::sweep_self_intersections(result.positions, faces).size(), 0u);
}

class Adversarial : public testing::TestWithParam<const char*> {
 protected:
  Adversarial()
      : cloth(load_cloth(GetParam())),
        coarse(test::wavy(cloth.coarse.rest_positions)),
        upsampled(upsample(cloth.subdivision, cloth.coarse.faces, coarse)),
        refiner(cloth.coarse, cloth.subdivision, {}) {}
  Cloth cloth;
  Positions coarse, upsampled;
  Refiner refiner;
};
INSTANTIATE_TEST_SUITE_P(All, Adversarial, testing::Values("tablecloth", "skirt"));

TEST_P(Adversarial, ACleanFrameStaysAsItIs) {
  const RefinedMesh result = refiner.refine(coarse, upsampled, {});
  EXPECT_EQ(result.positions, upsampled);
  EXPECT_EQ(result.report.vertices_moved, 0u);
  EXPECT_EQ(result.report.zones, 0u);
  EXPECT_FALSE(result.report.input_intersects);
}

TEST_P(Adversarial, SmallNoiseIsRepairedInZones) {
  const Positions fine = upsampled + test::noise(upsampled.rows(), 0.003f, 1);
  const RefinedMesh result = refiner.refine(coarse, fine, {});
  EXPECT_GT(result.report.pairs_before, 0u);
  EXPECT_GT(result.report.zones, 0u);
  expect_clean(result, cloth.fine().faces);
  EXPECT_LT(result.report.largest_move_m, 0.02);
}

TEST_P(Adversarial, NoiseOfFiveCentimetres) {
  const Positions fine = upsampled + test::noise(upsampled.rows(), 0.05f, 2);
  const RefinedMesh result = refiner.refine(coarse, fine, {});
  EXPECT_GT(result.report.pairs_before, 1000u);
  expect_clean(result, cloth.fine().faces);
}

TEST_P(Adversarial, TheReflectedMesh) {
  Positions fine = upsampled;
  fine.col(0) *= -1;
  expect_clean(refiner.refine(coarse, fine, {}), cloth.fine().faces);
  fine = upsampled;
  fine.col(1) = 0.3f * fine.col(0);
  expect_clean(refiner.refine(coarse, fine, {}), cloth.fine().faces);
}

TEST_P(Adversarial, AllVerticesInOnePoint) {
  const Positions fine = Eigen::RowVector3f(0.1f, 0.2f, 0.3f).replicate(upsampled.rows(), 1);
  expect_clean(refiner.refine(coarse, fine, {}), cloth.fine().faces);
}

TEST_P(Adversarial, FarAwayVertices) {
  Positions fine = upsampled;
  fine.row(17) << 1000, 1000, 1000;
  fine.row(4711) << -1e6f, 0, 3;
  expect_clean(refiner.refine(coarse, fine, {}), cloth.fine().faces);
}

// A ball that touches the coarse cloth from outside at one of its vertices.
struct Ball {
  Eigen::Vector3f touch, normal, center;
  float radius = 0.3f;
};
Ball ball_beside(const Positions& coarse, const Faces& faces) {
  Ball ball;
  ball.touch = coarse.row(300);
  ball.normal = vertex_normals(coarse, faces).row(300);
  ball.center = ball.touch + (ball.radius + 0.025f) * ball.normal;
  return ball;
}

TEST_P(Adversarial, ASphereThatOverlapsTheFineMesh) {
  const Ball ball = ball_beside(coarse, cloth.coarse.faces);
  const std::vector<ObstacleFrame> obstacles{test::sphere("ball", ball.center, ball.radius)};
  ASSERT_EQ(count_penetrations(coarse, cloth.coarse.faces, {}, obstacles), 0u);
  Positions fine = upsampled;
  for (Eigen::Index v = 0; v < fine.rows(); ++v) {
    fine.row(v) +=
        0.06f * std::exp(-50 * (fine.row(v).transpose() - ball.touch).squaredNorm()) * ball.normal.transpose();
  }
  EXPECT_GT(test::sphere_depth(fine, cloth.fine().faces, ball.center, ball.radius), 0.02);
  const RefinedMesh result = refiner.refine(coarse, fine, obstacles);
  EXPECT_GT(result.report.penetrations_before, 0u);
  expect_clean(result, cloth.fine().faces);
  EXPECT_LT(test::sphere_depth(result.positions, cloth.fine().faces, ball.center, ball.radius), 1.1e-6);
  EXPECT_LT(result.report.largest_move_m, 0.08);
}

TEST_P(Adversarial, NoiseAndASphere) {
  const Ball ball = ball_beside(coarse, cloth.coarse.faces);
  const std::vector<ObstacleFrame> obstacles{test::sphere("ball", ball.center, ball.radius)};
  const RefinedMesh result = refiner.refine(coarse, upsampled + test::noise(upsampled.rows(), 0.02f, 3), obstacles);
  EXPECT_GT(result.report.penetrations_before, 0u);
  expect_clean(result, cloth.fine().faces);
  EXPECT_LT(test::sphere_depth(result.positions, cloth.fine().faces, ball.center, ball.radius), 1.1e-6);
}

// Two balls that overlap, on the same side of the cloth: the fine mesh is in both, and in the wedge between them.
TEST_P(Adversarial, TwoObstaclesThatOverlap) {
  const Ball ball = ball_beside(coarse, cloth.coarse.faces);
  const Eigen::Vector3f aside = 0.2f * ball.normal.unitOrthogonal();
  std::vector<ObstacleFrame> obstacles{test::sphere("left", ball.center - aside, ball.radius),
                                       test::sphere("right", ball.center + aside, ball.radius)};
  ASSERT_LT((2 * aside).norm(), 2 * ball.radius);
  // The nearest of them must leave the coarse mesh clean.
  while (count_penetrations(coarse, cloth.coarse.faces, {}, obstacles) > 0) {
    for (ObstacleFrame& obstacle : obstacles) obstacle.center += 0.01f * ball.normal;
  }
  Positions fine = upsampled;
  for (Eigen::Index v = 0; v < fine.rows(); ++v) {
    fine.row(v) +=
        0.1f * std::exp(-20 * (fine.row(v).transpose() - ball.touch).squaredNorm()) * ball.normal.transpose();
  }
  const RefinedMesh result = refiner.refine(coarse, fine, obstacles);
  EXPECT_GT(result.report.penetrations_before, 50u);
  expect_clean(result, cloth.fine().faces);
  for (const ObstacleFrame& obstacle : obstacles) {
    EXPECT_LT(test::sphere_depth(result.positions, cloth.fine().faces, obstacle.center, obstacle.radius), 1.1e-6);
  }
}

// The coarse cloth itself is nearer to the ball than the clearance: that can't be kept, but the frame must be clean.
TEST_P(Adversarial, LessRoomThanTheClearance) {
  const Ball ball = ball_beside(coarse, cloth.coarse.faces);
  const Eigen::Vector3f center = ball.touch + ball.radius * ball.normal;
  float radius = ball.radius;
  const auto obstacles = [&] { return std::vector<ObstacleFrame>{test::sphere("ball", center, radius)}; };
  while (count_penetrations(coarse, cloth.coarse.faces, {}, obstacles()) > 0) radius -= 1e-4f;
  Refiner wide(cloth.coarse, cloth.subdivision, {}, {.clearance_m = 0.05});
  const RefinedMesh result = wide.refine(coarse, upsampled + test::noise(upsampled.rows(), 0.003f, 4), obstacles());
  expect_clean(result, cloth.fine().faces);
  EXPECT_FALSE(result.report.input_intersects);
  EXPECT_LT(test::sphere_depth(result.positions, cloth.fine().faces, center, radius), 1.1e-6);
}

// Two layers and an obstacle between them that is thicker than the gap less twice the clearance.
TEST(Refiner, AnObstacleBetweenTwoLayers) {
  Cloth cloth;
  Topology sheet = test::square_sheet(12, 1);
  const Eigen::Index v = sheet.vertex_count(), f = sheet.face_count();
  cloth.coarse = sheet;
  cloth.coarse.rest_positions.conservativeResize(2 * v, 3);
  cloth.coarse.rest_positions.bottomRows(v) = sheet.rest_positions;
  cloth.coarse.rest_positions.bottomRows(v).col(1).array() += 0.101f;
  cloth.coarse.faces.conservativeResize(2 * f, 3);
  cloth.coarse.faces.bottomRows(f) = sheet.faces.array() + static_cast<std::uint32_t>(v);
  cloth.coarse.uv.conservativeResize(2 * v, 2);
  cloth.coarse.uv.bottomRows(v) = sheet.uv;
  cloth.coarse.uv.bottomRows(v).col(0).array() += 2;
  cloth.coarse.uv_faces = cloth.coarse.faces;
  cloth.subdivision = subdivide(cloth.coarse, 2);
  const std::vector<ObstacleFrame> obstacles{test::sphere("ball", {0.5f, 0.0505f, -0.5f}, 0.05f)};
  const Positions upsampled = upsample(cloth.subdivision, cloth.coarse.faces, cloth.coarse.rest_positions);
  Refiner refiner(cloth.coarse, cloth.subdivision, {});
  const RefinedMesh result =
      refiner.refine(cloth.coarse.rest_positions, upsampled + test::noise(upsampled.rows(), 0.004f, 9), obstacles);
  EXPECT_GT(result.report.penetrations_before, 0u);
  expect_clean(result, cloth.fine().faces);
  EXPECT_LT(test::sphere_depth(result.positions, cloth.fine().faces, obstacles[0].center, 0.05f), 1.1e-6);
}

// Weights are a function of the frame alone; a frame that changes little must not make them jump.
TEST(Refiner, ZonesDoNotPopWhenWrinklesGrow) {
  Cloth cloth;
  cloth.coarse = test::square_sheet(10, 1);
  cloth.subdivision = subdivide(cloth.coarse, 2);
  const Positions& coarse = cloth.coarse.rest_positions;
  const Positions upsampled = upsample(cloth.subdivision, cloth.coarse.faces, coarse);
  // Folds that lean over as they grow and meet their neighbours, higher in the middle than at the rim.
  Positions detail(upsampled.rows(), 3);
  for (Eigen::Index v = 0; v < detail.rows(); ++v) {
    const float x = upsampled(v, 0), z = upsampled(v, 2);
    const float height = 0.06f * std::sin(3 * x) * std::sin(-3 * z);
    detail.row(v) << height * std::sin(60 * x), height * std::sin(30 * x + 5 * z), 0;
  }
  Refiner refiner(cloth.coarse, cloth.subdivision, {});
  constexpr int kFrames = 40;
  Positions last_input, last_output;
  std::size_t zones = 0;
  float pop = 0;
  for (int k = 0; k <= kFrames; ++k) {
    const Positions input = upsampled + (static_cast<float>(k) / kFrames) * detail;
    const RefinedMesh result = refiner.refine(coarse, input, {});
    EXPECT_TRUE(result.report.clean());
    zones += result.report.zones;
    if (k > 0) {
      const Positions change = (result.positions - last_output) - (input - last_input);
      pop = std::max(pop, change.rowwise().norm().maxCoeff());
    }
    last_input = input;
    last_output = result.positions;
  }
  EXPECT_GT(zones, 20u);
  EXPECT_LT(pop, 0.1f * detail.rowwise().norm().maxCoeff());
}

TEST(Refiner, KeepsTheWrinklesThatItPushesOut) {
  const Cloth cloth = load_cloth("tablecloth");
  const Positions& coarse = cloth.coarse.rest_positions;
  Positions fine = cloth.fine().rest_positions;
  for (Eigen::Index v = 0; v < fine.rows(); ++v) fine(v, 1) = 0.004f * std::sin(60 * fine(v, 0));
  const std::vector<ObstacleFrame> obstacles{test::sphere("ball", {0, -0.5f, 0}, 0.499f)};
  // How much the difference of each edge changes, against projection alone.
  const auto change = [&](int rounds) {
    Refiner refiner(cloth.coarse, cloth.subdivision, {}, {.obstacle_rounds = rounds});
    const RefinedMesh result = refiner.refine(coarse, fine, obstacles);
    EXPECT_GT(result.report.penetrations_before, 0u);
    expect_clean(result, cloth.fine().faces);
    EXPECT_LT(test::sphere_depth(result.positions, cloth.fine().faces, {0, -0.5f, 0}, 0.499f), 1.1e-6);
    double sum = 0;
    for (Eigen::Index f = 0; f < cloth.fine().face_count(); ++f) {
      const auto a = cloth.fine().faces(f, 0), b = cloth.fine().faces(f, 1);
      sum += static_cast<double>(
          ((result.positions.row(a) - result.positions.row(b)) - (fine.row(a) - fine.row(b))).squaredNorm());
    }
    return sum;
  };
  EXPECT_LT(change(3), 0.5 * change(0));
}

TEST(Refiner, AMeshObstacle) {
  const test::ClosedMesh torus = test::torus(0.3f, 0.1f, 48, 24);
  const Cloth cloth = load_cloth("tablecloth");
  Positions coarse = cloth.coarse.rest_positions;
  coarse.col(1).array() += 0.11f;
  Positions fine = upsample(cloth.subdivision, cloth.coarse.faces, coarse);
  for (Eigen::Index v = 0; v < fine.rows(); ++v) fine(v, 1) -= 0.02f + 0.01f * std::sin(50 * fine(v, 0));
  const std::vector<ObstacleShape> shapes{{"ring", torus.faces}};
  ObstacleFrame ring;
  ring.name = "ring";
  ring.positions = torus.positions;
  const std::vector<ObstacleFrame> frames{ring};
  Refiner refiner(cloth.coarse, cloth.subdivision, shapes);
  const RefinedMesh result = refiner.refine(coarse, fine, frames);
  EXPECT_GT(result.report.penetrations_before, 100u);
  expect_clean(result, cloth.fine().faces);
  EXPECT_EQ(count_penetrations(result.positions, cloth.fine().faces, shapes, frames), 0u);
  for (Eigen::Index v = 0; v < fine.rows(); v += 7) {
    EXPECT_LT(test::winding_number(torus.positions, torus.faces, result.positions.row(v).cast<double>()), 0.5) << v;
  }
}

TEST(Refiner, ACoarseInputThatIntersectsIsReportedAndNotMadeWorse) {
  const Cloth cloth = load_cloth("tablecloth");
  Positions coarse = cloth.coarse.rest_positions;
  for (Eigen::Index v = 0; v < coarse.rows(); ++v) {  // the right half folded through the left
    if (coarse(v, 0) > 0) coarse.row(v) << -coarse(v, 0), 0.05f * std::sin(20 * coarse(v, 2)), coarse(v, 2);
  }
  ASSERT_GT(count_self_intersections(coarse, cloth.coarse.faces), 0u);
  const Positions upsampled = upsample(cloth.subdivision, cloth.coarse.faces, coarse);
  Refiner refiner(cloth.coarse, cloth.subdivision, {});
  for (const float sigma : {0.f, 0.002f, 0.03f}) {
    const Positions fine = upsampled + test::noise(upsampled.rows(), sigma, 5);
    const RefinedMesh result = refiner.refine(coarse, fine, {});
    EXPECT_TRUE(result.report.input_intersects);
    EXPECT_LE(result.report.pairs_after, result.report.pairs_before);
    if (result.report.pairs_before < 50'000) {
      EXPECT_EQ(result.report.pairs_before, count_self_intersections(fine, cloth.fine().faces));
      EXPECT_EQ(result.report.pairs_after, count_self_intersections(result.positions, cloth.fine().faces));
    }
  }
}

TEST(Refiner, ACoarseInputInsideAnObstacleIsReportedAndNotMadeWorse) {
  const Cloth cloth = load_cloth("tablecloth");
  const Positions coarse = test::wavy(cloth.coarse.rest_positions);
  const Positions upsampled = upsample(cloth.subdivision, cloth.coarse.faces, coarse);
  Refiner refiner(cloth.coarse, cloth.subdivision, {});
  // A ball around a vertex of the coarse mesh, alone and squeezed between two that leave no room.
  const Eigen::Vector3f center = coarse.row(300);
  const std::vector<ObstacleFrame> one{test::sphere("ball", center, 0.1f)};
  std::vector<ObstacleFrame> three = one;
  three.push_back(test::sphere("above", center + Eigen::Vector3f(0, 0.15f, 0), 0.12f));
  three.push_back(test::sphere("below", center - Eigen::Vector3f(0, 0.15f, 0), 0.12f));
  for (const auto& obstacles : {one, three}) {
    const Positions fine = upsampled + test::noise(upsampled.rows(), 0.002f, 11);
    const RefinedMesh result = refiner.refine(coarse, fine, obstacles);
    EXPECT_TRUE(result.report.input_intersects);
    EXPECT_GT(result.report.penetrations_before, 0u);
    EXPECT_LE(result.report.penetrations_after + result.report.pairs_after,
              result.report.penetrations_before + result.report.pairs_before);
    EXPECT_EQ(result.report.penetrations_after,
              count_penetrations(result.positions, cloth.fine().faces, {}, obstacles));
    EXPECT_EQ(result.report.pairs_after, count_self_intersections(result.positions, cloth.fine().faces));
  }
}

// A frame may be sent again, or to a replica that has not seen the earlier ones.
TEST(Refiner, FramesAreIndependentAndThreadsDoNotMatter) {
  const Cloth cloth = load_cloth("tablecloth");
  Positions coarse = test::wavy(cloth.coarse.rest_positions);
  coarse.col(1).array() += 0.2f;
  const Positions upsampled = upsample(cloth.subdivision, cloth.coarse.faces, coarse);
  const test::ClosedMesh torus = test::torus(0.3f, 0.1f, 48, 24);
  const std::vector<ObstacleShape> shapes{{"ring", torus.faces}};
  const auto obstacles = [&](float y) {
    ObstacleFrame ring;
    ring.name = "ring";
    ring.positions = torus.positions;
    ring.positions.col(1).array() += y;
    return std::vector<ObstacleFrame>{ring, test::sphere("ball", {0.5f, y - 0.1f, 0.1f}, 0.2f)};
  };
  // As high as the coarse mesh leaves room.
  float y = -0.2f;
  while (count_penetrations(coarse, cloth.coarse.faces, shapes, obstacles(y)) == 0) y += 0.004f;
  y -= 0.005f;
  const Positions fine = upsampled + test::noise(upsampled.rows(), 0.003f, 6);
  RefinementOptions one, three;
  one.threads = 1;
  three.threads = 3;
  Refiner used(cloth.coarse, cloth.subdivision, shapes, one), fresh(cloth.coarse, cloth.subdivision, shapes, three);
  used.refine(coarse, fine + test::noise(fine.rows(), 0.05f, 7), obstacles(-1));
  used.refine(coarse, upsampled + test::noise(fine.rows(), 0.002f, 8), obstacles(y - 0.002f));
  const RefinedMesh expected = fresh.refine(coarse, fine, obstacles(y));
  EXPECT_GT(expected.report.penetrations_before, 0u);
  EXPECT_GT(expected.report.zones, 0u);
  EXPECT_TRUE(expected.report.clean());
  EXPECT_EQ(used.refine(coarse, fine, obstacles(y)).positions, expected.positions);
  EXPECT_EQ(fresh.refine(coarse, fine, obstacles(y)).positions, expected.positions);
}

TEST(Refiner, BadInputIsRefusedAndTheRefinerStaysUsable) {
  Cloth cloth;
  cloth.coarse = test::square_sheet(4, 1);
  cloth.subdivision = subdivide(cloth.coarse, 2);
  EXPECT_THROW(Refiner(cloth.coarse, cloth.subdivision, {}, {.clearance_m = -1}), Error);
  EXPECT_THROW(Refiner(cloth.coarse, cloth.subdivision, {}, {.bisections = 0}), Error);
  EXPECT_THROW(Refiner(test::square_sheet(5, 1), cloth.subdivision, {}), Error);
  Refiner refiner(cloth.coarse, cloth.subdivision, {});
  const Positions &coarse = cloth.coarse.rest_positions, &fine = cloth.fine().rest_positions;
  EXPECT_THROW(refiner.refine(fine, fine, {}), Error);
  EXPECT_THROW(refiner.refine(coarse, coarse, {}), Error);
  Positions broken = fine;
  broken(3, 0) = std::numeric_limits<float>::infinity();
  EXPECT_THROW(refiner.refine(coarse, broken, {}), Error);
  const std::vector<ObstacleFrame> bad{test::sphere("ball", {0, 0, 0}, 0)};
  EXPECT_THROW(refiner.refine(coarse, fine, bad), Error);
  EXPECT_TRUE(refiner.refine(coarse, fine, {}).report.clean());
}

}  // namespace
}  // namespace pleat::refinement
