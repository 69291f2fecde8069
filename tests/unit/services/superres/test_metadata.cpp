// pleat.json: everything that is written comes back, and every fault is named.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "services/superres/metadata.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;
using testing::HasSubstr;

Metadata example() {
  Metadata m;
  m.name = "example";
  m.architecture = {2, 3, 4, 5, "subpixel", "bilinear", "aligned", true};
  m.normalization.minimum.fill(-2);
  m.normalization.maximum.fill(3);
  m.coarse_width = 6, m.coarse_height = 5, m.fine_width = 24, m.fine_height = 20;
  m.image_spec = R"({"method":"fitted"})";
  m.topology_hash = "0123456789abcdef";
  m.float32_parameters = {"shallow"};
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
  EXPECT_EQ(m.architecture.upsampling, "subpixel");
  EXPECT_EQ(m.architecture.growth, 4);
  EXPECT_EQ(m.parameters, 1234);
  EXPECT_FLOAT_EQ(m.normalization.maximum[8], 3);
  EXPECT_EQ(m.fine_height, 20);
}

TEST(Metadata, EveryRequiredKeyIsMissedByName) {
  for (const char* key : {"format", "version", "name", "architecture", "scale", "channels", "normalization",
                          "coarse_image", "fine_image", "topology_hash", "velocity"}) {
    const Error error = error_of([&](json& d) { d.erase(key); });
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument) << key;
    EXPECT_THAT(error.what(), HasSubstr(key));
    EXPECT_THAT(error.what(), HasSubstr("bundle.pt"));
  }
}

TEST(Metadata, ContradictionsAreRefused) {
  EXPECT_THAT(error_of([](json& d) { d["version"] = 2; }).what(), HasSubstr("version 2"));
  EXPECT_THAT(error_of([](json& d) { d["format"] = "onnx"; }).what(), HasSubstr("format"));
  EXPECT_THAT(error_of([](json& d) { d["fine_image"] = {24, 21}; }).what(), HasSubstr("4 times"));
  EXPECT_THAT(error_of([](json& d) { d["coarse_image"] = {0, 5}; }).what(), HasSubstr("coarse_image"));
  EXPECT_THAT(error_of([](json& d) { d["coarse_image"] = {1000000000, 5}; }).what(), HasSubstr("coarse_image"));
  EXPECT_THAT(error_of([](json& d) { d["normalization"]["maximum"][4] = -2; }).what(), HasSubstr("normal_y"));
  EXPECT_THAT(error_of([](json& d) { d["normalization"]["minimum"].erase(0); }).what(), HasSubstr("needs 9"));
  EXPECT_THAT(error_of([](json& d) { d["channels"][0] = "height"; }).what(), HasSubstr("channels"));
  EXPECT_THAT(error_of([](json& d) { d["scale"] = 2; }).what(), HasSubstr("scale"));
  EXPECT_THAT(error_of([](json& d) { d["velocity"] = "forward"; }).what(), HasSubstr("forward"));
  EXPECT_THAT(error_of([](json& d) { d["architecture"]["blocks"] = 1000000; }).what(), HasSubstr("blocks"));
  EXPECT_THAT(error_of([](json& d) { d["architecture"]["upsampling"] = "magic"; }).what(), HasSubstr("magic"));
  EXPECT_THAT(error_of([](json& d) { d["name"] = 5; }).what(), HasSubstr("wrong type"));
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
