// The hot path of refinement takes no memory once it has seen such frames.
#include <gtest/gtest.h>

#include "services/refinement/judge.hpp"
#include "services/refinement/refiner.hpp"
#include "tests/support/allocation_counter.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
namespace {

TEST(HotPath, ASequenceSeenBeforeTakesNoMemory) {
  if (!PLEAT_COUNTS_ALLOCATIONS) GTEST_SKIP() << "a sanitizer has replaced malloc";
  const test::Cloth cloth = test::load_cloth("tablecloth");
  const test::ClosedMesh torus = test::torus(0.3f, 0.1f, 32, 16);
  const std::vector<ObstacleShape> shapes{{"ball", {}}, {"ring", torus.faces}};
  struct Sample {
    Positions coarse, fine;
    std::vector<ObstacleFrame> obstacles;
  };
  std::vector<Sample> samples;
  for (unsigned k = 0; k < 4; ++k) {
    Sample sample;
    sample.coarse = test::wavy(cloth.coarse.rest_positions);
    sample.coarse.col(1).array() += 0.01f * static_cast<float>(k);
    sample.fine = upsample(cloth.subdivision, cloth.coarse.faces, sample.coarse) +
                  test::noise(cloth.fine().vertex_count(), k == 0 ? 0 : 0.003f, k);
    ObstacleFrame ring;
    ring.name = "ring";
    ring.positions = torus.positions;
    // Below the deepest valley, 3 mm from the coarse mesh.
    const float y = 0.01f * static_cast<float>(k) - 0.083f;
    ring.positions.rowwise() += Eigen::RowVector3f(-0.13f, y - 0.1f, 0);
    sample.obstacles = {test::sphere("ball", {-0.43f, y - 0.11f, 0}, 0.11f), ring};
    samples.push_back(std::move(sample));
  }
  RefinementOptions options;
  options.threads = 2;
  Refiner refiner(cloth.coarse, cloth.subdivision, shapes, options);
  RefinedMesh result;
  std::size_t zones = 0, penetrations = 0;
  for (const Sample& sample : samples) {
    refiner.refine(sample.coarse, sample.fine, sample.obstacles, result);
    EXPECT_TRUE(result.report.clean());
    zones += result.report.zones;
    penetrations += result.report.penetrations_before;
  }
  EXPECT_GT(zones, 10u);
  EXPECT_GT(penetrations, 0u);
  const std::size_t before = test::allocations;
  for (const Sample& sample : samples) refiner.refine(sample.coarse, sample.fine, sample.obstacles, result);
  EXPECT_EQ(test::allocations - before, 0u);
}

}  // namespace
}  // namespace pleat::refinement
