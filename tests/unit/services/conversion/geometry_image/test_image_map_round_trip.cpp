// Mesh to fine image and back: the errors of docs/conversion.md, with room for other wrinkles.
#include <gtest/gtest.h>

#include "common/features/channels.hpp"
#include "common/frame/rigid_alignment.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

using test::Garment;
using test::load_garment;
using test::wrinkled_frame;

struct Case {
  const char* garment;
  FineImageMethod method;
  double texels_per_vertex;
  double rms_m;
  double largest_m;
};

class RoundTrip : public testing::TestWithParam<Case> {};
INSTANTIATE_TEST_SUITE_P(All, RoundTrip,
                         testing::Values(Case{"tablecloth", FineImageMethod::kFitted, 1.4, 2.7e-5, 7e-4},
                                         Case{"tablecloth", FineImageMethod::kFitted, 2, 3e-7, 1e-5},
                                         Case{"tablecloth", FineImageMethod::kFitted, 3, 3e-7, 3e-6},
                                         Case{"skirt", FineImageMethod::kFitted, 2, 2e-5, 1e-3},
                                         Case{"skirt", FineImageMethod::kFitted, 3, 1e-6, 1e-4},
                                         Case{"four charts", FineImageMethod::kFitted, 3, 1e-6, 1e-4},
                                         Case{"moebius strip", FineImageMethod::kFitted, 3, 1e-6, 1e-4},
                                         Case{"degenerate faces", FineImageMethod::kFitted, 3, 1e-6, 1e-4},
                                         Case{"four charts", FineImageMethod::kSampled, 3, 3e-3, 2e-2},
                                         Case{"tablecloth", FineImageMethod::kSampled, 3, 8e-4, 3e-3},
                                         Case{"tablecloth", FineImageMethod::kSampled, 23, 3e-4, 1e-3},
                                         Case{"skirt", FineImageMethod::kSampled, 3, 8e-4, 3e-3}));

// The velocity channels of an image where the fine vertices read it, rotated back.
Positions velocities(const ImageMap& map, const Tensor& image, const RigidTransform& transform) {
  const VertexReads& reads = map.vertex_reads();
  const std::size_t plane = map.fine_mask().size();
  Positions result = Positions::Zero(static_cast<Eigen::Index>(reads.offsets.size()) - 1, 3);
  for (Eigen::Index v = 0; v < result.rows(); ++v) {
    const auto row = static_cast<std::size_t>(v);
    for (std::uint32_t i = reads.offsets[row]; i < reads.offsets[row + 1]; ++i) {
      for (int c = 0; c < 3; ++c) {
        const std::size_t channel = static_cast<std::size_t>(kVelocityChannel + c) * plane;
        result(v, c) += reads.weights[i] * image.values[channel + reads.places[i]];
      }
    }
  }
  return result * transform.rotation;
}

TEST_P(RoundTrip, ReturnsTheMesh) {
  const Garment garment = load_garment(GetParam().garment);
  ImageSpec spec;
  spec.method = GetParam().method;
  spec.texels_per_fine_vertex = GetParam().texels_per_vertex;
  const ImageMap map(garment.coarse, garment.fine(), spec);
  for (const float phase : {0.3f, 2.0f}) {
    Frame coarse = wrinkled_frame(garment.coarse, phase), fine = wrinkled_frame(garment.fine(), phase);
    coarse.positions = test::moved(coarse.positions, test::some_motion());
    fine.positions = test::moved(fine.positions, test::some_motion());
    const RigidTransform transform = map.align(coarse.positions);
    const Tensor image = map.fine_image(fine, transform);
    const Positions back = map.to_mesh(image, transform);
    EXPECT_LT(test::rms(back, fine.positions), GetParam().rms_m);
    EXPECT_LT(test::largest(back, fine.positions), GetParam().largest_m);
    EXPECT_LT(test::rms(velocities(map, image, transform), fine.velocities), 2 * GetParam().rms_m);
  }
}

TEST(RoundTripFitted, TheImageIsNoRougherThanTheSampledOne) {
  const Garment garment = load_garment("tablecloth");
  const Frame fine = wrinkled_frame(garment.fine(), 0.3f);
  const auto roughness = [&](FineImageMethod method) {
    ImageSpec spec;
    spec.method = method;
    const ImageMap map(garment.coarse, garment.fine(), spec);
    const Tensor image = map.fine_image(fine, {});
    const auto width = static_cast<std::size_t>(map.fine_width());
    double sum = 0;
    for (std::size_t i = 0; i + 2 < 3 * width * static_cast<std::size_t>(map.fine_height()); ++i) {
      if (i % width + 2 >= width) continue;
      const double second = static_cast<double>(image.values[i] - 2 * image.values[i + 1] + image.values[i + 2]);
      sum += second * second;
    }
    return sum;
  };
  EXPECT_LT(roughness(FineImageMethod::kFitted), 1.1 * roughness(FineImageMethod::kSampled));
}

// Texels beyond a chart's rim are read with small weights; the fit must not throw them far off for that.
TEST(RoundTripFitted, TexelsAtRimsStayNearTheirNeighbours) {
  for (const char* name : {"four charts", "skirt"}) {
    const Garment garment = load_garment(name);
    const ImageMap map(garment.coarse, garment.fine());
    const Frame fine = wrinkled_frame(garment.fine(), 0.9f);
    const Tensor image = map.fine_image(fine, {});
    const float largest = (fine.positions - garment.fine().rest_positions).cwiseAbs().maxCoeff();
    for (std::size_t i = 0; i < image.values.size() / 3; ++i) ASSERT_LT(std::abs(image.values[i]), 1.02f * largest);
  }
}

TEST(RoundTripFitted, AVertexWithoutFacesMovesWithTheAlignment) {
  Garment garment = load_garment("tablecloth");
  Topology fine = garment.fine();
  fine.rest_positions.conservativeResize(fine.vertex_count() + 1, 3);
  fine.rest_positions.row(fine.vertex_count() - 1) << 1, 2, 3;
  const ImageMap map(garment.coarse, fine);
  Frame frame;
  frame.positions = test::moved(fine.rest_positions, test::some_motion());
  const RigidTransform transform = kabsch(frame.positions, fine.rest_positions);
  const Positions back = map.to_mesh(map.fine_image(frame, transform), transform);
  EXPECT_LT(test::largest(back, frame.positions), 1e-5);
}

TEST(RoundTripFitted, AFineMeshThatIsNotASubdivision) {
  const Garment garment = load_garment("tablecloth");
  const Topology fine = test::other_sheet(garment.coarse, 87, 59);
  const ImageMap map(garment.coarse, fine);
  const Frame coarse = wrinkled_frame(garment.coarse, 0.6f), frame = wrinkled_frame(fine, 0.6f);
  const RigidTransform transform = map.align(coarse.positions);
  const Positions back = map.to_mesh(map.fine_image(frame, transform), transform);
  EXPECT_LT(test::rms(back, frame.positions), 1e-6);
  EXPECT_LT(test::largest(back, frame.positions), 1e-4);
}

TEST(RoundTripSeam, BothSidesOfTheSeamAgree) {
  const Garment garment = load_garment("skirt");
  ASSERT_GT(garment.fine().uv.rows(), garment.fine().vertex_count());
  const ImageMap map(garment.coarse, garment.fine());
  const Frame fine = wrinkled_frame(garment.fine(), 0.9f);
  const Positions back = map.to_mesh(map.fine_image(fine, {}), {});
  std::vector<std::uint32_t> first(static_cast<std::size_t>(garment.fine().vertex_count()), 0xffffffffu);
  int seam_vertices = 0;
  for (Eigen::Index f = 0; f < garment.fine().face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t v = garment.fine().faces(f, k), u = garment.fine().uv_faces(f, k);
      if (first[v] == 0xffffffffu) first[v] = u;
      if (first[v] == u) continue;
      ++seam_vertices;
      EXPECT_LT((back.row(v) - fine.positions.row(v)).norm(), 1e-4f);
    }
  }
  EXPECT_GT(seam_vertices, 20);
}

// Charts that touch in material space but not on the body: reads must not mix them.
TEST(RoundTripSeam, ChartsSideBySideDoNotBleed) {
  Topology t;
  t.rest_positions.resize(8, 3);
  t.rest_positions << 0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1, 5, 0, 0, 6, 0, 0, 6, 0, -1, 5, 0, -1;
  t.faces.resize(4, 3);
  t.faces << 0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7;
  t.uv.resize(8, 2);
  t.uv << 0, 0, 1, 0, 1, 1, 0, 1, 1.001f, 0, 2, 0, 2, 1, 1.001f, 1;
  t.uv_faces = t.faces;
  for (const FineImageMethod method : {FineImageMethod::kFitted, FineImageMethod::kSampled}) {
    ImageSpec spec;
    spec.coarse_width = 4;
    spec.coarse_height = 2;
    spec.method = method;
    const ImageMap map(t, t, spec);
    Frame frame;
    frame.positions = t.rest_positions;
    frame.positions.topRows(4).col(1).array() += 10;  // the charts part by 10 m
    const Positions back = map.to_mesh(map.fine_image(frame, {}), {});
    EXPECT_LT(test::largest(back, frame.positions), 1e-2);
  }
}

}  // namespace
}  // namespace pleat::conversion
