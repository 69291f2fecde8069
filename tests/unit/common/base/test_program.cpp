// From a command line to an exit code and one line.
#include "common/base/program.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace pleat {
namespace {

/// What a program with a command `dataset generate --frames N` says to these words.
std::string answer(std::vector<const char*> words, int expected) {
  CLI::App app("example", "example");
  app.require_subcommand(0, 1);
  CLI::App* dataset = app.add_subcommand("dataset", "");
  CLI::App* generate = dataset->add_subcommand("generate", "");
  app.add_subcommand("export", "");
  int frames = 0;
  std::string folder;
  generate->add_option("folder", folder)->required();
  generate->add_option("--frames", frames);
  words.insert(words.begin(), "example");
  testing::internal::CaptureStderr();
  const int code = run_program(app, static_cast<int>(words.size()), words.data(), [] { return kExitDone; });
  const std::string err = testing::internal::GetCapturedStderr();
  EXPECT_EQ(code, expected) << err;
  EXPECT_LE(std::count(err.begin(), err.end(), '\n'), 1) << err;
  return err;
}

TEST(Program, EchoedInputIsCut) {
  const std::string key(30000, 'k');
  const std::string err = answer({key.c_str()}, kExitWrongInput);
  EXPECT_LT(err.size(), 1100u);
  EXPECT_THAT(err, testing::HasSubstr("characters)"));
}

TEST(Program, MistypedNamesAreGuessed) {
  EXPECT_THAT(answer({"datset"}, kExitWrongInput), testing::HasSubstr("did you mean dataset?"));
  EXPECT_THAT(answer({"exprot"}, kExitWrongInput), testing::HasSubstr("did you mean export?"));
  EXPECT_THAT(answer({"dataset", "generate", "x", "--frame=3"}, kExitWrongInput),
              testing::AllOf(testing::HasSubstr("did you mean --frames?"),
                             testing::HasSubstr("see example dataset generate --help")));
  EXPECT_THAT(answer({"zzz"}, kExitWrongInput), testing::Not(testing::HasSubstr("did you mean")));
  EXPECT_THAT(answer({"--verson"}, kExitWrongInput), testing::HasSubstr("did you mean --version?"));
  EXPECT_EQ(answer({"dataset", "generate", "x", "--frames", "3"}, kExitDone), "");
}

TEST(Program, ExceptionsAreOneLineAndACode) {
  CLI::App app("example", "example");
  const char* words[] = {"example"};
  const auto code_of = [&](const std::function<int()>& body) {
    testing::internal::CaptureStderr();
    const int code = run_program(app, 1, words, body);
    return std::pair{code, testing::internal::GetCapturedStderr()};
  };
  EXPECT_EQ(code_of([]() -> int { throw_invalid_argument("a\nb"); }),
            (std::pair{kExitWrongInput, std::string("example: a b\n")}));
  EXPECT_EQ(code_of([]() -> int { throw std::bad_alloc(); }),
            (std::pair{kExitFailed, std::string("example: out of memory\n")}));
}

}  // namespace
}  // namespace pleat
