// The hot path of conversion takes no memory once it has run.
#include <gtest/gtest.h>

#include "common/features/channel_ranges.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "tests/support/allocation_counter.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

TEST(HotPath, BothDirectionsTakeNoMemory) {
  if (!PLEAT_COUNTS_ALLOCATIONS) GTEST_SKIP() << "a sanitizer has replaced malloc";
  const test::Garment garment = test::load_garment("tablecloth");
  const ImageMap map(garment.coarse, garment.fine());
  const Frame coarse = test::wrinkled_frame(garment.coarse, 0.1f), fine = test::wrinkled_frame(garment.fine(), 0.1f);
  const Tensor fine_image = map.fine_image(fine, map.align(coarse.positions));
  Tensor image;
  Positions positions;
  ChannelRanges range;
  std::size_t before = 0;
  for (int run = 0; run < 3; ++run) {
    if (run == 1) before = test::allocations;
    const RigidTransform transform = map.align(coarse.positions);
    map.coarse_image(coarse, transform, image);
    if (run == 0) {
      RangeMeasure measure(kFrameChannels);
      measure.add(image);
      range = measure.extremes();
    }
    normalize(range, image);
    denormalize(range, image);
    map.to_mesh(fine_image, transform, positions);
  }
  EXPECT_EQ(test::allocations - before, 0u);
}

}  // namespace
}  // namespace pleat::conversion
