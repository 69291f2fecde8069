// Bundles of version 1 become those of today: what the network computes stays, what was around it is conversion's.
#include "services/superres/bundle/re_export.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "common/base/whole_file.hpp"
#include "common/mesh/garment.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/networks/network.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;
using test::error_of;
using testing::HasSubstr;

constexpr int kOldOutputs = 9, kOutputs = 3, kInputs = 49, kBlock = 16;

class ReExport : public testing::Test {
 protected:
  /// The layers of a network with three heads, and the constants of version 1 around them.
  void write_old(const json& changes, int inputs, int outputs) const {
    const Architecture architecture{
        "mfsr", R"({"blocks": 1, "layers": 2, "growth": 4, "features": 5, "upsampling": "subpixel"})"};
    const Network network(describe(architecture, {inputs, outputs, 4, false}), 3);
    torch::jit::Module module = network.to_script();
    module.register_buffer("local_mean", torch::linspace(-1, 1, 17).view({1, 17, 1, 1}));
    module.register_buffer("local_deviation", torch::linspace(1, 2, 17).view({1, 17, 1, 1}));
    module.register_buffer("local_output", torch::linspace(0.1, 0.9, 9).view({1, 9, 1, 1}));
    module.register_buffer("base_corners", torch::zeros({3, 7}, torch::kInt64));
    json document = {{"format", "pleat.bundle"},
                     {"version", 1},
                     {"name", "old"},
                     {"architecture",
                      {{"kind", "mfsr"},
                       {"blocks", 1},
                       {"layers", 2},
                       {"growth", 4},
                       {"features", 5},
                       {"upsampling", "subpixel"},
                       {"residual", "mesh"},
                       {"axes", "local"},
                       {"conditioned", true}}},
                     {"normalization", {{"minimum", std::vector<float>(9, -1)}, {"maximum", std::vector<float>(9, 3)}}},
                     {"coarse_image", {6, 5}},
                     {"topology_hash", "00000000000000aa"},
                     {"metrics", {{"psnr_db", 70.5}}}};
    document.merge_patch(changes);
    std::ostringstream archive;
    module.save(archive, {{"pleat.json", document.dump()}});
    write_whole_file(old_, archive.str());
  }

  const test::TemporaryFolder temporary_;
  const std::string old_ = (temporary_.path() / "old.pt").string(), new_ = (temporary_.path() / "new.pt").string();
};

TEST_F(ReExport, DetailKeepsTheDisplacements) {
  write_old(json::object(), kInputs, kOldOutputs);
  Metadata unread;
  EXPECT_THAT(error_of([&] { load_bundle(old_, unread); }).what(), HasSubstr("--re-export"));
  re_export(old_, new_);

  Metadata m;
  auto module = load_bundle(new_, m);
  const auto& image = std::get<conversion::GeometryImageSpec>(m.representation.kind);
  EXPECT_EQ(image.layout, conversion::ImageLayout::kDetail);
  EXPECT_EQ(image.base, conversion::DetailBase::kTexels);
  EXPECT_EQ(image.image.coarse_width, 6);
  EXPECT_EQ(m.input.channels(), 17U);
  EXPECT_EQ(m.input.offset[0], -1);
  EXPECT_EQ(m.input.scale[16], 2);
  EXPECT_EQ(m.input.limit, 6);
  EXPECT_EQ(m.output.offset, (std::vector<float>{0, 0, 0}));
  EXPECT_FLOAT_EQ(m.output.scale[2], 0.3F);
  EXPECT_EQ(m.constants, 32);
  EXPECT_EQ(m.topology_hash, "00000000000000aa");
  EXPECT_EQ(m.metrics.at("psnr_db"), 70.5);

  // The first three channels of the old layers' answer.
  std::string text;
  auto before = load_module(old_, text);
  const auto x = torch::rand({1, kInputs, 5, 6});
  const auto expected = before.forward({x}).toTensor().slice(1, 0, kOutputs);
  EXPECT_TRUE(torch::allclose(module.forward({x}).toTensor(), expected, 1e-5, 1e-6));
  EXPECT_EQ(values_of(module).at("heads_bias").size(), static_cast<std::size_t>(kBlock * kOutputs));
  EXPECT_EQ(error_of([&] { re_export(new_, old_); }).code(), ErrorCode::kInvalidArgument);
}

TEST_F(ReExport, PublishedKeepsItsRanges) {
  write_old({{"architecture", {{"residual", "none"}, {"axes", "aligned"}, {"conditioned", false}}}}, 9, kOldOutputs);
  re_export(old_, new_);
  Metadata m;
  load_bundle(new_, m);
  EXPECT_EQ(std::get<conversion::GeometryImageSpec>(m.representation.kind).layout, conversion::ImageLayout::kPublished);
  EXPECT_EQ(m.input, m.output);
  EXPECT_EQ(m.output.offset[8], -1);
  EXPECT_EQ(m.output.scale[8], 4);
  EXPECT_EQ(m.constants, 0);
}

TEST_F(ReExport, ABundleGetsTheRestPositionsOfItsMesh) {
  const std::string garment = "deploy/garments/tablecloth.obj", out = (temporary_.path() / "with.pt").string();
  std::vector<std::string> notes;
  const Topology mesh = read_garment(garment, notes);
  write_old(json::object(), kInputs, kOldOutputs);
  re_export(old_, new_);
  Metadata m;
  auto module = load_bundle(new_, m);
  EXPECT_THAT(error_of([&] { add_rest_mesh(new_, garment, out); }).what(), HasSubstr(topology_hash(mesh)));
  m.topology_hash = topology_hash(mesh);
  save_bundle(module, m, new_);
  add_rest_mesh(new_, garment, out);
  Metadata with;
  auto again = load_bundle(out, with);
  const auto& rest = mesh.rest_positions;
  EXPECT_EQ(with.rest_positions, std::vector<float>(rest.data(), rest.data() + rest.size()));
  with.rest_positions.clear();
  EXPECT_EQ(to_json(with), to_json(m));
  EXPECT_EQ(values_of(again), values_of(module));
}

TEST_F(ReExport, OthersHaveToBeTrainedAgain) {
  write_old({{"architecture", {{"residual", "bilinear"}, {"axes", "aligned"}}}}, kInputs, kOldOutputs);
  const Error error = error_of([&] { re_export(old_, new_); });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_THAT(error.what(), HasSubstr("train it again"));
  std::ofstream(old_) << "no archive";
  EXPECT_EQ(error_of([&] { re_export(old_, new_); }).code(), ErrorCode::kDataLoss);
}

}  // namespace
}  // namespace pleat::superres
