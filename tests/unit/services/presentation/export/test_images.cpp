// Images are taken apart by readers written here from the formats' descriptions.
#include "services/presentation/export/images.hpp"

#include <gtest/gtest.h>
#include <zlib.h>

#include <cstring>
#include <fstream>
#include <map>
#include <random>
#include <sstream>
#include <string>

#include "tests/support/temporary_folder.hpp"

namespace pleat::presentation {
namespace {

std::string content_of(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

std::string inflated(const std::string& bytes, std::size_t size) {
  std::string out(size, '\0');
  uLongf length = static_cast<uLongf>(size);
  EXPECT_EQ(uncompress(reinterpret_cast<Bytef*>(out.data()), &length, reinterpret_cast<const Bytef*>(bytes.data()),
                       static_cast<uLong>(bytes.size())),
            Z_OK);
  EXPECT_EQ(length, size);
  return out;
}

template <class T>
T number(const std::string& bytes, std::size_t at) {
  T value{};
  std::memcpy(&value, bytes.data() + at, sizeof value);
  return value;
}

TEST(Images, AnExrHasEveryFloat) {
  const test::TemporaryFolder folder;
  constexpr int kSize = 37;  // no multiple of a block's lines
  std::vector<float> values(3 * kSize * kSize);
  std::mt19937 random(1);
  // The first block is noise that no compression makes smaller.
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto bits = static_cast<std::uint32_t>(random());
    std::memcpy(&values[i], &bits, 4);
    if (i >= 3 * kSize * 16 || !(values[i] == values[i])) values[i] = 1e-3F * static_cast<float>(i % 50);
  }
  write_exr(folder.path() / "a.exr", kSize, values);
  const std::string file = content_of(folder.path() / "a.exr");
  EXPECT_EQ(number<std::uint32_t>(file, 0), 20000630u);
  EXPECT_EQ(number<std::uint32_t>(file, 4), 2u);
  std::map<std::string, std::string> attributes;
  std::size_t at = 8;
  while (file[at] != '\0') {
    const std::string name = file.c_str() + at;
    at += name.size() + 1;
    at += std::string(file.c_str() + at).size() + 1;
    const auto size = static_cast<std::size_t>(number<std::int32_t>(file, at));
    attributes[name] = file.substr(at + 4, size);
    at += 4 + size;
  }
  ++at;
  EXPECT_EQ(attributes["compression"], std::string(1, '\3'));
  EXPECT_EQ(number<std::int32_t>(attributes["dataWindow"], 12), kSize - 1);
  EXPECT_EQ(attributes["channels"].substr(0, 2), std::string("B\0", 2));
  EXPECT_EQ(attributes["channels"].size(), 3u * 18 + 1);
  std::size_t blocks = 0, stored = 0;
  for (int first = 0; first < kSize; first += 16, ++blocks) {
    const auto place = static_cast<std::size_t>(number<std::uint64_t>(file, at + 8 * blocks));
    EXPECT_EQ(number<std::int32_t>(file, place), first);
    const auto size = static_cast<std::size_t>(number<std::int32_t>(file, place + 4));
    const int lines = std::min(16, kSize - first);
    const std::size_t raw_size = 12u * kSize * static_cast<std::size_t>(lines);
    std::string raw = file.substr(place + 8, size);
    if (size < raw_size) {
      raw = inflated(raw, raw_size);
      for (std::size_t i = 1; i < raw_size; ++i)
        raw[i] = static_cast<char>(static_cast<unsigned char>(raw[i]) + static_cast<unsigned char>(raw[i - 1]) - 128);
      std::string mixed(raw_size, '\0');
      for (std::size_t i = 0; i < raw_size; ++i) mixed[i] = raw[i / 2 + (i % 2) * ((raw_size + 1) / 2)];
      raw = mixed;
    } else {
      EXPECT_EQ(size, raw_size);
      ++stored;
    }
    for (int line = 0; line < lines; ++line) {
      for (std::size_t channel = 0; channel < 3; ++channel) {
        for (std::size_t x = 0; x < kSize; ++x) {
          const float value = number<float>(raw, 4 * ((static_cast<std::size_t>(line) * 3 + channel) * kSize + x));
          ASSERT_EQ(value, values[3 * (static_cast<std::size_t>(first + line) * kSize + x) + 2 - channel]);
        }
      }
    }
  }
  EXPECT_EQ(stored, 1u) << "noise is stored as it is";
}

TEST(Images, APngHasEveryTexel) {
  const test::TemporaryFolder folder;
  constexpr std::size_t kSize = 19;
  std::vector<std::uint16_t> values(3 * kSize * kSize);
  std::mt19937 random(2);
  for (std::uint16_t& value : values) value = static_cast<std::uint16_t>(random());
  write_png(folder.path() / "a.png", kSize, values);
  const std::string file = content_of(folder.path() / "a.png");
  ASSERT_EQ(file.substr(0, 8), "\x89PNG\r\n\x1a\n");
  const auto big = [&](std::size_t at) { return __builtin_bswap32(number<std::uint32_t>(file, at)); };
  std::map<std::string, std::string> chunks;
  for (std::size_t at = 8; at < file.size();) {
    const std::size_t size = big(at);
    const std::string both = file.substr(at + 4, 4 + size);
    EXPECT_EQ(big(at + 8 + size), crc32_z(0, reinterpret_cast<const Bytef*>(both.data()), both.size()));
    chunks[both.substr(0, 4)] = both.substr(4);
    at += 12 + size;
  }
  EXPECT_TRUE(chunks.contains("IEND"));
  EXPECT_EQ(chunks["IHDR"], std::string("\0\0\0\x13\0\0\0\x13\x10\2\0\0\0", 13));
  std::string lines = inflated(chunks["IDAT"], kSize * (1 + 6 * kSize));
  for (std::size_t y = 0; y < kSize; ++y) {
    std::string line = lines.substr(y * (1 + 6 * kSize), 1 + 6 * kSize);
    ASSERT_EQ(line[0], 1);
    line.erase(0, 1);
    for (std::size_t i = 6; i < line.size(); ++i) line[i] = static_cast<char>(line[i] + line[i - 6]);
    for (std::size_t i = 0; i < 3 * kSize; ++i) {
      const int value = static_cast<unsigned char>(line[2 * i]) * 256 + static_cast<unsigned char>(line[2 * i + 1]);
      ASSERT_EQ(value, values[3 * kSize * y + i]);
    }
  }
}

}  // namespace
}  // namespace pleat::presentation
