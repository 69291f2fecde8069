#include "services/conversion/vertex_features/rotation_labels.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "tests/unit/services/conversion/vertex_features/sheets.hpp"

namespace pleat::conversion {
namespace {

ExtractedFrame labels_of(const FeatureExtractor& extractor, const Positions& p,
                         const ExtractedFrame* before = nullptr) {
  ExtractedFrame frame;
  extractor.extract(p, 0, before != nullptr ? std::span<const Float4>(before->labels) : std::span<const Float4>{},
                    frame);
  return frame;
}

// The sheet over a curve in x and y: turning at a constant rate between x0 and x1, straight elsewhere.
Positions bent(const Topology& t, float x0, float x1, float angle, float wrinkle) {
  return test::deform(t, [&](const Eigen::Vector3f& p) {
    const float radius = (x1 - x0) / angle, a = std::clamp((p.x() - x0) / radius, 0.0f, angle);
    const Eigen::Vector2f direction(std::cos(a), std::sin(a)), normal(-direction.y(), direction.x());
    const Eigen::Vector2f centre(x0, radius);
    Eigen::Vector2f q = p.x() < x0 ? Eigen::Vector2f(p.x(), 0) : Eigen::Vector2f(centre - radius * normal);
    if (p.x() > x1) q += (p.x() - x1) * direction;
    q += wrinkle * std::sin(40 * p.z() + 9 * p.x()) * normal;
    return Eigen::Vector3f(q.x(), q.y(), p.z());
  });
}

TEST(RotationLabels, FoldWithWrinklesIsNotTorn) {
  const Topology t = test::sheet(65, 65, 1.0f / 64);
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kLogarithm);
  const ExtractedFrame frame = labels_of(extractor, bent(t, 0.45f, 0.55f, test::kPi, 0.004f));
  EXPECT_GT(test::torn_by_principal_logarithms(extractor.rings(), frame), 100u);
  EXPECT_EQ(frame.report.torn_edges, 0u);
  EXPECT_LT(frame.report.largest_jump, 1.0f);
}

TEST(RotationLabels, ScrollOfManyTurns) {
  const Topology t = test::sheet(121, 9, 1.0f / 64);
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kLogarithm);
  const ExtractedFrame frame = labels_of(extractor, bent(t, 0.2f, 1.7f, 3.5f * test::kPi, 0));
  EXPECT_GT(test::torn_by_principal_logarithms(extractor.rings(), frame), 5u);
  EXPECT_EQ(frame.report.torn_edges, 0u);
  float longest = 0;
  for (const Float4& v : frame.labels) longest = std::max(longest, std::hypot(v[0], v[1], v[2]));
  EXPECT_NEAR(longest, 3.5f * test::kPi, 0.2f);
}

TEST(RotationLabels, SpinGoesOnPastTwoTurns) {
  const Topology t = test::sheet(17, 17, 1.0f / 16);
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kLogarithm);
  ExtractedFrame frame;
  float largest = 0;
  for (int k = 1; k <= 200; ++k) {
    const Eigen::Matrix3f turn =
        Eigen::AngleAxisf(0.02f * test::kPi * static_cast<float>(k), Eigen::Vector3f::UnitY()).matrix();
    // Without wrinkles all axes agree, so that no field of logarithms is torn at whole turns.
    frame = labels_of(extractor, Positions(t.rest_positions * turn.transpose()), k > 1 ? &frame : nullptr);
    EXPECT_EQ(frame.report.torn_edges, 0u);
    if (k > 1) largest = std::max(largest, frame.report.largest_step);
  }
  EXPECT_NEAR(largest, 0.02f * test::kPi, 1e-3f);
  EXPECT_NEAR(frame.labels[100][1], 4 * test::kPi, 1e-3f);
}

TEST(RotationLabels, QuaternionsFollowATwistedStrip) {
  const Topology t = test::sheet(161, 9, 1.0f / 80);
  const Positions p = test::deform(t, [](const Eigen::Vector3f& q) {
    const Eigen::Matrix3f turn = Eigen::AngleAxisf(2 * test::kPi * q.x(), Eigen::Vector3f::UnitX()).matrix();
    const Eigen::Vector3f across(0, 0, q.z() - 0.05f);
    return Eigen::Vector3f(Eigen::Vector3f(q.x(), 0, 0) + turn * across);
  });
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kQuaternion);
  const ExtractedFrame frame = labels_of(extractor, p);
  EXPECT_EQ(frame.report.torn_edges, 0u);
  EXPECT_LT(frame.report.largest_jump, 0.2f);
}

TEST(RotationLabels, TimeDecidesWhatTheMeshLeavesOpen) {
  // A rigid sheet through 1.9 turns about x, one frame at a time, by quaternions: no jump at q = -1.
  const Topology t = test::sheet(5, 5, 0.1f);
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kQuaternion);
  ExtractedFrame frame;
  for (int k = 0; k <= 38; ++k) {
    const Eigen::Matrix3f turn =
        Eigen::AngleAxisf(0.1f * test::kPi * static_cast<float>(k), Eigen::Vector3f::UnitX()).matrix();
    frame = labels_of(extractor, Positions(t.rest_positions * turn.transpose()), k > 0 ? &frame : nullptr);
    EXPECT_LT(frame.report.largest_step, 0.2f);
  }
  EXPECT_LT(frame.labels[12][0], 0.96f);
  EXPECT_NEAR(frame.labels[12][0], std::cos(1.9f * test::kPi), 1e-4f);
}

TEST(RotationLabels, RepairsWhatTimeTears) {
  const Topology t = test::sheet(65, 9, 1.0f / 64);
  const FeatureExtractor extractor(test::rings_of(t), RotationCode::kLogarithm);
  // From flat to a scroll in one frame: the names nearest to zero are torn, and the mesh mends them.
  const ExtractedFrame flat = labels_of(extractor, t.rest_positions);
  const ExtractedFrame frame = labels_of(extractor, bent(t, 0.1f, 0.9f, 1.8f * test::kPi, 0), &flat);
  EXPECT_GT(frame.report.torn_by_time, 0u);
  EXPECT_EQ(frame.report.torn_edges, 0u);
}

TEST(RotationLabels, NoWorseThanEveryChoiceOnASmallMesh) {
  // Quaternions of a tiny mesh: 2^9 choices.
  const Topology t = test::sheet(3, 3, 0.1f);
  const OneRings rings(t, "sheet");
  const RotationLabels labels(RotationCode::kQuaternion, 9, rings.edges());
  std::mt19937 random(11);
  std::normal_distribution<float> normal;
  const auto energy = [&](const std::vector<Float4>& q) {
    float sum = 0;
    for (const auto& e : rings.edges()) {
      for (int k = 0; k < 4; ++k) sum += (q[e.a][k] - q[e.b][k]) * (q[e.a][k] - q[e.b][k]);
    }
    return sum;
  };
  int best_found = 0;
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<Float4> q(9), found;
    for (std::size_t v = 0; v < 9; ++v) {
      Eigen::Vector4f x(2, 0, 0, 0);
      for (int k = 0; k < 4; ++k) x(k) += normal(random);
      x.normalize();
      q[v] = Float4{x(0), x(1), x(2), x(3)};
    }
    labels.label(q, {}, found);
    float best = energy(found);
    for (unsigned choice = 0; choice < 512; ++choice) {
      std::vector<Float4> other = q;
      for (std::size_t v = 0; v < 9; ++v) {
        if ((choice >> v & 1) != 0) other[v] = -other[v];
      }
      best = std::min(best, energy(other));
    }
    EXPECT_LT(energy(found), 1.25f * best);
    best_found += energy(found) < best * 1.00001f ? 1 : 0;
  }
  EXPECT_GE(best_found, 15);
}

}  // namespace
}  // namespace pleat::conversion
