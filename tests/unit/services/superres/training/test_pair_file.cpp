#include "services/superres/training/pair_file.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>

#include "services/superres/training/pairs.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;

std::string content(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

TEST(PairFile, OnlyPairFilesAreReplaced) {
  const test::TemporaryFolder temporary;
  const fs::path file = temporary.path() / "wave.pairs";
  std::ofstream(file) << "mine";
  std::ofstream(file.string() + ".partial") << "mine too";
  PairFileKey key;
  key.frames = 1;
  key.input_channels = key.answer_channels = key.scale = 1;
  key.height = key.width = 2;
  const std::vector<float> image(4, 0.5F);
  for (int time = 0; time < 2; ++time) {
    PairFileWriter writer(file, key);
    writer.append(image, image, RotationRows{});
    writer.finish();
  }
  PairSequence sequence;
  EXPECT_TRUE(map_pair_file(file, key, sequence));
  EXPECT_EQ(content(file.string() + ".aside-1"), "mine");
  EXPECT_EQ(content(file.string() + ".partial.aside-1"), "mine too");
  EXPECT_FALSE(fs::exists(file.string() + ".aside-2")) << "what was made here is replaced";
}

}  // namespace
}  // namespace pleat::superres
