#include "services/conversion/representation.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <tuple>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

RepresentationSpec spec_of(ImageLayout layout, DetailBase base = DetailBase::kVertices, SubdivisionSpec fine = {}) {
  RepresentationSpec spec;
  spec.subdivision = fine;
  GeometryImageSpec image;
  image.layout = layout;
  image.base = base;
  spec.kind = image;
  return spec;
}

RepresentationSpec in_coarse_edges() {
  RepresentationSpec spec = spec_of(ImageLayout::kDetail);
  std::get<GeometryImageSpec>(spec.kind).units = DetailUnits::kCoarseEdges;
  return spec;
}

struct Pair {
  Frame coarse, fine;
};
Pair wrinkled(const Representation& representation, float phase) {
  return {test::wrinkled_frame(representation.coarse(), phase), test::wrinkled_frame(representation.fine(), phase)};
}

Frame moved(const Frame& frame, const Eigen::Matrix3f& turn, const Eigen::Vector3f& shift) {
  Frame result = frame;
  result.positions = (frame.positions * turn.transpose()).rowwise() + shift.transpose();
  result.velocities = frame.velocities * turn.transpose();
  return result;
}

class EveryLayout : public testing::TestWithParam<RepresentationSpec> {
 protected:
  // A representation is immutable and costs a factorisation: the tests of a layout share it.
  EveryLayout() {
    const GeometryImageSpec& image = std::get<GeometryImageSpec>(GetParam().kind);
    auto& shared = shared_[{image.layout, image.base, image.units}];
    if (shared == nullptr) shared = make_representation(test::load_garment("four charts").coarse, GetParam());
    made_ = shared.get();
  }
  static void TearDownTestSuite() { shared_.clear(); }

  const Representation* made_;

 private:
  using Key = std::tuple<ImageLayout, DetailBase, DetailUnits>;
  static inline std::map<Key, std::unique_ptr<const Representation>> shared_;
};

TEST_P(EveryLayout, TheTargetDecodesToTheFineMesh) {
  const Pair pair = wrinkled(*made_, 0.4f);
  const RigidTransform alignment = made_->align(pair.coarse.positions);
  Tensor answer;
  made_->target(pair.coarse, pair.fine, alignment, answer);
  EXPECT_EQ(answer.shape, made_->answer_shape());
  EXPECT_EQ(answer.channels, made_->answer_channels());
  EXPECT_EQ(made_->answer_mask().size() * answer.channels.size(), answer.values.size());
  Positions back;
  made_->decode(answer, pair.coarse.positions, alignment, back);
  // Where charts end, axes next to padding may have collapsed: details there are not quite what they should be.
  const bool turned = std::get<GeometryImageSpec>(GetParam().kind).layout == ImageLayout::kDetail;
  EXPECT_LT(test::rms(back, pair.fine.positions), turned ? 2e-5 : 2e-6);
}

void expect_form(const Representation& made) {
  const AnswerForm form = answer_form(made.spec());
  const auto input = made.input_shape(), answer = made.answer_shape();
  EXPECT_EQ(answer.at(1), form.scale * input.at(1));
  EXPECT_EQ(answer.at(2), form.scale * input.at(2));
  if (form.input_size) {
    EXPECT_EQ(*form.input_size, (std::array{input[1], input[2]}));
  }
  const Pair pair = wrinkled(made, 0.4f);
  const RigidTransform alignment = made.align(pair.coarse.positions);
  Tensor answer_of_pair, axes;
  made.answer_axes(pair.coarse.positions, alignment, axes);
  EXPECT_EQ(!axes.shape.empty(), form.own_axes);
  made.target(pair.coarse, pair.fine, alignment, answer_of_pair);
  if (form.first_three) {
    const auto first = static_cast<std::ptrdiff_t>(3 * made.answer_mask().size());
    Positions whole, part;
    made.decode(answer_of_pair, pair.coarse.positions, alignment, whole);
    std::fill(answer_of_pair.values.begin() + first, answer_of_pair.values.end(), 0.7f);
    made.decode(answer_of_pair, pair.coarse.positions, alignment, part);
    EXPECT_EQ(whole, part);
  }
  if (form.detail) {
    Positions zero;
    std::fill(answer_of_pair.values.begin(), answer_of_pair.values.end(), 0.0f);
    made.decode(answer_of_pair, pair.coarse.positions, alignment, zero);
    EXPECT_LT(test::rms(zero, upsample(made.subdivision(), made.coarse().faces, pair.coarse.positions)), 2e-3);
  }
}

TEST_P(EveryLayout, IsOfTheFormThatItsSpecSays) { expect_form(*made_); }

TEST(VertexLayout, IsOfTheFormThatItsSpecSays) {
  RepresentationSpec spec;
  spec.kind = VertexFeatureSpec{};
  expect_form(*make_representation(test::load_garment("skirt").coarse, spec));
}

TEST_P(EveryLayout, DecodingIsTheBasePlusTheReads) {
  const Pair pair = wrinkled(*made_, 0.9f);
  const RigidTransform alignment = made_->align(pair.coarse.positions);
  Tensor answer, axes;
  made_->target(pair.coarse, pair.fine, alignment, answer);
  made_->answer_axes(pair.coarse.positions, alignment, axes);
  Positions base, decoded;
  made_->base(pair.coarse.positions, alignment, base);
  made_->decode(answer, pair.coarse.positions, alignment, decoded);
  if (!axes.shape.empty()) {
    // Zeros leave the base.
    std::fill(answer.values.begin(), answer.values.end(), 0.0f);
    made_->decode(answer, pair.coarse.positions, alignment, decoded);
    decoded = ((decoded * alignment.rotation.transpose()).rowwise() + alignment.translation.transpose()).eval();
    EXPECT_LT(test::rms(decoded, base), 1e-6);
    return;
  }
  const VertexReads& reads = made_->reads();
  const std::size_t plane = made_->answer_mask().size();
  for (std::size_t v = 0; v + 1 < reads.offsets.size(); ++v) {
    for (std::uint32_t i = reads.offsets[v]; i < reads.offsets[v + 1]; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        base(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(c)) +=
            reads.weights[i] * answer.values[c * plane + reads.places[i]];
      }
    }
  }
  decoded = ((decoded * alignment.rotation.transpose()).rowwise() + alignment.translation.transpose()).eval();
  EXPECT_LT(test::rms(decoded, base), 1e-6);
}

/// But for two valid texels in a thousand. Of padding, whose texels show others', nothing is said.
void expect_same(const Tensor& a, const Tensor& b, const std::vector<std::uint8_t>& mask, float tolerance) {
  ASSERT_EQ(a.values.size(), b.values.size());
  std::size_t valid = 0, different = 0;
  for (std::size_t i = 0; i < a.values.size(); ++i) {
    if (mask[i % mask.size()] == 0) continue;
    ++valid;
    different += std::abs(a.values[i] - b.values[i]) > tolerance ? 1 : 0;
  }
  EXPECT_LE(different, valid / 500);
}

TEST_P(EveryLayout, RigidMotionDoesNotShow) {
  const Pair pair = wrinkled(*made_, 0.2f);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(1.1f, Eigen::Vector3f(1, 2, -1).normalized()).toRotationMatrix();
  const Eigen::Vector3f shift(3, -1, 2);
  const Pair other{moved(pair.coarse, turn, shift), moved(pair.fine, turn, shift)};
  const RigidTransform a = made_->align(pair.coarse.positions), b = made_->align(other.coarse.positions);
  Tensor one, two;
  made_->encode(std::span(&pair.coarse, 1), a, one, nullptr);
  made_->encode(std::span(&other.coarse, 1), b, two, nullptr);
  ASSERT_EQ(one.shape, made_->input_shape());
  expect_same(one, two, made_->input_mask(), 2e-4f);
  made_->target(pair.coarse, pair.fine, a, one);
  Positions back;
  made_->decode(one, other.coarse.positions, b, back);
  EXPECT_LT(test::rms(back, other.fine.positions), 5e-5);
}

TEST_P(EveryLayout, BadInputIsRefused) {
  const Pair pair = wrinkled(*made_, 0);
  Tensor answer, input;
  made_->target(pair.coarse, pair.fine, {}, answer);
  Positions positions;
  Tensor small = answer;
  small.shape[1] -= 1;
  EXPECT_THROW(made_->decode(small, pair.coarse.positions, {}, positions), Error);
  std::fill(answer.values.begin(), answer.values.end(), std::numeric_limits<float>::quiet_NaN());
  EXPECT_THROW(made_->decode(answer, pair.coarse.positions, {}, positions), Error);
  Frame wrong = pair.coarse;
  wrong.positions.conservativeResize(5, 3);
  EXPECT_THROW(made_->encode(std::span(&wrong, 1), {}, input, nullptr), Error);
  EXPECT_THROW(made_->target(pair.coarse, wrong, {}, answer), Error);
}

INSTANTIATE_TEST_SUITE_P(Layouts, EveryLayout,
                         testing::Values(spec_of(ImageLayout::kPublished), spec_of(ImageLayout::kPositions),
                                         spec_of(ImageLayout::kDetail),
                                         spec_of(ImageLayout::kDetail, DetailBase::kTexels), in_coarse_edges()));

/// In coarse edges a cloth three times as large shows the same: its motion takes sqrt(3) times as long.
TEST(Representation, CoarseEdgesHaveNoScale) {
  static constexpr float kLarger = 3;
  const Topology coarse = test::load_garment("four charts").coarse;
  Topology large = coarse;
  large.rest_positions *= kLarger;
  large.uv *= kLarger;
  const auto one = make_representation(coarse, in_coarse_edges()), two = make_representation(large, in_coarse_edges());
  ASSERT_EQ(one->input_shape(), two->input_shape());
  const Pair pair = wrinkled(*one, 0.4f);
  const auto enlarged = [](Frame frame) {
    frame.positions *= kLarger;
    frame.velocities *= std::sqrt(kLarger);
    return frame;
  };
  const Pair other{enlarged(pair.coarse), enlarged(pair.fine)};
  const RigidTransform a = one->align(pair.coarse.positions), b = two->align(other.coarse.positions);
  Tensor x, y;
  one->encode(std::span(&pair.coarse, 1), a, x, nullptr);
  two->encode(std::span(&other.coarse, 1), b, y, nullptr);
  expect_same(x, y, one->input_mask(), 2e-3f);
  one->target(pair.coarse, pair.fine, a, x);
  two->target(other.coarse, other.fine, b, y);
  expect_same(x, y, one->answer_mask(), 2e-3f);
  Positions small, back;
  one->decode(x, pair.coarse.positions, a, small);
  two->decode(x, other.coarse.positions, b, back);
  EXPECT_LT(test::rms(small * kLarger, back), 1e-4);
}

/// The linear map that training sees is the one of decode().
TEST(Representation, ReadsAreInMetresWhateverTheUnits) {
  const Topology coarse = test::load_garment("tablecloth").coarse;
  const auto metres = make_representation(coarse, spec_of(ImageLayout::kDetail)),
             edges = make_representation(coarse, in_coarse_edges());
  const auto edge = static_cast<float>(mean_edge_length(coarse));
  ASSERT_EQ(metres->reads().weights.size(), edges->reads().weights.size());
  for (std::size_t i = 0; i < metres->reads().weights.size(); i += 97) {
    EXPECT_FLOAT_EQ(edges->reads().weights[i], edge * metres->reads().weights[i]);
  }
}

class EverySubdivision : public testing::TestWithParam<SubdivisionSpec> {};

TEST_P(EverySubdivision, HasItsDetail) {
  const Topology coarse = test::load_garment("tablecloth").coarse;
  const auto made = make_representation(coarse, spec_of(ImageLayout::kDetail, DetailBase::kVertices, GetParam()));
  EXPECT_EQ(made->fine().vertex_count(), subdivide(coarse, GetParam()).fine.vertex_count());
  const Pair pair = wrinkled(*made, 0.4f);
  const RigidTransform alignment = made->align(pair.coarse.positions);
  Tensor answer;
  made->target(pair.coarse, pair.fine, alignment, answer);
  Positions back;
  made->decode(answer, pair.coarse.positions, alignment, back);
  EXPECT_LT(test::rms(back, pair.fine.positions), 1e-5);
  // An answer of nothing is the coarse surface itself.
  std::fill(answer.values.begin(), answer.values.end(), 0.0f);
  made->decode(answer, pair.coarse.positions, alignment, back);
  EXPECT_LT(test::rms(back, upsample(made->subdivision(), coarse.faces, pair.coarse.positions)), 1e-7);
}

INSTANTIATE_TEST_SUITE_P(Rules, EverySubdivision,
                         testing::Values(SubdivisionSpec{1}, SubdivisionSpec{1, SubdivisionRule::kSmooth},
                                         SubdivisionSpec{2, SubdivisionRule::kSmooth}));

TEST(Representation, AWindowHoldsTheOldestFrameFirst) {
  RepresentationSpec spec = spec_of(ImageLayout::kPublished);
  const Topology coarse = test::load_garment("tablecloth").coarse;
  const auto single = make_representation(coarse, spec);
  spec.window = 3;
  const auto made = make_representation(coarse, spec);
  std::vector<Frame> frames;
  for (const float phase : {0.1f, 0.2f, 0.3f}) frames.push_back(test::wrinkled_frame(coarse, phase));
  const RigidTransform alignment = made->align(frames.back().positions);
  Tensor input, one;
  made->encode(frames, alignment, input, nullptr);
  EXPECT_EQ(input.shape[0], 27);
  ASSERT_EQ(input.channels.size(), 27u);
  EXPECT_EQ(input.channels[0], "displacement_x_2");
  EXPECT_EQ(input.channels[26], "velocity_z");
  for (std::size_t t = 0; t < 3; ++t) {
    single->encode(std::span(&frames[t], 1), alignment, one, nullptr);
    EXPECT_TRUE(std::equal(one.values.begin(), one.values.end(),
                           input.values.begin() + static_cast<std::ptrdiff_t>(t * one.values.size())));
  }
  EXPECT_THROW(made->encode(std::span(frames).first(2), alignment, input, nullptr), Error);
  spec.window = kMaxWindow + 1;
  EXPECT_THROW(make_representation(coarse, spec), Error);
}

/// The constants tell in which corner of a coarse triangle a texel lies.
TEST(Representation, ConstantsOfDetailAreBarycentricWeights) {
  const auto made = make_representation(test::load_garment("tablecloth").coarse, spec_of(ImageLayout::kDetail));
  const Tensor& constants = made->constants();
  ASSERT_EQ(constants.shape, (std::vector<std::int64_t>{32, 40, 60}));
  EXPECT_EQ(constants.channels.size(), 32u);
  const std::size_t half = constants.values.size() / 2;
  for (std::size_t i = 0; i < half; ++i) {
    const float largest = (constants.values[i] + 2) / 3, second = (constants.values[half + i] + 1) / 4;
    EXPECT_GE(largest, 1 / 3.0f - 1e-5f);
    EXPECT_LE(largest, 1 + 1e-5f);
    EXPECT_LE(second, largest + 1e-5f);
    EXPECT_LE(largest + second, 1 + 1e-5f);
    EXPECT_GE(largest + 2 * second, 1 - 1e-5f) << "the third would be larger than the second";
  }
  EXPECT_TRUE(make_representation(test::load_garment("tablecloth").coarse, spec_of(ImageLayout::kPublished))
                  ->constants()
                  .shape.empty());
}

TEST(Representation, ConstantsDoNotGrowWithTheScale) {
  RepresentationSpec spec = spec_of(ImageLayout::kDetail, DetailBase::kVertices, SubdivisionSpec{3});
  GeometryImageSpec& image = std::get<GeometryImageSpec>(spec.kind);
  image.image.coarse_width = 30;
  image.image.coarse_height = 20;
  image.image.scale = 8;
  const auto made = make_representation(test::load_garment("tablecloth").coarse, spec);
  EXPECT_EQ(made->constants().shape, (std::vector<std::int64_t>{32, 20, 30}));
  EXPECT_EQ(made->answer_shape(), (std::vector<std::int64_t>{3, 160, 240}));
  image.image.scale = 2;
  EXPECT_EQ(make_representation(test::load_garment("tablecloth").coarse, spec)->constants().shape[0], 8);
}

TEST(Representation, AFineMeshOfItsOwn) {
  const Topology coarse = test::load_garment("tablecloth").coarse, fine = test::other_sheet(coarse, 37, 29);
  EXPECT_EQ(topology_hash(make_representation(coarse, spec_of(ImageLayout::kPublished), &fine)->fine()),
            topology_hash(fine));
  const Error error = test::error_of([&] { make_representation(coarse, spec_of(ImageLayout::kDetail), &fine); });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_NE(std::string(error.what()).find("subdivision"), std::string::npos) << error.what();
}

}  // namespace
}  // namespace pleat::conversion
