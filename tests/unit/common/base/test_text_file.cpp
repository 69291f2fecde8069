// Text as editors save it; what is no text is named.
#include "common/base/text_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

class TextFile : public testing::Test {
 protected:
  std::string read(const std::string& bytes) const {
    std::ofstream(path_, std::ios::binary) << bytes;
    return read_text_file(path_, 1000);
  }
  void expect_refused(const std::string& bytes, const std::string& cause,
                      ErrorCode code = ErrorCode::kInvalidArgument) const {
    try {
      read(bytes);
      ADD_FAILURE() << "accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), code);
      EXPECT_THAT(error.what(), testing::StartsWith(path_.string() + ": "));
      EXPECT_THAT(error.what(), testing::HasSubstr(cause));
    }
  }
  const test::TemporaryFolder temporary_;
  const std::filesystem::path path_ = temporary_.path() / "text";
};

TEST_F(TextFile, IsReadWithoutItsMark) {
  EXPECT_EQ(read("a\r\nb"), "a\r\nb");
  EXPECT_EQ(read("\xEF\xBB\xBF{}"), "{}");
  EXPECT_EQ(read(""), "");
  EXPECT_EQ(read("\xC3\xA4"), "\xC3\xA4");
}

TEST_F(TextFile, OtherEncodingsAreNamed) {
  using namespace std::string_literals;
  expect_refused("\xFF\xFE{\0}\0"s, "UTF-16");
  expect_refused("\xFE\xFF\0{\0}"s, "UTF-16");
  expect_refused("{\0}\0"s, "UTF-16");
  expect_refused("\0{\0}"s, "UTF-16");
  expect_refused("\xFF\xFE\0\0{\0\0\0"s, "UTF-32");
  expect_refused("ab\0\0\0\0\0\0"s, "is no text");
}

TEST_F(TextFile, PlaceholdersAndLongFilesAreRefused) {
  expect_refused("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "is a placeholder of Git LFS");
  EXPECT_THROW(refuse_placeholder(path_), Error);
  expect_refused("/annex/objects/SHA256E-s1--0.obj\n", "is a placeholder of git-annex");
  expect_refused(std::string(1001, ' '), "more than 1000 bytes", ErrorCode::kResourceExhausted);
  EXPECT_EQ(read(std::string(1000, ' ')).size(), 1000u);
  EXPECT_NO_THROW(refuse_placeholder(path_));
  EXPECT_THROW(read_text_file(temporary_.path()), Error);
}

}  // namespace
}  // namespace pleat
