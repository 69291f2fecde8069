#include "common/base/hash.hpp"

#include <gtest/gtest.h>

namespace pleat {
namespace {

// Published values of 64-bit FNV-1a.
TEST(Hash, IsFnv1a) {
  EXPECT_EQ(Hash().hex(), "cbf29ce484222325");
  EXPECT_EQ(Hash().add("a").value(), 0xaf63dc4c8601ec8cull);
  EXPECT_EQ(Hash().add("foobar").hex(), "85944171f73967e8");
  EXPECT_EQ(Hash().add("foo").add("bar").value(), Hash().add("foobar").value());
}

}  // namespace
}  // namespace pleat
