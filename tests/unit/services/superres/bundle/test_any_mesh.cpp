#include "services/superres/bundle/any_mesh.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/mesh/connectivity.hpp"
#include "common/mesh/obj.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/networks/network.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::superres {
namespace {

using test::error_of;
using testing::HasSubstr;

constexpr const char* kMesh = "deploy/garments/sheet.obj";

class AnyMesh : public testing::Test {
 protected:
  AnyMesh() {
    metadata_.name = "old";
    metadata_.architecture =
        complete({"mfsr", R"({"blocks": 1, "layers": 2, "growth": 4, "features": 5, "upsampling": "subpixel"})"});
    image().layout = conversion::ImageLayout::kDetail;
    image().image.coarse_width = image().image.coarse_height = 16;
    metadata_.input = {std::vector<float>(17, 1.0F), std::vector<float>(17, 2.0F), 6};
    metadata_.output = {{0, 0, 0}, {0.5F, 0.5F, 0.5F}, 0};
    metadata_.constants = 32;
    metadata_.topology_hash = topology_hash(read_obj(kMesh));
  }
  conversion::GeometryImageSpec& image() {
    return std::get<conversion::GeometryImageSpec>(metadata_.representation.kind);
  }
  void save() {
    save_bundle(Network(describe(metadata_.architecture, ports_of(metadata_)), 3).to_script(), metadata_, old_);
  }

  Metadata metadata_;
  const test::TemporaryFolder temporary_;
  const std::string old_ = (temporary_.path() / "old.pt").string(), new_ = (temporary_.path() / "any.pt").string();
};

TEST_F(AnyMesh, RangesAreInCoarseEdges) {
  save();
  serve_any_mesh(old_, kMesh, new_);
  Metadata m, before;
  const auto module = load_bundle(new_, m), old = load_bundle(old_, before);
  EXPECT_EQ(m.name, "any");
  EXPECT_EQ(m.topology_hash, "");
  const auto& made = std::get<conversion::GeometryImageSpec>(m.representation.kind);
  EXPECT_EQ(made.units, conversion::DetailUnits::kCoarseEdges);
  EXPECT_EQ(made.image.coarse_width, 0);
  const auto edge = static_cast<float>(mean_edge_length(read_obj(kMesh)));
  EXPECT_EQ(m.input.scale[0], 2);                                    // strain
  EXPECT_FLOAT_EQ(m.input.scale[5], 2 / edge);                       // curvature
  EXPECT_EQ(m.input.offset[12], 1);                                  // normal
  EXPECT_FLOAT_EQ(m.input.offset[16], 1 / std::sqrt(9.81F * edge));  // velocity
  EXPECT_FLOAT_EQ(m.output.scale[1], 0.5F / edge);
  EXPECT_EQ(m.input.limit, 6);
  EXPECT_EQ(values_of(module), values_of(old));
}

TEST_F(AnyMesh, OthersAreRefused) {
  save();
  EXPECT_THAT(error_of([&] { serve_any_mesh(old_, "deploy/garments/disk.obj", new_); }).what(), HasSubstr("disk.obj"));
  serve_any_mesh(old_, kMesh, new_);
  EXPECT_THAT(error_of([&] { serve_any_mesh(new_, kMesh, old_); }).what(), HasSubstr("in metres"));
  image().layout = conversion::ImageLayout::kPublished;
  metadata_.input = metadata_.output = {std::vector<float>(9, 1.0F), std::vector<float>(9, 2.0F), 0};
  metadata_.constants = 0;
  save();
  EXPECT_THAT(error_of([&] { serve_any_mesh(old_, kMesh, new_); }).what(), HasSubstr("in metres"));
}

}  // namespace
}  // namespace pleat::superres
