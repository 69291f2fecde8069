#include "services/conversion/vertex_features/extraction.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <fstream>
#include <limits>

#include "common/mesh/obj.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/services/conversion/vertex_features/sheets.hpp"

namespace pleat::conversion {
namespace {

constexpr RotationCode kCodes[] = {RotationCode::kLogarithm, RotationCode::kQuaternion};

ExtractedFrame extract(const FeatureExtractor& extractor, const Positions& positions, float heading = 0) {
  ExtractedFrame frame;
  extractor.extract(positions, heading, {}, frame);
  return frame;
}

double largest_difference(const std::vector<float>& a, const std::vector<float>& b) {
  EXPECT_EQ(a.size(), b.size());
  double largest = 0;
  for (std::size_t k = 0; k < a.size(); ++k) largest = std::max(largest, static_cast<double>(std::abs(a[k] - b[k])));
  return largest;
}

TEST(Extraction, ReproducesTheAuthorsProgram) {
  const std::string folder = "tests/unit/services/conversion/vertex_features/golden/";
  const Topology rest = read_obj(folder + "rest.obj");
  const FeatureExtractor extractor(test::rings_of(rest), RotationCode::kLogarithm);
  const ExtractedFrame frame = extract(extractor, read_obj(folder + "bent.obj").rest_positions);
  std::ifstream file(folder + "features.txt");
  const std::size_t count = extractor.rings().vertex_count();
  double rotation = 0, stretch = 0;
  for (std::size_t v = 0; v < count; ++v) {
    for (std::size_t c = 0; c < 9; ++c) {
      double expected = 0;
      ASSERT_TRUE(file >> expected);
      const double error = std::abs(static_cast<double>(frame.values[c * count + v]) - expected);
      (c < 3 ? rotation : stretch) = std::max(c < 3 ? rotation : stretch, error);
    }
  }
  EXPECT_LE(rotation, 1e-4);
  EXPECT_LE(stretch, 2e-5);
  double energy = 0;
  for (const auto& e : extractor.rings().edges()) {
    for (int k = 0; k < 3; ++k) energy += std::pow(static_cast<double>(frame.labels[e.a][k] - frame.labels[e.b][k]), 2);
  }
  EXPECT_NEAR(energy, 19.766, 0.01);
}

TEST(Extraction, RestIsTheIdentity) {
  const Topology t = test::sheet(13, 9, 0.05f);
  for (const RotationCode code : kCodes) {
    const FeatureExtractor extractor(test::rings_of(t), code);
    const ExtractedFrame frame = extract(extractor, t.rest_positions);
    const std::size_t count = extractor.rings().vertex_count();
    const auto rotations = static_cast<std::size_t>(rotation_channels(code));
    ASSERT_EQ(feature_channel_names(code).size(), rotations + 6);
    for (std::size_t c = 0; c < rotations + 6; ++c) {
      const std::string name = feature_channel_names(code)[c];
      const bool one = name == "rotation_w" || name == "stretch_xx" || name == "stretch_yy" || name == "stretch_zz";
      for (std::size_t v = 0; v < count; ++v) EXPECT_NEAR(frame.values[c * count + v], one ? 1 : 0, 2e-6f) << name;
    }
  }
}

TEST(Extraction, IgnoresPlaceAndHeading) {
  const Topology t = test::sheet(17, 17, 0.06f);
  const Positions wavy = test::deform(t, test::waves);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(2.5f, Eigen::Vector3f::UnitY()).matrix();
  const Positions moved = (wavy * turn.transpose()).rowwise() + Eigen::RowVector3f(0.4f, -0.2f, 0.9f);
  for (const RotationCode code : kCodes) {
    const FeatureExtractor extractor(test::rings_of(t), code);
    EXPECT_LT(largest_difference(extract(extractor, wavy).values, extract(extractor, moved, 2.5f).values), 1e-5);
  }
}

TEST(Extraction, FeaturesGiveTheGradientsBack) {
  const Topology t = test::sheet(17, 17, 0.06f);
  Positions p = test::deform(t, test::waves);
  p.row(40) = p.row(41);  // a collapsed edge, and one-rings that are turned inside out
  p.row(100) += Eigen::RowVector3f(0.2f, 0, 0.3f);
  const auto rings = test::rings_of(t);
  const GradientField expected = test::gradients_of(*rings, p);
  bool reflected = false;
  for (const RotationCode code : kCodes) {
    GradientField field;
    gradients_from_features(code, extract(FeatureExtractor(rings, code), p).values, field);
    for (std::size_t v = 0; v < rings->vertex_count(); ++v) {
      const Eigen::Matrix3f gradient = expected.at(v);
      reflected = reflected || gradient.determinant() < -1e-3f;
      EXPECT_LT((field.at(v) - gradient).norm(), 1e-5f * std::max(1.0f, gradient.norm())) << v;
    }
  }
  EXPECT_TRUE(reflected);
}

TEST(Extraction, EverythingCollapsedIsStillFinite) {
  const Topology t = test::sheet(9, 9, 0.1f);
  for (const RotationCode code : kCodes) {
    const ExtractedFrame frame = extract(FeatureExtractor(test::rings_of(t), code), Positions::Zero(81, 3));
    for (const float value : frame.values) EXPECT_TRUE(std::isfinite(value));
  }
}

TEST(Extraction, SameInputSameBits) {
  const Topology t = test::sheet(17, 16, 0.06f);
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kLogarithm);
  ExtractedFrame used = extract(extractor, t.rest_positions);
  const std::vector<Float4> previous = used.labels;
  extractor.extract(test::deform(t, test::waves), 0.3f, previous, used);
  ExtractedFrame fresh;
  extractor.extract(test::deform(t, test::waves), 0.3f, previous, fresh);
  EXPECT_EQ(used.values, fresh.values);
}

TEST(Extraction, RefusesByName) {
  const Topology t = test::sheet(9, 9, 0.1f);
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kLogarithm);
  Positions p = t.rest_positions;
  p(33, 2) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(test::error_of([&] { extract(extractor, p); }).what(), ::testing::HasSubstr("vertex 33"));
  ExtractedFrame frame;
  const std::vector<Float4> previous(80);
  EXPECT_THROW(extractor.extract(t.rest_positions, 0, previous, frame), Error);
  GradientField field;
  EXPECT_THROW(gradients_from_features(RotationCode::kLogarithm, std::vector<float>(10), field), Error);
}

TEST(GradientChannels, FlatMeshesNeedTwoColumns) {
  const Topology flat = test::sheet(9, 9, 0.1f);
  Topology curved = flat;
  curved.rest_positions = test::deform(flat, test::waves);
  for (const Topology* t : std::initializer_list<const Topology*>{&flat, &curved}) {
    const GradientChannels channels(t->rest_positions);
    EXPECT_EQ(channels.channels(), t == &flat ? 6 : 9);
    EXPECT_EQ(channels.names().size(), static_cast<std::size_t>(channels.channels()));
    const GradientField field = test::gradients_of(*test::rings_of(*t), test::deform(flat, test::waves));
    std::vector<float> planes, again;
    GradientField back;
    channels.to_planes(field, planes);
    channels.from_planes(planes, back);
    channels.to_planes(back, again);
    EXPECT_LT(largest_difference(planes, again), 1e-6);
    for (std::size_t v = 0; v < 81; ++v) {
      // The third column is a unit normal where only two are known.
      EXPECT_LT((back.at(v) - field.at(v)).norm(), t == &flat ? 0.3f : 1e-6f);
    }
    EXPECT_THROW(channels.from_planes(std::vector<float>(7), back), Error);
  }
}

TEST(ClampStretch, LeavesWhatIsWithinAndMendsTheRest) {
  GradientField field;
  field.columns.resize(3);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(1, Eigen::Vector3f(1, 2, 2) / 3).matrix();
  const Eigen::Vector3f stretches[3] = {{1.5f, 0.5f, 1}, {9, 0.1f, 1}, {1, 1, -1}};
  for (std::size_t k = 0; k < 3; ++k) field.set(k, turn * stretches[k].asDiagonal());
  clamp_stretch(field);
  EXPECT_LT((field.at(0) - turn * stretches[0].asDiagonal()).norm(), 1e-5f);
  EXPECT_LT((field.at(1) - turn * Eigen::Vector3f(3, 0.3f, 1).asDiagonal()).norm(), 1e-5f);
  EXPECT_GT(field.at(2).determinant(), 0.9f);
}

}  // namespace
}  // namespace pleat::conversion
