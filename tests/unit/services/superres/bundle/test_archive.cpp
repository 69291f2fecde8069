#include "services/superres/bundle/archive.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::superres {
namespace {

class ArchiveTest : public testing::Test {
 protected:
  ArchiveTest() {
    std::ifstream file(std::string(std::getenv("PLEAT_SOURCE_DIR")) + "/tests/unit/services/superres/python_bundle.pt",
                       std::ios::binary);
    bytes_.assign(std::istreambuf_iterator<char>(file), {});
  }
  std::string error_of(const std::string& bytes) const {
    const std::string path = (folder_.path() / "bundle.pt").string();
    std::ofstream(path, std::ios::binary) << bytes;
    try {
      check_archive(path);
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kDataLoss);
      return error.what();
    }
    return "";
  }
  test::TemporaryFolder folder_;
  std::string bytes_;
};

TEST_F(ArchiveTest, WhatWasWrittenIsGood) {
  ASSERT_GT(bytes_.size(), 1000U);
  EXPECT_EQ(error_of(bytes_), "");
}

TEST_F(ArchiveTest, AFlippedBitOfARecordIsNamed) {
  const std::size_t inside = bytes_.find("small-from-python");
  ASSERT_NE(inside, std::string::npos);
  std::string damaged = bytes_;
  damaged[inside] ^= 4;
  EXPECT_NE(error_of(damaged).find("extra/pleat.json is damaged"), std::string::npos) << error_of(damaged);
}

TEST_F(ArchiveTest, MostFlippedBitsAreFound) {
  std::size_t found = 0, tried = 0;
  for (std::size_t at = 5; at < bytes_.size(); at += bytes_.size() / 97) {
    std::string damaged = bytes_;
    damaged[at] ^= 16;
    ++tried;
    found += error_of(damaged).empty() ? 0 : 1;
  }
  EXPECT_GT(2 * found, tried) << "records are most of the file";
}

TEST_F(ArchiveTest, ATruncatedOneIsRefused) {
  EXPECT_NE(error_of(bytes_.substr(0, bytes_.size() / 2)), "");
  EXPECT_NE(error_of(""), "");
}

}  // namespace
}  // namespace pleat::superres
