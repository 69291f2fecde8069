// The trainer's configuration: strict about keys, types and ranges.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "services/superres/training/config.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

std::string with(const std::string& more) {
  return R"({"name": "a", "dataset": "d", "output": "o")" + (more.empty() ? "" : ", " + more) + "}";
}

std::string error_of(const std::string& text) {
  try {
    train_config_from_json(text, "config.json");
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    return error.what();
  }
  return "no error";
}

TEST(TrainConfig, DefaultsArePublishedOnes) {
  const TrainConfig c = train_config_from_json(with(""), "x");
  EXPECT_EQ(c.architecture.kind, "mfsr");
  EXPECT_EQ(nlohmann::json::parse(c.architecture.options).at("blocks"), 16);
  EXPECT_EQ(c.losses.frames, 3);
  EXPECT_EQ(c.losses.target, "synthesized");
  EXPECT_DOUBLE_EQ(c.losses.displacement, 0.9);
  EXPECT_DOUBLE_EQ(c.optimizer.beta2, 0.9);
  EXPECT_DOUBLE_EQ(c.optimizer.learning_rate, 1e-4);
  EXPECT_EQ(c.epochs, 120);
  EXPECT_EQ(c.batch, 16);
  EXPECT_EQ(c.patch, 72);
  EXPECT_EQ(c.schedule.step_epochs, 20);
  EXPECT_EQ(c.schedule.fixed_after, 60);
}

TEST(TrainConfig, RoundTrip) {
  const std::string text = with(R"("seed": 9, "optimizer": {"clip": 2.5}, "validation": {"sequences": ["x", "y"]})");
  const TrainConfig c = train_config_from_json(text, "x");
  EXPECT_EQ(c.seed, 9U);
  EXPECT_DOUBLE_EQ(c.optimizer.clip, 2.5);
  EXPECT_EQ(to_json(train_config_from_json(to_json(c), "x")), to_json(c));
}

TEST(TrainConfig, FaultsAreNamed) {
  EXPECT_THAT(error_of(with(R"("epoch": 3)")), HasSubstr("unknown key 'epoch'"));
  EXPECT_THAT(error_of(with(R"("optimizer": {"lr": 3})")), HasSubstr("unknown key 'optimizer.lr'"));
  EXPECT_THAT(error_of(with(R"("epochs": "many")")), HasSubstr("'epochs' has the wrong type"));
  EXPECT_THAT(error_of(with(R"("epochs": 2.5)")), HasSubstr("'epochs' has the wrong type"));
  EXPECT_THAT(error_of(with(R"("seed": -1)")), HasSubstr("'seed'"));
  EXPECT_THAT(error_of(with(R"("mirror": 1)")), HasSubstr("'mirror' has the wrong type"));
  EXPECT_THAT(error_of(with(R"("losses": 5)")), HasSubstr("'losses' must be an object"));
  EXPECT_THAT(error_of(with(R"("batch": 0)")), HasSubstr("'batch' = 0 is outside"));
  EXPECT_THAT(error_of(with(R"("losses": {"target": "guess"})")), HasSubstr("'losses.target' = 'guess'"));
  EXPECT_THAT(error_of(with(R"("architecture": {"blocks": -4})")), HasSubstr("blocks"));
  EXPECT_THAT(error_of(with(R"("architecture": {"axes": "local"})")), HasSubstr("'axes'"));
  EXPECT_THAT(error_of(with(R"("architecture": {"kind": "gan"})")), HasSubstr("'gan'"));
  EXPECT_THAT(error_of(with(R"("architecture": 5)")), HasSubstr("'architecture' must be an object"));
  EXPECT_THAT(error_of(with(R"("images": {"layout": "detail"})")), HasSubstr("losses.kinematic"));
  EXPECT_THAT(error_of(with(R"("images": {"layout": "positions"}, "losses": {"kinematic": 0}, "mirror": true)")),
              HasSubstr("'mirror'"));
  EXPECT_THAT(error_of(with(R"("architecture": {"kind": "tokens", "history": 2})")), HasSubstr("that remembers"));
  EXPECT_THAT(error_of(with(R"("window": 17)")), HasSubstr("'window'"));
  EXPECT_THAT(error_of(with(R"("window_stride": 0)")), HasSubstr("'window_stride'"));
  EXPECT_THAT(error_of(with(R"("images": {"coarse_width": 60})")), HasSubstr("coarse_height"));
  EXPECT_THAT(error_of(with(R"("serves": "any")")), HasSubstr("'serves'"));
  EXPECT_THAT(error_of(with(R"("every_frames": 2)")), HasSubstr("losses.kinematic"));
  EXPECT_THAT(error_of(with(R"("losses": {"vertices": 0.1})")), HasSubstr("'patch' = 0"));
  EXPECT_THAT(error_of(with(R"("losses": {"vertex_normals": 0.1})")), HasSubstr("'patch' = 0"));
  EXPECT_THAT(error_of(with(R"("losses": {"edges": 0.1})")), HasSubstr("'patch' = 0"));
  EXPECT_THAT(error_of(with(R"("losses": {"wrinkles": 0.1})")), HasSubstr("'patch' = 0"));
  EXPECT_THAT(error_of(with(R"("patch": 0, "losses": {"edges": -0.1})")), HasSubstr("'losses.edges' = -0.1"));
  EXPECT_EQ(error_of(with(R"("patch": 0, "losses": {"edges": 0.1})")), "no error");
  EXPECT_THAT(error_of(with(R"("schedule": {"kind": "cosine", "progress": "minutes"})")), HasSubstr("max_minutes"));
  EXPECT_THAT(error_of(R"({"name": "a", "dataset": "d"})"), HasSubstr("'output' is missing"));
  EXPECT_THAT(error_of(R"({"name": "../a", "dataset": "d", "output": "o"})"), HasSubstr("'name'"));
  EXPECT_THAT(error_of("{"), HasSubstr("no JSON"));
  EXPECT_THAT(error_of("[]"), HasSubstr("object"));
  EXPECT_THROW(read_train_config("/does/not/exist.json"), Error);
}

TEST(TrainConfig, ResumptionMayChangeLimitsOnly) {
  const auto json = [](const std::string& more) { return to_json(train_config_from_json(with(more), "x")); };
  EXPECT_EQ(first_difference(json(""), json(R"("epochs": 7, "max_minutes": 1, "threads": 2)")), "");
  EXPECT_EQ(first_difference(json(""), json(R"("batch": 3)")), "batch");
  EXPECT_EQ(first_difference(json(""), json(R"("optimizer": {"beta1": 0.5})")), "optimizer/beta1");
  const auto one = json(R"("validation": {"sequences": ["a"]})"),
             two = json(R"("validation": {"sequences": ["a", "b"]})");
  EXPECT_EQ(first_difference(one, two), "validation/sequences/1");
  EXPECT_EQ(first_difference(two, one), "validation/sequences/1");
}

TEST(TrainConfig, KeysThatAnOlderCheckpointLacksHaveTheirDefaults) {
  const std::string now = to_json(train_config_from_json(with(""), "x"));
  nlohmann::json older = nlohmann::json::parse(now);
  for (const char* key : {"vertices", "vertex_normals", "edges", "wrinkles"})
    ASSERT_EQ(older["losses"].erase(key), 1U) << key;
  const std::string old = older.dump();
  EXPECT_EQ(first_difference(now, old), "");
  const std::string other = to_json(train_config_from_json(with(R"("patch": 0, "losses": {"vertices": 1})"), "x"));
  EXPECT_EQ(first_difference(other, old), "losses/vertices");
}

TEST(TrainConfig, ShippedConfigurationsAreValid) {
  const char* root = std::getenv("PLEAT_SOURCE_DIR");
  ASSERT_NE(root, nullptr);
  int count = 0;
  for (const auto& file : fs::directory_iterator(fs::path(root) / "deploy/models")) {
    const std::string name = file.path().filename().string(), ending = ".train.json";
    if (!name.ends_with(ending)) continue;
    const TrainConfig c = read_train_config(file.path().string());
    EXPECT_EQ(c.name + ending, name);
    EXPECT_EQ(c.output, "out/train/" + c.name);
    ++count;
  }
  EXPECT_GE(count, 10);
}

class TrainConfigFiles : public testing::Test {
 protected:
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name) << text;
    return (folder_ / name).string();
  }
  static std::string error_reading(const std::string& path, const std::vector<std::string>& changes = {}) {
    try {
      read_train_config(path, changes);
    } catch (const Error& error) {
      return error.what();
    }
    return "no error";
  }
  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

TEST_F(TrainConfigFiles, BuildOnABase) {
  write("base.json", with(R"("batch": 3, "optimizer": {"clip": 2, "beta1": 0.5})"));
  const TrainConfig c =
      read_train_config(write("own.json", R"({"base": "base.json", "name": "own", "optimizer": {"clip": 4}})"));
  EXPECT_EQ(c.name, "own");
  EXPECT_EQ(c.dataset, "d");
  EXPECT_EQ(c.batch, 3);
  EXPECT_DOUBLE_EQ(c.optimizer.clip, 4);
  EXPECT_DOUBLE_EQ(c.optimizer.beta1, 0.5);
  EXPECT_THAT(error_reading(write("round.json", R"({"base": "round.json"})")), HasSubstr("circle"));
  EXPECT_THAT(error_reading(write("lost.json", R"({"base": "nowhere.json"})")), HasSubstr("nowhere.json"));
  EXPECT_THAT(error_reading(write("bad.json", R"({"base": 3})")), HasSubstr("'base'"));
}

TEST_F(TrainConfigFiles, ChangesComeLast) {
  const std::string path = write("own.json", with(R"("batch": 3, "losses": {"normal": 0.5})"));
  const TrainConfig c = read_train_config(path, {"losses.normal=0", "output=out/x=y", "mirror=true", "batch=5"});
  EXPECT_DOUBLE_EQ(c.losses.normal, 0);
  EXPECT_EQ(c.output, "out/x=y");
  EXPECT_TRUE(c.mirror);
  EXPECT_EQ(c.batch, 5);
  EXPECT_THAT(error_reading(path, {"losses.norm=0"}), HasSubstr("'losses.norm'"));
  EXPECT_THAT(error_reading(path, {"batch"}), HasSubstr("--set batch"));
  EXPECT_THAT(error_reading(path, {"batch=many"}), HasSubstr("wrong type"));
}

}  // namespace
}  // namespace pleat::superres
