// Nothing that may be somebody's is written over.
#include "common/base/own_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <string>

#include "common/base/error.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMarks[] = {"pleat.example"};

class OwnFile : public testing::Test {
 protected:
  fs::path make(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return folder_ / name;
  }
  static std::string content(const fs::path& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

TEST_F(OwnFile, IsKnownByItsMarkNearItsBegin) {
  EXPECT_TRUE(has_mark(make("own", "# pleat.example 1\n"), kMarks));
  EXPECT_FALSE(has_mark(make("foreign", "# another program\n"), kMarks));
  EXPECT_FALSE(has_mark(make("empty", ""), kMarks));
  EXPECT_FALSE(has_mark(make("late", std::string(kMarkBytes, ' ') + "pleat.example"), kMarks));
  EXPECT_FALSE(has_mark(folder_ / "missing", kMarks));
  EXPECT_FALSE(has_mark(folder_, kMarks));
  fs::create_symlink(folder_ / "own", folder_ / "link");
  EXPECT_FALSE(has_mark(folder_ / "link", kMarks));
}

TEST_F(OwnFile, MayBeReplacedAndNothingElse) {
  EXPECT_NO_THROW(require_replaceable(folder_ / "missing", kMarks));
  EXPECT_NO_THROW(require_replaceable(make("own", "pleat.example"), kMarks));
  fs::create_directory(folder_ / "folder");
  fs::create_symlink("nowhere", folder_ / "dangling");
  for (const fs::path& path : {make("foreign", "mine"), folder_ / "folder", folder_ / "dangling"}) {
    try {
      require_replaceable(path, kMarks);
      ADD_FAILURE() << path;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kAlreadyExists);
      EXPECT_THAT(error.what(), testing::StartsWith(path.string() + ": "));
    }
  }
}

TEST_F(OwnFile, WhatIsInTheWayKeepsItsContentUnderAFreeName) {
  make("x.aside-1", "taken");
  set_aside(make("x", "mine"));
  EXPECT_FALSE(fs::exists(folder_ / "x"));
  EXPECT_EQ(content(folder_ / "x.aside-1"), "taken");
  EXPECT_EQ(content(folder_ / "x.aside-2"), "mine");
  fs::create_symlink("nowhere", folder_ / "link");
  set_aside(folder_ / "link");
  EXPECT_TRUE(fs::is_symlink(fs::symlink_status(folder_ / "link.aside-1")));
  EXPECT_NO_THROW(set_aside(folder_ / "missing"));
}

TEST_F(OwnFile, AFolderIsMadeOrTheCauseNamed) {
  make_writable_folder(folder_ / "a" / "b");
  EXPECT_TRUE(fs::is_directory(folder_ / "a" / "b"));
  make_writable_folder(folder_ / "a");
  fs::create_directory_symlink(folder_ / "a", folder_ / "to_folder");
  EXPECT_NO_THROW(make_writable_folder(folder_ / "to_folder"));
  fs::create_directory_symlink("/", folder_ / "to_root");
  fs::create_symlink("nowhere", folder_ / "dangling");
  const fs::path file = make("file", "mine");
  for (const fs::path& path :
       {fs::path(), fs::path("/"), folder_ / "to_root", file, file / "below", folder_ / "dangling"}) {
    try {
      make_writable_folder(path);
      ADD_FAILURE() << path;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
      EXPECT_THAT(error.what(), testing::HasSubstr(path.string()));
    }
  }
  EXPECT_EQ(content(file), "mine");
}

}  // namespace
}  // namespace pleat
