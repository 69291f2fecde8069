#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "common/base/error.hpp"
#include "common/config/options.hpp"

namespace pleat::config {
namespace {

class OptionsTest : public ::testing::Test {
 protected:
  OptionsTest() : file("/tmp/pleat-options-" + std::to_string(getpid()) + ".json") { add_all(); }
  ~OptionsTest() override {
    std::filesystem::remove(file);
    for (const std::string& name : set) unsetenv(name.c_str());
  }
  void add_all() {
    options.add("listen", listen, "an address")
        .add("max-frames", max_frames, "a number")
        .add("ratio", ratio, "a factor")
        .add("reflection", reflection, "a switch")
        .add("models", models, "a list");
  }
  bool parse(std::vector<const char*> arguments) {
    arguments.insert(arguments.begin(), "program");
    return options.parse(static_cast<int>(arguments.size()), arguments.data());
  }
  void environment(const std::string& name, const std::string& value) {
    setenv(name.c_str(), value.c_str(), 1);
    set.push_back(name);
  }
  void write(const std::string& text) { std::ofstream(file) << text; }
  void expect_refused(const std::vector<const char*>& arguments, const std::string& part) {
    try {
      parse(arguments);
      ADD_FAILURE() << part << " was accepted";
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    }
  }

  std::string file;
  std::vector<std::string> set;
  std::string listen = "unix:default";
  std::uint32_t max_frames = 7;
  double ratio = 0.5;
  bool reflection = true;
  std::vector<std::string> models = {"a"};
  Options options{"program", "a program for tests", "PLEAT_SAMPLE_"};
};

TEST_F(OptionsTest, DefaultsStay) {
  EXPECT_TRUE(parse({}));
  EXPECT_EQ(options.effective(),
            R"({"listen": "unix:default", "max_frames": 7, "ratio": 0.5, "reflection": true, "models": ["a"]})");
}

TEST_F(OptionsTest, FlagsOverEnvironmentOverFile) {
  write(R"({"listen": "file", "max_frames": 1, "ratio": 2, "reflection": false, "models": ["x", "y"]})");
  environment("PLEAT_SAMPLE_CONFIG", file);
  environment("PLEAT_SAMPLE_MAX_FRAMES", "2");
  environment("PLEAT_SAMPLE_LISTEN", "environment");
  EXPECT_TRUE(parse({"--listen", "flag", "--reflection"}));
  EXPECT_EQ(listen, "flag");
  EXPECT_EQ(max_frames, 2u);
  EXPECT_EQ(ratio, 2);
  EXPECT_TRUE(reflection);
  EXPECT_EQ(models, (std::vector<std::string>{"x", "y"}));
}

TEST_F(OptionsTest, ListsAndSwitches) {
  environment("PLEAT_SAMPLE_REFLECTION", "off");
  EXPECT_TRUE(parse({"--models", "b", "--models", "c", "--ratio", "-1.5e-3"}));
  EXPECT_FALSE(reflection);
  EXPECT_EQ(models, (std::vector<std::string>{"b", "c"}));
  EXPECT_EQ(ratio, -1.5e-3);
  environment("PLEAT_SAMPLE_MODELS", "d,e");
  EXPECT_TRUE(parse({"--no-reflection"}));
  EXPECT_FALSE(reflection);
  EXPECT_EQ(models, (std::vector<std::string>{"d", "e"}));
}

TEST_F(OptionsTest, UnknownNamesAreErrors) {
  expect_refused({"--nonsense", "1"}, "--nonsense");
  expect_refused({"stray"}, "stray");
  write(R"({"max-frames": 1})");
  expect_refused({"--config", file.c_str()}, "max-frames");
  environment("PLEAT_SAMPLE_NONSENSE", "1");
  expect_refused({}, "PLEAT_SAMPLE_NONSENSE");
}

TEST_F(OptionsTest, WrongValuesNameTheirSource) {
  expect_refused({"--max-frames", "seven"}, "--max-frames: 'seven'");
  expect_refused({"--max-frames", "-1"}, "out of range");
  expect_refused({"--max-frames", "5000000000"}, "out of range");
  expect_refused({"--ratio", "nan"}, "--ratio");
  expect_refused({"--config", "/nowhere.json"}, "/nowhere.json");
  write("{]");
  expect_refused({"--config", file.c_str()}, file);
  write(R"({"max_frames": [1]})");
  expect_refused({"--config", file.c_str()}, "max_frames");
  write(R"({"max_frames": 1.5})");
  expect_refused({"--config", file.c_str()}, "max_frames");
  environment("PLEAT_SAMPLE_REFLECTION", "maybe");
  expect_refused({}, "PLEAT_SAMPLE_REFLECTION: 'maybe'");
}

TEST_F(OptionsTest, HelpNamesEverything) {
  ::testing::internal::CaptureStdout();
  EXPECT_FALSE(parse({"--help"}));
  const std::string text = ::testing::internal::GetCapturedStdout();
  for (const char* part : {"--max-frames", "PLEAT_SAMPLE_MAX_FRAMES", "a factor", "unix:default"}) {
    EXPECT_NE(text.find(part), std::string::npos) << part;
  }
}

}  // namespace
}  // namespace pleat::config
