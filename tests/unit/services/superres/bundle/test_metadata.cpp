// pleat.json: everything that is written comes back, and every fault is named.
#include "services/superres/bundle/metadata.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;
using testing::HasSubstr;

Metadata example() {
  Metadata m;
  m.name = "example";
  m.architecture = complete({"mfsr", R"({"blocks": 2, "growth": 4, "upsampling": "subpixel"})"});
  conversion::GeometryImageSpec image;
  image.layout = conversion::ImageLayout::kDetail;
  image.base = conversion::DetailBase::kTexels;
  image.image.coarse_width = 6, image.image.coarse_height = 5, image.image.scale = 2;
  m.representation.kind = image;
  m.representation.subdivision = {1, SubdivisionRule::kSmooth};
  m.representation.window = 3;
  m.input = {std::vector<float>(17, 0.5F), std::vector<float>(17, 2), 6};
  m.output = {{0, 0, 0}, {0.1F, 0.2F, 0.3F}, 0};
  m.constants = 8;
  m.topology_hash = "0123456789abcdef";
  m.rest_positions = {0.1F, 0, -2, 1e-7F, 3, 1};
  m.float32_parameters = {"shallow0_"};
  m.training = R"({"epoch":7})";
  m.metrics = {{"psnr_db", 71.5}};
  m.git_revision = "abc";
  m.parameters = 1234;
  return m;
}

/// The error that reading a changed document gives.
template <typename Change>
Error error_of(Change change) {
  json document = json::parse(to_json(example()));
  change(document);
  try {
    metadata_from_json(document.dump(), "bundle.pt");
  } catch (const Error& error) {
    return error;
  }
  return Error(ErrorCode::kInternal, "no error");
}

TEST(Metadata, RoundTrip) {
  const Metadata m = metadata_from_json(to_json(example()), "x");
  EXPECT_EQ(to_json(m), to_json(example()));
  const auto& image = std::get<conversion::GeometryImageSpec>(m.representation.kind);
  EXPECT_EQ(image.layout, conversion::ImageLayout::kDetail);
  EXPECT_EQ(image.base, conversion::DetailBase::kTexels);
  EXPECT_EQ(image.image.coarse_width, 6);
  EXPECT_EQ(m.representation.subdivision, (SubdivisionSpec{1, SubdivisionRule::kSmooth}));
  EXPECT_EQ(m.input, example().input);
  EXPECT_EQ(m.output, example().output);
  EXPECT_EQ(json::parse(m.architecture.options).at("growth"), 4);
  EXPECT_EQ(m.parameters, 1234);
}

TEST(Metadata, PortsCountFramesAndConstants) {
  const Ports ports = ports_of(example());
  EXPECT_EQ(ports.inputs, 3 * 17 + 8);
  EXPECT_EQ(ports.outputs, 3);
  EXPECT_EQ(ports.scale, 2);
  EXPECT_TRUE(ports.detail);
}

TEST(Metadata, VertexFeaturesComeBack) {
  Metadata m = example();
  conversion::VertexFeatureSpec features;
  features.rotation = conversion::RotationCode::kQuaternion;
  features.fixed_axes = true;
  features.passes = 0;
  features.anchor_weight = 0.5;
  features.obstacles = true;
  m.representation.kind = features;
  m.representation.subdivision = {3};
  m.architecture = complete({"tokens", "{}"});
  const Metadata back = metadata_from_json(to_json(m), "x");
  EXPECT_EQ(to_json(back), to_json(m));
  const auto& read = std::get<conversion::VertexFeatureSpec>(back.representation.kind);
  EXPECT_EQ(read.rotation, conversion::RotationCode::kQuaternion);
  EXPECT_TRUE(read.fixed_axes);
  EXPECT_EQ(read.passes, 0);
  EXPECT_EQ(read.anchor_weight, 0.5);
  EXPECT_TRUE(read.obstacles);
  const Ports ports = ports_of(back);
  EXPECT_EQ(ports.scale, 7);
  EXPECT_EQ(ports.window, 3);
  EXPECT_TRUE(ports.detail);
}

TEST(Metadata, WhatIsAnsweredAndRememberedComesBack) {
  Metadata m = example();
  conversion::VertexFeatureSpec features;
  features.answer = conversion::AnswerKind::kFeaturesAlone;
  m.representation.kind = features;
  m.architecture = complete({"published", R"({"latent": 8})"});
  m.memory = {24, 1, 1};
  m.input_size = {1, 128};
  const Metadata back = metadata_from_json(to_json(m), "x");
  EXPECT_EQ(to_json(back), to_json(m));
  EXPECT_EQ(std::get<conversion::VertexFeatureSpec>(back.representation.kind).answer,
            conversion::AnswerKind::kFeaturesAlone);
  EXPECT_EQ(memory_values(back), 24U);
  EXPECT_FALSE(ports_of(back).detail);
  EXPECT_EQ(ports_of(back).block, 6) << "one round: vertices and middles of edges";
  EXPECT_EQ(memory_values(example()), 0U);
  for (const json& memory : {json{-1, 1, 1}, json{100000, 1000, 1}, json{1, 2}, json("much")}) {
    EXPECT_THAT(error_of([&](json& d) { d["memory"] = memory; }).what(), HasSubstr("memory")) << memory;
  }
}

TEST(Metadata, EveryRequiredKeyIsMissedByName) {
  for (const char* key : {"format", "version", "name", "architecture", "representation", "topology_hash", "velocity"}) {
    const Error error = error_of([&](json& d) { d.erase(key); });
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument) << key;
    EXPECT_THAT(error.what(), HasSubstr(key));
    EXPECT_THAT(error.what(), HasSubstr("bundle.pt"));
  }
  for (const char* key : {"geometry_image", "input", "output"}) {
    EXPECT_THAT(error_of([&](json& d) { d["representation"].erase(key); }).what(), HasSubstr(key));
  }
}

TEST(Metadata, ContradictionsAreRefused) {
  EXPECT_THAT(error_of([](json& d) { d["version"] = 3; }).what(), HasSubstr("version 3"));
  EXPECT_THAT(error_of([](json& d) { d["format"] = "onnx"; }).what(), HasSubstr("format"));
  const auto image = [](const char* key, const json& value) {
    return std::string(error_of([&](json& d) { d["representation"]["geometry_image"][key] = value; }).what());
  };
  EXPECT_THAT(image("width", -5), HasSubstr("width"));
  EXPECT_THAT(image("width", 1000000000), HasSubstr("width"));
  EXPECT_THAT(image("scale", 17), HasSubstr("scale"));
  EXPECT_THAT(image("layout", "LAYOUT_CUBE"), HasSubstr("LAYOUT_CUBE"));
  const auto representation = [](const char* key, const json& value) {
    return std::string(error_of([&](json& d) { d["representation"][key] = value; }).what());
  };
  EXPECT_THAT(representation("window", 17), HasSubstr("window"));
  EXPECT_THAT(representation("window_stride", 17), HasSubstr("window_stride"));
  EXPECT_THAT(representation("subdivision_rounds", 6), HasSubstr("subdivision_rounds"));
  EXPECT_THAT(error_of([](json& d) { d["representation"]["input"]["scale"].erase(0); }).what(), HasSubstr("input"));
  EXPECT_THAT(error_of([](json& d) { d["representation"]["output"]["scale"][1] = -2; }).what(), HasSubstr("output"));
  EXPECT_THAT(error_of([](json& d) {
                d["representation"]["output"] = {{"offset", json::array()}, {"scale", json::array()}};
              }).what(),
              HasSubstr("no channels"));
  EXPECT_THAT(error_of([](json& d) { d["velocity"] = "forward"; }).what(), HasSubstr("forward"));
  EXPECT_THAT(error_of([](json& d) { d["architecture"]["blocks"] = 1000000; }).what(), HasSubstr("blocks"));
  EXPECT_THAT(error_of([](json& d) { d["architecture"]["upsampling"] = "magic"; }).what(), HasSubstr("magic"));
  EXPECT_THAT(error_of([](json& d) { d["name"] = 5; }).what(), HasSubstr("wrong type"));
}

TEST(Metadata, EarlierBundlesAreRefusedWithTheCommandThatMendsThem) {
  const Error error = error_of([](json& d) { d["version"] = 1; });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_THAT(error.what(), HasSubstr("pleat-train --re-export bundle.pt --out"));
}

TEST(Metadata, TextThatIsNoJsonIsDataLoss) {
  try {
    metadata_from_json(to_json(example()).substr(0, 100), "bundle.pt");
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kDataLoss);
  }
}

TEST(Metadata, ForeignModulesNeedNoSizes) {
  json document = json::parse(to_json(example()));
  document["architecture"] = {{"kind", "diffusion"}};
  EXPECT_EQ(metadata_from_json(document.dump(), "x").architecture.kind, "diffusion");
}

}  // namespace
}  // namespace pleat::superres
