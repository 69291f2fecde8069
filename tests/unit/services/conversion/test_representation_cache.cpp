#include "services/conversion/representation_cache.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <thread>

#include "common/base/error.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

std::shared_ptr<const Representation> build_maps() {
  RepresentationSpec spec;
  spec.kind = GeometryImageSpec{};
  return make_representation(test::load_garment("four charts").coarse, spec);
}

TEST(RepresentationCache, BuildsOncePerKey) {
  RepresentationCache cache(10'000'000);
  int built = 0;
  const auto build = [&] {
    ++built;
    return build_maps();
  };
  bool was_there = true;
  const auto first = cache.get("a", build, &was_there);
  EXPECT_FALSE(was_there);
  EXPECT_EQ(cache.get("a", build, &was_there), first);
  EXPECT_TRUE(was_there);
  EXPECT_NE(cache.get("b", build), first);
  EXPECT_EQ(built, 2);
}

TEST(RepresentationCache, ForgetsWhatWasNotAskedForLongest) {
  const std::size_t size = build_maps()->size();
  RepresentationCache cache(2 * size);
  int built = 0;
  const auto build = [&] {
    ++built;
    return build_maps();
  };
  const auto a = cache.get("a", build);
  cache.get("b", build);
  cache.get("a", build);
  cache.get("c", build);  // b goes
  EXPECT_EQ(built, 3);
  EXPECT_EQ(cache.get("a", build), a);
  EXPECT_EQ(built, 3);
  cache.get("b", build);
  EXPECT_EQ(built, 4);
  RepresentationCache none(0);
  EXPECT_NE(none.get("a", build), nullptr);
  EXPECT_EQ(none.get("a", build)->answer_shape(), a->answer_shape());
  EXPECT_EQ(built, 6);
}

TEST(RepresentationCache, AFailureIsNotKept) {
  RepresentationCache cache(1000);
  EXPECT_THROW(cache.get("a", []() -> std::shared_ptr<const Representation> { throw_invalid_argument("no"); }), Error);
  EXPECT_NE(cache.get("a", build_maps), nullptr);
}

TEST(RepresentationCache, CallersOfOneKeyShareTheBuild) {
  RepresentationCache cache(10'000'000);
  std::atomic<int> built{0};
  const auto build = [&] {
    ++built;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return build_maps();
  };
  std::vector<std::shared_ptr<const Representation>> found(4);
  std::vector<std::thread> threads;
  for (auto& maps : found) threads.emplace_back([&] { maps = cache.get("a", build); });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(built, 1);
  for (const auto& maps : found) EXPECT_EQ(maps, found[0]);
}

}  // namespace
}  // namespace pleat::conversion
