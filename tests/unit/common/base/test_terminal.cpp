// How much is said, and where in colours.
#include "common/base/terminal.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <unistd.h>

#include <cstdlib>

namespace pleat {
namespace {

TEST(Terminal, ColoursAreForTerminalsThatWantThem) {
  int main = -1, terminal = -1;
  ASSERT_EQ(::openpty(&main, &terminal, nullptr, nullptr, nullptr), 0);
  const int file = ::open("/dev/null", O_WRONLY);
  ::setenv("TERM", "xterm", 1);
  ::unsetenv("NO_COLOR");
  EXPECT_TRUE(has_colors(terminal));
  EXPECT_FALSE(has_colors(file));
  ::setenv("NO_COLOR", "", 1);
  EXPECT_TRUE(has_colors(terminal));
  ::setenv("NO_COLOR", "1", 1);
  EXPECT_FALSE(has_colors(terminal));
  ::unsetenv("NO_COLOR");
  ::setenv("TERM", "dumb", 1);
  EXPECT_FALSE(has_colors(terminal));
  for (const int descriptor : {main, terminal, file}) ::close(descriptor);
}

TEST(Terminal, OnlyAVerboseProgramSaysWhatItDoes) {
  const auto said = [](Verbosity level) {
    set_verbosity(level);
    testing::internal::CaptureStderr();
    say("a line");
    set_verbosity(Verbosity::kNormal);
    return testing::internal::GetCapturedStderr();
  };
  EXPECT_EQ(said(Verbosity::kQuiet), "");
  EXPECT_EQ(said(Verbosity::kNormal), "");
  EXPECT_EQ(said(Verbosity::kVerbose), "a line\n");
}

}  // namespace
}  // namespace pleat
