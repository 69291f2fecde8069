#include "common/base/reloaded_file.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

int number_in(const std::filesystem::path& file) {
  int number = 0;
  if (!(std::ifstream(file) >> number)) throw_invalid_argument(file.string() + ": no number");
  return number;
}

TEST(ReloadedFile, FollowsTheFileAndKeepsWhatWasRight) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "number";
  EXPECT_THROW(ReloadedFile<int>(file, number_in, [](const std::string&) {}), Error);
  write_whole_file(file, "1");
  std::vector<std::string> complaints;
  int reads = 0;
  ReloadedFile<int> reloaded(
      file,
      [&](const std::filesystem::path& path) {
        ++reads;
        return number_in(path);
      },
      [&](const std::string& complaint) { complaints.push_back(complaint); });
  const auto first = reloaded.get();
  EXPECT_EQ(*reloaded.get(), 1);
  EXPECT_EQ(reads, 1) << "unchanged, so it is not read again";
  write_whole_file(file, "2");
  EXPECT_EQ(*reloaded.get(), 2);
  EXPECT_EQ(*first, 1) << "who holds a value keeps it";
  write_whole_file(file, "x");
  EXPECT_EQ(*reloaded.get(), 2);
  EXPECT_EQ(*reloaded.get(), 2);
  ASSERT_EQ(complaints.size(), 1U) << "once";
  EXPECT_NE(complaints[0].find("number: no number"), std::string::npos);
  std::filesystem::remove(file);
  EXPECT_EQ(*reloaded.get(), 2);
  write_whole_file(file, "3");
  EXPECT_EQ(*reloaded.get(), 3);
}

}  // namespace
}  // namespace pleat
