#include "services/conversion/vertex_features/vertex_representation.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "common/base/error.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/services/conversion/vertex_features/sheets.hpp"

namespace pleat::conversion {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

RepresentationSpec spec_of(int rounds, int window = 1, VertexFeatureSpec features = {}) {
  RepresentationSpec spec;
  spec.kind = features;
  spec.subdivision.rounds = rounds;
  spec.window = window;
  return spec;
}

std::unique_ptr<const Representation> make(const RepresentationSpec& spec) {
  Topology coarse = test::sheet(5, 4, 0.1F);
  coarse.uv.resize(coarse.vertex_count(), 2);
  coarse.uv << coarse.rest_positions.col(0), coarse.rest_positions.col(2);
  coarse.uv_faces = coarse.faces;
  return make_representation(coarse, spec);
}

Frame frame_of(const Topology& topology, float phase, const Eigen::Matrix3f& turn = Eigen::Matrix3f::Identity(),
               const Eigen::Vector3f& shift = Eigen::Vector3f::Zero()) {
  const auto at = [&](float time) {
    return test::deform(topology, [&](const Eigen::Vector3f& p) -> Eigen::Vector3f {
      return turn * (test::waves(p + Eigen::Vector3f(time, 0, 0)) - Eigen::Vector3f(time, 0, 0)) + shift;
    });
  };
  Frame frame;
  frame.positions = at(phase);
  frame.velocities = (frame.positions - at(phase - 0.01F)) / 0.04F;
  return frame;
}

float rms(const Positions& a, const Positions& b) {
  return std::sqrt((a - b).squaredNorm() / static_cast<float>(a.rows()));
}

float largest_difference(const Tensor& a, const Tensor& b) {
  EXPECT_EQ(a.values.size(), b.values.size());
  float largest = 0;
  for (std::size_t i = 0; i < std::min(a.values.size(), b.values.size()); ++i) {
    largest = std::max(largest, std::abs(a.values[i] - b.values[i]));
  }
  return largest;
}

class EveryRound : public testing::TestWithParam<int> {};

TEST_P(EveryRound, TheTargetDecodesToTheFineMeshAndZerosToTheBase) {
  const auto made = make(spec_of(GetParam()));
  const Frame coarse = frame_of(made->coarse(), 0.3F), fine = frame_of(made->fine(), 0.35F);
  const RigidTransform alignment = made->align(coarse.positions);
  Tensor answer;
  made->target(coarse, fine, alignment, answer);
  EXPECT_EQ(answer.shape, made->answer_shape());
  EXPECT_EQ(answer.channels, made->answer_channels());
  EXPECT_EQ(answer.channels.size(), 9u);
  EXPECT_EQ(made->answer_mask().size() * 9, answer.values.size());
  Positions back;
  made->decode(answer, coarse.positions, alignment, back);
  EXPECT_LT(rms(back, fine.positions), 2e-6F);

  std::fill(answer.values.begin(), answer.values.end(), 0.0F);
  made->decode(answer, coarse.positions, alignment, back);
  EXPECT_LT(rms(back, upsample(made->subdivision(), made->coarse().faces, coarse.positions)), 1e-6F);
}

TEST_P(EveryRound, EachFaceHasAPlaceForEachOfItsVertices) {
  const auto made = make(spec_of(GetParam()));
  const auto& mask = made->answer_mask();
  const auto valid = std::count(mask.begin(), mask.end(), 1);
  EXPECT_EQ(valid, patch_vertices(GetParam()) * made->coarse().face_count());
  const VertexReads& reads = made->reads();
  ASSERT_EQ(reads.offsets.size(), static_cast<std::size_t>(made->fine().vertex_count()) + 1);
  EXPECT_EQ(reads.places.size(), static_cast<std::size_t>(valid));
  for (std::size_t v = 0; v + 1 < reads.offsets.size(); ++v) EXPECT_LT(reads.offsets[v], reads.offsets[v + 1]);
}

INSTANTIATE_TEST_SUITE_P(Rounds, EveryRound, testing::Values(0, 1, 2, 3));

TEST(VertexRepresentation, TurnsAboutTheVerticalAxisAndShiftsDoNotShow) {
  const auto made = make(spec_of(2, 2));
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(2.1F, Eigen::Vector3f::UnitY()).toRotationMatrix();
  const Eigen::Vector3f shift(3, -1, 2);
  const std::vector<Frame> frames = {frame_of(made->coarse(), 0.2F), frame_of(made->coarse(), 0.3F)};
  const std::vector<Frame> moved = {frame_of(made->coarse(), 0.2F, turn, shift),
                                    frame_of(made->coarse(), 0.3F, turn, shift)};
  const RigidTransform a = made->align(frames.back().positions), b = made->align(moved.back().positions);
  Tensor one, two;
  made->encode(frames, a, one, nullptr);
  made->encode(moved, b, two, nullptr);
  EXPECT_EQ(one.shape[0], 2 * made->input_shape()[0]);
  EXPECT_EQ(one.channels.size(), static_cast<std::size_t>(one.shape[0]));
  EXPECT_EQ(one.channels.front(), "rotation_xy_corner0_1");
  EXPECT_EQ(one.channels.back(), "velocity_z_corner2");
  EXPECT_LT(largest_difference(one, two), 2e-4F);  // velocities: positions of metres over hundredths of a second
  made->target(frames.back(), frame_of(made->fine(), 0.33F), a, one);
  made->target(moved.back(), frame_of(made->fine(), 0.33F, turn, shift), b, two);
  EXPECT_LT(largest_difference(one, two), 1e-4F);

  VertexFeatureSpec fixed;
  fixed.fixed_axes = true;
  EXPECT_EQ(make(spec_of(2, 1, fixed))->align(moved.back().positions).rotation, Eigen::Matrix3f::Identity());
}

ObstacleFrame ball_at(const Eigen::Vector3f& center, float radius) {
  ObstacleFrame ball;
  ball.name = "ball";
  ball.center = center;
  ball.radius = radius;
  return ball;
}

TEST(VertexRepresentation, ObstaclesAreFeltWithinTwoEdgesAndPushAway) {
  VertexFeatureSpec features;
  features.obstacles = true;
  const auto made = make(spec_of(1, 1, features)), blind = make(spec_of(1));
  EXPECT_TRUE(made->reads_obstacles());
  EXPECT_FALSE(blind->reads_obstacles());
  const Topology& coarse = made->coarse();
  double reach = 0;
  const auto rings = test::rings_of(coarse);
  for (const auto& e : rings->edges()) {
    reach += 2 * static_cast<double>((coarse.rest_positions.row(e.a) - coarse.rest_positions.row(e.b)).norm());
  }
  reach /= static_cast<double>(rings->edges().size());
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(0.7F, Eigen::Vector3f::UnitY()).toRotationMatrix();
  const Frame frame = frame_of(coarse, 0.1F, turn);
  const Eigen::Vector3f center = frame.positions.row(6).transpose() + Eigen::Vector3f(0, -0.09F, 0);
  ObstacleField field({});
  field.update(std::vector{ball_at(center, 0.05F)});
  const RigidTransform alignment = made->align(frame.positions);
  Tensor input, without;
  made->encode(std::span(&frame, 1), alignment, input, &field);
  blind->encode(std::span(&frame, 1), alignment, without, &field);
  ASSERT_EQ(input.shape[0], without.shape[0] + 12);
  EXPECT_EQ(input.channels.back(), "obstacle_z_corner2");
  const auto faces = static_cast<std::size_t>(coarse.face_count());
  const std::size_t channels = input.channels.size() / 3;
  std::size_t felt = 0;
  for (std::size_t f = 0; f < faces; ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const auto value = [&](std::size_t c) { return input.values[(k * channels + c) * faces + f]; };
      for (std::size_t c = 0; c + 4 < channels; ++c) {
        ASSERT_EQ(value(c), without.values[(k * (channels - 4) + c) * faces + f]);
      }
      const auto v = coarse.faces(static_cast<Eigen::Index>(f), static_cast<Eigen::Index>(k));
      const Eigen::Vector3d away = (frame.positions.row(v).transpose() - center).cast<double>();
      const double near = std::max(0.0, 1 - (away.norm() - static_cast<double>(ball_at(center, 0.05F).radius)) / reach);
      felt += near > 0 ? 1 : 0;
      ASSERT_NEAR(value(channels - 4), near, 1e-5);
      const Eigen::Vector3d expected = near * (alignment.rotation.cast<double>() * away.normalized());
      for (std::size_t c = 0; c < 3; ++c) {
        ASSERT_NEAR(value(channels - 3 + c), expected[static_cast<Eigen::Index>(c)], 1e-5);
      }
    }
  }
  EXPECT_GT(felt, 0u);
  EXPECT_LT(felt, 3 * faces);

  // None, or one far away: zeros.
  made->encode(std::span(&frame, 1), alignment, without, nullptr);
  field.update(std::vector{ball_at({9, 9, 9}, 0.05F)});
  made->encode(std::span(&frame, 1), alignment, input, &field);
  EXPECT_EQ(input.values, without.values);
}

TEST(VertexRepresentation, InputsAreTheFeaturesOfTheCorners) {
  for (const RotationCode code : {RotationCode::kLogarithm, RotationCode::kQuaternion}) {
    VertexFeatureSpec features;
    features.rotation = code;
    const auto made = make(spec_of(1, 1, features));
    const Frame frame = frame_of(made->coarse(), 0.1F);
    Tensor input;
    made->encode(std::span(&frame, 1), made->align(frame.positions), input, nullptr);
    const FeatureExtractor extractor(test::rings_of(made->coarse()), code);
    ExtractedFrame extracted;
    const RigidTransform alignment = made->align(frame.positions);
    extractor.extract(frame.positions, -std::atan2(alignment.rotation(0, 2), alignment.rotation(0, 0)), {}, extracted);
    const auto faces = static_cast<std::size_t>(made->coarse().face_count());
    const auto vertices = static_cast<std::size_t>(made->coarse().vertex_count());
    const auto channels = static_cast<std::size_t>(extractor.channels());
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t c = 0; c < channels; ++c) {
        for (std::size_t f = 0; f < faces; ++f) {
          const auto v = made->coarse().faces(static_cast<Eigen::Index>(f), static_cast<Eigen::Index>(k));
          EXPECT_EQ(input.values[(k * (channels + 6) + c) * faces + f], extracted.values[c * vertices + v]);
        }
      }
    }
  }
}

/// Offsets with noise, gradients without: the gradients take most of it away.
TEST(VertexRepresentation, GradientsCorrectTheOffsets) {
  VertexFeatureSpec without, with;
  without.passes = 0;
  with.passes = 2;
  const auto plain = make(spec_of(2, 1, without)), corrected = make(spec_of(2, 1, with));
  const Frame coarse = frame_of(plain->coarse(), 0.3F), fine = frame_of(plain->fine(), 0.35F);
  const RigidTransform alignment = plain->align(coarse.positions);
  Tensor answer;
  plain->target(coarse, fine, alignment, answer);
  const VertexReads& reads = plain->reads();
  const std::size_t plane = plain->answer_mask().size();
  for (std::size_t v = 0; v + 1 < reads.offsets.size(); ++v) {
    const float noise = 0.005F * std::sin(40 * plain->fine().rest_positions(static_cast<Eigen::Index>(v), 0));
    for (std::uint32_t i = reads.offsets[v]; i < reads.offsets[v + 1]; ++i)
      answer.values[plane + reads.places[i]] += noise;
  }
  Positions a, b;
  plain->decode(answer, coarse.positions, alignment, a);
  corrected->decode(answer, coarse.positions, alignment, b);
  EXPECT_GT(rms(a, fine.positions), 0.003F);
  EXPECT_LT(rms(b, fine.positions), 0.5F * rms(a, fine.positions));
}

VertexFeatureSpec answering(AnswerKind answer, RotationCode rotation = RotationCode::kLogarithm, int passes = 2) {
  VertexFeatureSpec features;
  features.answer = answer;
  features.rotation = rotation;
  features.passes = passes;
  return features;
}

/// Rotation and stretch in place of the gradients' difference: the target still is the fine mesh.
TEST(VertexRepresentation, FeaturesWithOffsetsDecodeToTheFineMesh) {
  for (const RotationCode code : {RotationCode::kLogarithm, RotationCode::kQuaternion}) {
    const auto made = make(spec_of(2, 1, answering(AnswerKind::kFeatures, code)));
    const Frame coarse = frame_of(made->coarse(), 0.3F), fine = frame_of(made->fine(), 0.35F);
    const RigidTransform alignment = made->align(coarse.positions);
    Tensor answer;
    made->target(coarse, fine, alignment, answer);
    EXPECT_EQ(answer.shape, made->answer_shape());
    EXPECT_EQ(answer.channels, made->answer_channels());
    EXPECT_EQ(answer.channels.size(), code == RotationCode::kLogarithm ? 12u : 13u);
    EXPECT_EQ(answer.channels[3], code == RotationCode::kLogarithm ? "rotation_xy" : "rotation_w");
    Positions back;
    made->decode(answer, coarse.positions, alignment, back);
    EXPECT_LT(rms(back, fine.positions), 5e-6F);
  }
}

/// Features say nothing of places: what comes back is where the coarse centroid is, and each pass gives back more of
/// what one-rings average away.
TEST(VertexRepresentation, FeaturesAloneDecodeToTheShapeAtTheCoarseCentroid) {
  float before = 0;
  for (const int passes : {0, 2, 8}) {
    const auto made = make(spec_of(2, 1, answering(AnswerKind::kFeaturesAlone, RotationCode::kLogarithm, passes)));
    const Frame coarse = frame_of(made->coarse(), 0.3F), fine = frame_of(made->fine(), 0.3F);
    const RigidTransform alignment = made->align(coarse.positions);
    Tensor answer;
    made->target(coarse, fine, alignment, answer);
    EXPECT_EQ(answer.channels.size(), 9u);
    Positions back;
    made->decode(answer, coarse.positions, alignment, back);
    const auto mean_of = [&](const Positions& fine_positions) {
      Eigen::RowVector3f sum = Eigen::RowVector3f::Zero();
      for (const std::uint32_t v : made->subdivision().feature_vertices) sum += fine_positions.row(v);
      return Eigen::RowVector3f(sum / static_cast<float>(coarse.positions.rows()));
    };
    EXPECT_LT((mean_of(back) - coarse.positions.colwise().mean()).norm(), 1e-5F);
    Positions centred = fine.positions;
    centred.rowwise() += coarse.positions.colwise().mean() - mean_of(fine.positions);
    const float error = rms(back, centred);
    EXPECT_LT(error, passes == 0 ? 0.01F : 0.7F * before) << passes;
    before = error;
  }
}

TEST(VertexRepresentation, FeaturesAloneHaveOnePlaceForEachVertex) {
  const auto made = make(spec_of(2, 1, answering(AnswerKind::kFeaturesAlone)));
  const auto& mask = made->answer_mask();
  const auto vertices = made->fine().vertex_count();
  EXPECT_EQ(std::count(mask.begin(), mask.end(), 1), vertices);
  const VertexReads& reads = made->reads();
  for (Eigen::Index v = 0; v < vertices; ++v) {
    const auto row = static_cast<std::size_t>(v);
    EXPECT_EQ(reads.offsets[row + 1] - reads.offsets[row], 1u);
  }
  EXPECT_FALSE(made->fits_half());
}

TEST(VertexRepresentation, AnswersOfFeaturesAreCheckedToo) {
  for (const AnswerKind kind : {AnswerKind::kFeatures, AnswerKind::kFeaturesAlone}) {
    const auto made = make(spec_of(1, 1, answering(kind)));
    const Frame coarse = frame_of(made->coarse(), 0);
    const RigidTransform alignment = made->align(coarse.positions);
    Tensor answer;
    made->target(coarse, frame_of(made->fine(), 0), alignment, answer);
    Positions positions;
    Tensor wrong = answer;
    wrong.values[(answer.channels.size() - 1) * made->answer_mask().size()] = kNaN;
    EXPECT_NE(std::string(test::error_of([&] { made->decode(wrong, coarse.positions, alignment, positions); }).what())
                  .find("the feature of fine vertex"),
              std::string::npos);
    for (std::size_t i = 0; i < wrong.values.size(); ++i) wrong.values[i] = i % 2 == 0 ? 1e3F : -1e3F;
    made->decode(wrong, coarse.positions, alignment, positions);
    EXPECT_TRUE(positions.allFinite());
  }
}

TEST(VertexRepresentation, BadInputIsNamedOrHandled) {
  const auto made = make(spec_of(1));
  const Frame coarse = frame_of(made->coarse(), 0), fine = frame_of(made->fine(), 0);
  const RigidTransform alignment = made->align(coarse.positions);
  Tensor input, answer;
  made->target(coarse, fine, alignment, answer);
  Positions positions;

  Frame bad = coarse;
  bad.positions(7, 1) = kNaN;
  EXPECT_NE(std::string(test::error_of([&] { made->align(bad.positions); }).what()).find("vertex 7"),
            std::string::npos);
  EXPECT_NE(std::string(test::error_of([&] { made->encode(std::span(&bad, 1), alignment, input, nullptr); }).what())
                .find("vertex 7"),
            std::string::npos);
  EXPECT_THROW(made->decode(answer, bad.positions, alignment, positions), Error);
  bad = coarse;
  bad.velocities(2, 0) = kNaN;
  EXPECT_THROW(made->encode(std::span(&bad, 1), alignment, input, nullptr), Error);
  bad.velocities.resize(0, 3);  // none: at rest
  made->encode(std::span(&bad, 1), alignment, input, nullptr);
  for (const std::size_t channel : {std::size_t{0}, answer.channels.size() - 1}) {
    Tensor wrong = answer;
    wrong.values[channel * made->answer_mask().size()] = kNaN;
    EXPECT_NE(std::string(test::error_of([&] { made->decode(wrong, coarse.positions, alignment, positions); }).what())
                  .find("fine vertex"),
              std::string::npos);
  }
  Tensor small = answer;
  small.shape[2] -= 1;
  EXPECT_THROW(made->decode(small, coarse.positions, alignment, positions), Error);
  Frame few = coarse;
  few.positions.conservativeResize(5, 3);
  EXPECT_THROW(made->encode(std::span(&few, 1), alignment, input, nullptr), Error);
  EXPECT_THROW(made->target(coarse, few, alignment, answer), Error);
  EXPECT_THROW(made->encode({}, alignment, input, nullptr), Error);

  // One-rings in one point, in one line, or inside out, and gradients of nonsense: finite all the same.
  for (const float scale : {0.0F, -1.0F}) {
    Frame collapsed = coarse;
    collapsed.positions.col(0) *= scale;
    if (scale == 0) collapsed.positions.col(2) *= 0;
    made->encode(std::span(&collapsed, 1), made->align(collapsed.positions), input, nullptr);
    for (const float value : input.values) ASSERT_TRUE(std::isfinite(value));
  }
  Tensor wild = answer;
  for (std::size_t i = 0; i < wild.values.size(); ++i) wild.values[i] = i % 2 == 0 ? 1e3F : -1e3F;
  made->decode(wild, coarse.positions, alignment, positions);
  EXPECT_TRUE(positions.allFinite());
}

TEST(VertexRepresentation, BadSpecsAreRefused) {
  VertexFeatureSpec features;
  features.passes = kMostPasses + 1;
  EXPECT_THROW(make(spec_of(1, 1, features)), Error);
  features = {};
  features.anchor_weight = 0;
  EXPECT_THROW(make(spec_of(1, 1, features)), Error);
  const auto made = make(spec_of(1));
  EXPECT_NE(std::string(test::error_of([&] { make_representation(made->coarse(), spec_of(1), &made->fine()); }).what())
                .find("subdivision"),
            std::string::npos);
  Topology loose = made->coarse();
  loose.rest_positions.conservativeResize(loose.rest_positions.rows() + 1, 3);
  loose.rest_positions.bottomRows(1).setConstant(5);
  EXPECT_NE(std::string(test::error_of([&] { make_representation(loose, spec_of(1)); }).what()).find("20"),
            std::string::npos);
}

}  // namespace
}  // namespace pleat::conversion
