#include "services/presentation/live/packed.hpp"

#include <gtest/gtest.h>

#include <cstring>

namespace pleat::presentation {
namespace {

template <typename Scalar>
std::vector<Scalar> read(const std::string& bytes, std::size_t place, std::size_t count) {
  std::vector<Scalar> values(count);
  std::memcpy(values.data(), bytes.data() + place, count * sizeof(Scalar));
  return values;
}

TEST(Packed, ArraysFollowTheTextInTheirOrder) {
  // Names of all lengths, so that the text needs every filling.
  for (std::size_t length = 1; length <= 5; ++length) {
    const std::vector<float> floats{1.5F, -2};
    const std::vector<std::uint32_t> words{7, 0xFFFFFFFF, 3};
    Packed packed;
    packed.about["name"] = std::string(length, 'x') + "\xff";
    packed.add("floats", floats);
    packed.add("none", std::vector<float>{});
    packed.add("words", words);
    const std::string bytes = packed.bytes();
    const std::size_t size = read<std::uint32_t>(bytes, 0, 1)[0];
    ASSERT_EQ(size % 4, 0U);
    ASSERT_EQ(bytes.size(), 4 + size + 4 * 5);
    const auto about = nlohmann::json::parse(bytes.substr(4, size));
    EXPECT_EQ(about["name"].get<std::string>().substr(0, length), std::string(length, 'x'));
    EXPECT_EQ(about["arrays"], nlohmann::json::parse(R"([{"name": "floats", "type": "float32", "length": 2},
        {"name": "none", "type": "float32", "length": 0}, {"name": "words", "type": "uint32", "length": 3}])"));
    EXPECT_EQ(read<float>(bytes, 4 + size, 2), floats);
    EXPECT_EQ(read<std::uint32_t>(bytes, 4 + size + 8, 3), words);
  }
}

}  // namespace
}  // namespace pleat::presentation
