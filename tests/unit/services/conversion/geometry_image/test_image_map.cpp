#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "common/base/error.hpp"
#include "common/frame/rigid_alignment.hpp"
#include "services/conversion/geometry_image/chart_raster.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

using test::Garment;
using test::load_garment;
using test::wrinkled_frame;

class Garments : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(All, Garments, testing::ValuesIn(test::kGarments));

// The slow and obvious value of one texel: search all faces for the one that holds the centre.
struct Direct {
  bool inside = false;
  Eigen::Vector3d value = Eigen::Vector3d::Zero();
};

Direct evaluate_directly(const Topology& t, const Positions& values, double u, double v) {
  Direct result;
  double deepest = -1e-6;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    Eigen::Matrix3d corners;
    for (int k = 0; k < 3; ++k) corners.col(k) << t.uv.row(t.uv_faces(f, k)).cast<double>().transpose(), 1;
    if (std::abs(corners.determinant()) < 1e-12) continue;
    const Eigen::Vector3d weights = corners.inverse() * Eigen::Vector3d(u, v, 1);
    if (weights.minCoeff() < deepest) continue;
    deepest = weights.minCoeff();
    result.inside = true;
    result.value.setZero();
    for (int k = 0; k < 3; ++k) result.value += weights(k) * values.row(t.faces(f, k)).cast<double>().transpose();
  }
  return result;
}

TEST_P(Garments, SampledTexelsAreBarycentricValuesAtTheirCentres) {
  const Garment garment = load_garment(GetParam());
  ImageSpec spec;
  spec.method = FineImageMethod::kSampled;
  const ImageMap map(garment.coarse, garment.fine(), spec);
  const Frame frame = wrinkled_frame(garment.fine(), 0.7f);
  const RigidTransform motion = test::some_motion();
  const Tensor image = map.fine_image(frame, motion);
  const Positions displacement = test::moved(frame.positions, motion) - garment.fine().rest_positions;

  const Eigen::RowVector2d low = garment.fine().uv.colwise().minCoeff().cast<double>();
  const Eigen::RowVector2d high = garment.fine().uv.colwise().maxCoeff().cast<double>();
  const int width = map.fine_width(), height = map.fine_height();
  const auto plane = static_cast<std::size_t>(width * height);
  int checked = 0;
  for (int i = 0; i < width * height; i += 397) {
    const double u = low.x() + (i % width) * (high.x() - low.x()) / (width - 1);
    const double v = low.y() + (i / width) * (high.y() - low.y()) / (height - 1);
    const Direct direct = evaluate_directly(garment.fine(), displacement, u, v);
    const auto texel = static_cast<std::size_t>(i);
    if (!direct.inside) continue;
    EXPECT_EQ(map.fine_mask()[texel], 1) << i;
    ++checked;
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(image.values[c * plane + texel], direct.value(static_cast<Eigen::Index>(c)), 1e-5) << "texel " << i;
    }
  }
  EXPECT_GT(checked, 20);
}

TEST_P(Garments, VertexReadsAreWhatToMeshReads) {
  const Garment garment = load_garment(GetParam());
  const ImageMap map(garment.coarse, garment.fine());
  Tensor image{{3, map.fine_height(), map.fine_width()}, {}, {}};
  const std::size_t plane = map.fine_mask().size();
  for (std::size_t i = 0; i < 3 * plane; ++i) image.values.push_back(std::sin(0.37F * static_cast<float>(i)));
  const VertexReads& reads = map.vertex_reads();
  ASSERT_EQ(reads.offsets.size(), static_cast<std::size_t>(garment.fine().vertex_count()) + 1);
  const Positions expected = map.to_mesh(image, {});
  for (Eigen::Index v = 0; v < expected.rows(); ++v) {
    Eigen::Vector3f position = garment.fine().rest_positions.row(v);
    for (auto i = reads.offsets[static_cast<std::size_t>(v)]; i < reads.offsets[static_cast<std::size_t>(v) + 1]; ++i) {
      const std::size_t texel = reads.places[i];
      ASSERT_EQ(map.fine_mask()[texel], 1);
      const Eigen::Vector3f value(image.values[texel], image.values[plane + texel], image.values[2 * plane + texel]);
      position += reads.weights[i] * value;
    }
    ASSERT_LT((position.transpose() - expected.row(v)).norm(), 1e-5F) << v;
  }
}

TEST(ImageMap, ACoarseTexelIsTheCentreOfItsBlock) {
  const Garment garment = load_garment("tablecloth");
  const ImageMap map(garment.coarse, garment.fine());
  // A displacement that is linear in material space has the same value in a coarse texel as in the mean of its block.
  const auto linear_frame = [](const Topology& t) {
    Frame frame;
    frame.positions = t.rest_positions;
    frame.positions.col(0) += 0.3f * t.uv.col(0) - 0.2f * t.uv.col(1);
    return frame;
  };
  Tensor coarse;
  map.coarse_image(linear_frame(garment.coarse), RigidTransform{}, coarse);
  const Tensor fine = map.fine_image(linear_frame(garment.fine()), RigidTransform{});
  const int scale = map.spec().scale, width = map.coarse_width();
  ASSERT_EQ(map.fine_width(), scale * width);
  for (int row = 0; row < map.coarse_height(); ++row) {
    for (int column = 0; column < width; ++column) {
      double mean = 0;
      for (int i = 0; i < scale * scale; ++i) {
        const int texel = (row * scale + i / scale) * map.fine_width() + column * scale + i % scale;
        mean += static_cast<double>(fine.values[static_cast<std::size_t>(texel)]) / (scale * scale);
      }
      EXPECT_NEAR(mean, coarse.values[static_cast<std::size_t>(row * width + column)], 2e-5) << row << ' ' << column;
    }
  }
}

TEST_P(Garments, ARigidMotionLeavesTheImage) {
  const Garment garment = load_garment(GetParam());
  const ImageMap map(garment.coarse, garment.fine());
  const Frame still = wrinkled_frame(garment.coarse, 0.2f);
  Frame frame = still;
  frame.positions = test::moved(still.positions, test::some_motion());
  frame.velocities = still.velocities * test::some_motion().rotation.transpose();
  const CoarseImage a = map.coarse_image(still), b = map.coarse_image(frame);
  ASSERT_EQ(a.image.values.size(), b.image.values.size());
  ASSERT_EQ(a.image.shape, (std::vector<std::int64_t>{9, map.coarse_height(), map.coarse_width()}));
  for (std::size_t i = 0; i < a.image.values.size(); ++i) {
    ASSERT_NEAR(a.image.values[i], b.image.values[i], 2e-5) << i;
  }
}

TEST_P(Garments, ARigidMotionLeavesTheFineImage) {
  const Garment garment = load_garment(GetParam());
  const ImageMap map(garment.coarse, garment.fine());
  Frame coarse = wrinkled_frame(garment.coarse, 0.2f), fine = wrinkled_frame(garment.fine(), 0.2f);
  const Tensor still = map.fine_image(fine, map.align(coarse.positions));
  coarse.positions = test::moved(coarse.positions, test::some_motion());
  fine.positions = test::moved(fine.positions, test::some_motion());
  fine.velocities = fine.velocities * test::some_motion().rotation.transpose();
  const Tensor moved = map.fine_image(fine, map.align(coarse.positions));
  const std::size_t plane = still.values.size() / 9;
  for (std::size_t i = 0; i < still.values.size(); ++i) {
    // The normal of a face that is hardly one turns with every rounding.
    const bool normal = i / plane >= kNormalChannel && i / plane < kVelocityChannel;
    if (normal && GetParam() == std::string("degenerate faces")) continue;
    ASSERT_NEAR(still.values[i], moved.values[i], 3e-3) << i;
  }
}

TEST_P(Garments, BackwardsInTimeTheVelocityTurns) {
  const Garment garment = load_garment(GetParam());
  const ImageMap map(garment.coarse, garment.fine());
  Frame forwards = wrinkled_frame(garment.coarse, 0.4f), backwards = forwards;
  const Positions earlier = wrinkled_frame(garment.coarse, 0.36f).positions;
  forwards.velocities = (forwards.positions - earlier) / 0.04f;
  backwards.velocities = (earlier - backwards.positions) / 0.04f;
  const Tensor a = map.coarse_image(forwards).image, b = map.coarse_image(backwards).image;
  const std::size_t velocity = a.values.size() / 9 * kVelocityChannel;
  bool any = false;
  for (std::size_t i = 0; i < a.values.size(); ++i) {
    ASSERT_EQ(b.values[i], i < velocity ? a.values[i] : -a.values[i]) << i;
    any = any || (i >= velocity && std::abs(a.values[i]) > 0.01f);
  }
  EXPECT_TRUE(any);
}

// Normalised coordinates lose the scale and, with two factors, the aspect: both come back from the rest mesh.
TEST_P(Garments, NormalisedCoordinatesGiveTheSameImages) {
  const Garment metres = load_garment(GetParam());
  Garment normalised = metres;
  const Eigen::RowVector2f low = metres.coarse.uv.colwise().minCoeff();
  const Eigen::RowVector2f extent = metres.coarse.uv.colwise().maxCoeff() - low;
  for (Uv* uv : {&normalised.coarse.uv, &normalised.subdivision.fine.uv}) {
    *uv = (uv->rowwise() - low).array().rowwise() / extent.array();
  }
  const ImageMap a(metres.coarse, metres.fine()), b(normalised.coarse, normalised.fine());
  EXPECT_EQ(recover_material_scale(metres.fine()), Eigen::Vector2d(1, 1));
  const Eigen::Vector2d scale = recover_material_scale(normalised.fine());
  for (int k = 0; k < 2; ++k) EXPECT_NEAR(scale[k] / static_cast<double>(extent[k]), 1, 0.1);
  // The recovered lengths are those of the rest mesh, which may differ a little from the pattern's.
  EXPECT_LE(std::abs(a.fine_width() - b.fine_width()), 16);
  EXPECT_LE(std::abs(a.fine_height() - b.fine_height()), 16);
  ImageSpec same;
  same.coarse_width = a.coarse_width();
  same.coarse_height = a.coarse_height();
  const ImageMap c(normalised.coarse, normalised.fine(), same);
  const Frame frame = wrinkled_frame(metres.coarse, 0.3f);
  const Tensor x = a.coarse_image(frame).image, y = c.coarse_image(frame).image;
  std::size_t different = 0;
  for (std::size_t i = 0; i < x.values.size(); ++i) different += std::abs(x.values[i] - y.values[i]) > 1e-4f;
  EXPECT_LT(different, x.values.size() / 50);  // centres on an edge may fall into the other face, or out of the chart
}

TEST_P(Garments, PaddingShowsTheNearestValidTexel) {
  const Garment garment = load_garment(GetParam());
  const ImageMap map(garment.coarse, garment.fine());
  const CoarseImage coarse = map.coarse_image(wrinkled_frame(garment.coarse, 0.5f));
  const int width = map.coarse_width(), height = map.coarse_height();
  for (int texel = 0; texel < width * height; ++texel) {
    if (map.coarse_mask()[static_cast<std::size_t>(texel)] != 0) continue;
    int nearest = std::numeric_limits<int>::max();
    std::vector<int> candidates;
    for (int other = 0; other < width * height; ++other) {
      if (map.coarse_mask()[static_cast<std::size_t>(other)] == 0) continue;
      const int dx = other % width - texel % width, dy = other / width - texel / width;
      const int squared = dx * dx + dy * dy;
      if (squared < nearest) candidates.clear();
      nearest = std::min(nearest, squared);
      if (squared == nearest) candidates.push_back(other);
    }
    const bool found = std::any_of(candidates.begin(), candidates.end(), [&](int other) {
      return coarse.image.values[static_cast<std::size_t>(other)] ==
             coarse.image.values[static_cast<std::size_t>(texel)];
    });
    EXPECT_TRUE(found) << texel;
  }
}

TEST(ImageSpec, TheTableclothGetsThePublishedDefaultSize) {
  const Garment garment = load_garment("tablecloth");
  const ImageMap map(garment.coarse, garment.fine());
  EXPECT_EQ(map.coarse_width(), 60);
  EXPECT_EQ(map.coarse_height(), 40);
  EXPECT_EQ(map.fine_width(), 240);
  EXPECT_EQ(map.fine_height(), 160);
  ImageSpec paper;
  paper.coarse_width = 192;
  paper.coarse_height = 128;
  EXPECT_EQ(ImageMap(garment.coarse, garment.fine(), paper).fine_width(), 768);
}

TEST(ImageSpec, BadSpecsAreRefused) {
  const Garment garment = load_garment("tablecloth");
  const auto refused = [&](auto change) {
    ImageSpec spec;
    change(spec);
    EXPECT_THROW(ImageMap(garment.coarse, garment.fine(), spec), Error);
  };
  refused([](ImageSpec& s) { s.scale = 0; });
  refused([](ImageSpec& s) { s.scale = 17; });
  refused([](ImageSpec& s) { s.coarse_width = 10; });
  refused([](ImageSpec& s) { s.coarse_width = s.coarse_height = -4; });
  refused([](ImageSpec& s) { s.coarse_width = s.coarse_height = 2'000'000'000; });
  refused([](ImageSpec& s) { s.texels_per_fine_vertex = std::numeric_limits<double>::quiet_NaN(); });
  refused([](ImageSpec& s) { s.lambda = 0; });
}

Topology two_triangles() {
  Topology t;
  t.rest_positions.resize(4, 3);
  t.rest_positions << 0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1;
  t.faces.resize(2, 3);
  t.faces << 0, 1, 2, 0, 2, 3;
  t.uv.resize(4, 2);
  t.uv << 0, 0, 1, 0, 1, 1, 0, 1;
  t.uv_faces = t.faces;
  return t;
}

template <typename Change>
void expect_refused(const Change& change) {
  Topology t = two_triangles();
  change(t);
  EXPECT_THROW(ImageMap(t, t), Error);
}

TEST(ImageMapInput, BadTopologiesAreRefused) {
  EXPECT_NO_THROW(ImageMap(two_triangles(), two_triangles()));
  expect_refused([](Topology& t) {
    t.uv.resize(0, 2);
    t.uv_faces.resize(0, 3);
  });
  expect_refused([](Topology& t) { t.uv.row(3) << 0.9f, 0.1f; });      // folded
  expect_refused([](Topology& t) { t.uv.col(1) = 2 * t.uv.col(0); });  // no face has area
  expect_refused([](Topology& t) { t = test::moebius_strip(true); });  // not orientable
  expect_refused([](Topology& t) { t.uv(1, 1) = std::numeric_limits<float>::infinity(); });
  expect_refused([](Topology& t) { t.uv_faces(0, 0) = 17; });
  expect_refused([](Topology& t) { t.rest_positions(0, 0) = std::numeric_limits<float>::quiet_NaN(); });
  // Two charts of equal orientation on top of each other.
  expect_refused([](Topology& t) {
    t.uv.resize(6, 2);
    t.uv << 0, 0, 1, 0, 1, 1, 0, 0, 1, 0.2f, 0.8f, 1;
    t.uv_faces.resize(2, 3);
    t.uv_faces << 0, 1, 2, 3, 4, 5;
  });
}

TEST(ImageMapInput, AChartSmallerThanATexelReadsItsRim) {
  Topology t = two_triangles();
  t.uv.resize(6, 2);
  t.uv << 0, 0, 1, 0, 1, 1, 0.201f, 0.801f, 0.202f, 0.801f, 0.202f, 0.802f;
  t.uv_faces << 0, 1, 2, 3, 4, 5;
  ImageSpec spec;
  spec.coarse_width = spec.coarse_height = 8;
  const ImageMap map(t, t, spec);
  Frame frame;
  frame.positions = t.rest_positions;
  frame.positions.row(3) = frame.positions.row(0);
  const Positions back = map.to_mesh(map.fine_image(frame, {}), {});
  EXPECT_TRUE(back.allFinite());
  EXPECT_LT((back.row(1) - frame.positions.row(1)).norm(), 1e-3f);
}

TEST(ImageMapInput, BadFramesAreRefused) {
  const ImageMap map(two_triangles(), two_triangles());
  Frame frame;
  frame.positions = two_triangles().rest_positions;
  EXPECT_NO_THROW(map.coarse_image(frame));
  Frame wrong = frame;
  wrong.positions.conservativeResize(3, 3);
  EXPECT_THROW(map.coarse_image(wrong), Error);
  EXPECT_THROW(map.fine_image(wrong, {}), Error);
  wrong = frame;
  wrong.velocities = Positions::Zero(5, 3);
  EXPECT_THROW(map.coarse_image(wrong), Error);
  wrong = frame;
  wrong.positions(0, 0) = std::numeric_limits<float>::infinity();
  EXPECT_THROW(map.coarse_image(wrong), Error);

  Tensor image = map.fine_image(frame, {});
  EXPECT_NO_THROW(map.to_mesh(image, {}));
  image.shape = {9, 3, 3};
  EXPECT_THROW(map.to_mesh(image, {}), Error);
  image = map.fine_image(frame, {});
  std::fill(image.values.begin(), image.values.end(), std::numeric_limits<float>::quiet_NaN());
  EXPECT_THROW(map.to_mesh(image, {}), Error);
}

}  // namespace
}  // namespace pleat::conversion
