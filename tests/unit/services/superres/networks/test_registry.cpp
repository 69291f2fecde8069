#include "services/superres/networks/registry.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

std::string refusal(const Architecture& architecture) {
  try {
    complete(architecture);
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    return error.what();
  }
  return "";
}

TEST(Registry, FillsInTheOptionsOfEveryKind) {
  for (const std::string& kind : network_kinds()) {
    EXPECT_TRUE(is_registered(kind));
    const Architecture whole = complete({kind, R"({"blocks": 3})"});
    const auto options = nlohmann::json::parse(whole.options);
    EXPECT_EQ(options.at("blocks"), 3) << kind;
    EXPECT_EQ(options.at("features"), 64) << kind;
    EXPECT_EQ(complete(whole).options, whole.options);
  }
  EXPECT_FALSE(is_registered("gan"));
}

TEST(Registry, NamesWhatItRefuses) {
  EXPECT_NE(refusal({"gan", "{}"}).find("'gan'"), std::string::npos);
  EXPECT_NE(refusal({"mfsr", R"({"blocks": 0})"}).find("blocks"), std::string::npos);
  EXPECT_NE(refusal({"mfsr", R"({"features": 100000})"}).find("features"), std::string::npos);
  EXPECT_NE(refusal({"mfsr", R"({"features": "wide"})"}).find("features"), std::string::npos);
  EXPECT_NE(refusal({"mfsr", R"({"upsampling": "nearest"})"}).find("upsampling"), std::string::npos);
  EXPECT_NE(refusal({"srresnet", R"({"layers": 4})"}).find("'layers'"), std::string::npos);
  EXPECT_NE(refusal({"mfsr", "[1]"}).find("no JSON object"), std::string::npos);
}

TEST(Registry, PortsDecideTheEnds) {
  for (const std::string& kind : network_kinds()) {
    for (const int scale : {1, 2, 4, 8}) {
      const Description network = describe({kind, R"({"blocks": 1, "features": 8})"}, {17, 3, scale, true});
      EXPECT_EQ(network.inputs, 17);
      EXPECT_EQ(network.outputs(), 3);
      EXPECT_EQ(network.sizes({5, 7}).back(), (Size{scale * 5, scale * 7})) << kind;
    }
  }
  EXPECT_THROW(describe({"chen2018", "{}"}, {3, 3, 3, false}), Error);
}

}  // namespace
}  // namespace pleat::superres
