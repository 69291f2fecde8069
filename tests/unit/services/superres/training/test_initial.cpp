// What a training takes from the bundle that it begins with.
#include "services/superres/training/initial.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "common/base/error.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/bundle/folder.hpp"
#include "services/superres/training/trainer.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/superres/example_dataset.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using test::error_of;
using testing::HasSubstr;

void quiet(const std::string&) {}

class Initial : public testing::Test {
 protected:
  TrainConfig config(const std::string& name) const {
    TrainConfig c;
    c.name = name, c.dataset = data_.string(), c.output = (temporary_.path() / name).string();
    c.architecture =
        complete({"mfsr", R"({"blocks": 1, "layers": 2, "growth": 4, "features": 8, "upsampling": "subpixel"})"});
    c.serves = "any";
    c.images.layout = "detail", c.images.units = "coarse_edges";
    c.losses.kinematic = 0, c.losses.scaling = "deviation";
    c.epochs = 1, c.steps_per_epoch = 2, c.batch = 2, c.patch = 0;
    c.threads = 1, c.device = "cpu";
    return c;
  }

  /// The path of a bundle of this configuration, trained for a moment.
  static std::string make(const TrainConfig& c) {
    LoadedPairs pairs = load_pairs(c, quiet);
    return train(c, pairs.data, pairs.judge.get(), {}).bundle;
  }

  void SetUp() override { write_example_dataset(data_, example_master(), true); }

  const test::TemporaryFolder temporary_;
  const fs::path data_ = temporary_.path() / "data";
};

TEST_F(Initial, BundleInCoarseEdgesBeginsAsItWasTrained) {
  const std::string bundle = make(config("first"));
  // Other numbers on another mesh, were they measured there.
  DatasetMaster other = example_master();
  Topology coarse = example_master().topology.coarse;
  coarse.rest_positions *= 3, coarse.uv *= 3;
  const Subdivision subdivision = subdivide(coarse, 2);
  other.topology = {coarse, subdivision.fine, subdivision.feature_vertices};
  TrainConfig c = config("second");
  c.dataset = (temporary_.path() / "larger").string();
  write_example_dataset(c.dataset, other, true);
  const Metadata before = read_metadata(bundle);
  EXPECT_NE(load_pairs(c, quiet).data.input_ranges, before.input);

  c.initial = bundle;
  c.steps_per_epoch = 1, c.optimizer.learning_rate = 0;
  LoadedPairs pairs = load_pairs(c, quiet);
  EXPECT_EQ(pairs.data.input_ranges, before.input);
  EXPECT_EQ(pairs.data.output_ranges, before.output);
  Metadata m;
  Metadata ignored;
  const auto after = load_bundle(train(c, pairs.data, pairs.judge.get(), {}).bundle, m);
  EXPECT_EQ(values_of(after), values_of(load_bundle(bundle, ignored)));
  EXPECT_EQ(m.input, before.input);
  EXPECT_EQ(m.output, before.output);
}

TEST_F(Initial, InMetresTheNormalisationIsThatOfTheMesh) {
  TrainConfig c = config("metres");
  c.serves = "mesh", c.images.units = "metres";
  c.initial = make(c);
  PairData data;
  data.representation.kind = std::get<conversion::GeometryImageSpec>(read_metadata(c.initial).representation.kind);
  data.input_channels.resize(17), data.answer_channels.resize(3);
  data.meshes[0].constants.shape = {read_metadata(c.initial).constants, 1, 1};
  EXPECT_FALSE(take_initial_ranges(c, data));
  EXPECT_TRUE(data.input_ranges.empty());
}

TEST_F(Initial, WhatDiffersIsNamedBeforeAnythingIsConverted) {
  TrainConfig c = config("first");
  const std::string bundle = make(c);
  fs::remove_all(data_ / "images");
  const auto fault = [&](const auto& change) {
    TrainConfig other = config("other");
    other.initial = bundle;
    change(other);
    const Error error = error_of([&] { load_pairs(other, quiet); });
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    EXPECT_FALSE(fs::exists(data_ / "images"));
    return std::string(error.what());
  };
  EXPECT_THAT(fault([](TrainConfig& o) {
                o.architecture = complete(
                    {"mfsr", R"({"blocks": 1, "layers": 2, "growth": 4, "features": 9, "upsampling": "subpixel"})"});
              }),
              HasSubstr("first.pt: can't begin this training, its architecture.features is 8, the configuration's 9"));
  EXPECT_THAT(fault([](TrainConfig& o) { o.architecture = complete({"srresnet", "{}"}); }), HasSubstr("architecture"));
  EXPECT_THAT(fault([](TrainConfig& o) { o.serves = "mesh", o.images.units = "metres"; }),
              HasSubstr("geometry_image.units is \"UNITS_COARSE_EDGES\", the configuration's \"UNITS_METRES\""));
  EXPECT_THAT(fault([](TrainConfig& o) { o.window = 3; }), HasSubstr("window is 1, the configuration's 3"));
}

TEST_F(Initial, ABundleSaysWhatTheConfigurationHasToBe) {
  const std::string bundle = make(config("first"));
  const fs::path file = temporary_.path() / "own.json";
  std::ofstream(file) << R"({"name": "own", "dataset": ")" << data_.string() << R"(", "output": "o", "window": 3,
    "architecture": {"kind": "srresnet"}, "losses": {"kinematic": 0}, "batch": 3})";
  const TrainConfig c = read_train_config(file.string(), changes_to_begin_with(bundle));
  EXPECT_EQ(c.initial, bundle);
  EXPECT_EQ(c.architecture.kind, "mfsr");
  EXPECT_EQ(c.architecture.options, config("first").architecture.options);
  EXPECT_EQ(c.serves, "any");
  EXPECT_EQ(c.images.units, "coarse_edges");
  EXPECT_EQ(c.window, 1);
  EXPECT_EQ(c.batch, 3);
  EXPECT_EQ(load_pairs(c, quiet).data.input_ranges, read_metadata(bundle).input);
  EXPECT_THAT(error_of([&] { changes_to_begin_with(file.string()); }).what(), HasSubstr("no model bundle"));
  EXPECT_EQ(error_of([&] { changes_to_begin_with("none.pt"); }).code(), ErrorCode::kNotFound);
}

}  // namespace
}  // namespace pleat::superres
