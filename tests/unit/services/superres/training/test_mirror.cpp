// Mirrored copies against conversion: the pair of a mirrored cloth is the mirrored pair.
#include "services/superres/training/mirror.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/errors.hpp"
#include "tests/unit/services/superres/example_dataset.hpp"

namespace pleat::superres {
namespace {

/// A sheet with one more vertex in the middle of each quad, so that its faces are mirror symmetric.
Topology crossed_sheet(int columns, int rows) {
  Topology mesh = sheet(columns, rows);
  const int corners = static_cast<int>(mesh.rest_positions.rows()), stride = columns + 1;
  mesh.rest_positions.conservativeResize(corners + columns * rows, 3);
  mesh.uv.conservativeResize(corners + columns * rows, 2);
  mesh.faces.resize(4 * columns * rows, 3);
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      const int quad = r * columns + c, middle = corners + quad;
      const std::uint32_t a = static_cast<std::uint32_t>(r * stride + c), b = a + 1,
                          d = a + static_cast<std::uint32_t>(stride), e = d + 1, m = static_cast<std::uint32_t>(middle);
      mesh.rest_positions.row(middle) =
          (mesh.rest_positions.row(static_cast<int>(a)) + mesh.rest_positions.row(static_cast<int>(e))) / 2;
      mesh.uv.row(middle) = (mesh.uv.row(static_cast<int>(a)) + mesh.uv.row(static_cast<int>(e))) / 2;
      mesh.faces.row(4 * quad) << a, b, m;
      mesh.faces.row(4 * quad + 1) << b, e, m;
      mesh.faces.row(4 * quad + 2) << e, d, m;
      mesh.faces.row(4 * quad + 3) << d, a, m;
    }
  }
  mesh.uv_faces = mesh.faces;
  return mesh;
}

constexpr float kWidth = 0.8F, kDepth = 0.6F;

/// A point of the moving sheet, by its place in the rest mesh.
Eigen::RowVector3f moved(float x, float z, float t) {
  return {x + 0.02F * std::sin(4 * z + t), 0.1F * std::sin(5 * x + 3 * z + t) + 0.04F * x * x,
          z + 0.03F * std::cos(3 * x - t)};
}

/// The cloth or its mirror image: the vertex at a reversed place of a reversed space.
Frame frame_of(const Topology& mesh, std::uint64_t bits, double time) {
  Frame frame;
  const auto at = [&](double t) {
    Positions positions(mesh.rest_positions.rows(), 3);
    for (Eigen::Index i = 0; i < positions.rows(); ++i) {
      const float x = mesh.rest_positions(i, 0), z = mesh.rest_positions(i, 2);
      Eigen::RowVector3f p =
          moved((bits & 1) != 0 ? kWidth - x : x, (bits & 2) != 0 ? -kDepth - z : z, static_cast<float>(t));
      if ((bits & 1) != 0) p[0] = kWidth - p[0];
      if ((bits & 2) != 0) p[2] = -kDepth - p[2];
      if ((bits & 4) != 0) p[1] = -p[1];
      positions.row(i) = p;
    }
    return positions;
  };
  frame.positions = at(time);
  frame.velocities = (at(time) - at(time - 0.01)) / 0.01F;
  return frame;
}

torch::Tensor to_torch(const Tensor& t) { return torch::tensor(t.values).view({t.shape[0], t.shape[1], t.shape[2]}); }

class MirrorLayouts : public testing::TestWithParam<conversion::ImageLayout> {};

TEST_P(MirrorLayouts, TheMirroredClothHasTheMirroredPair) {
  const Topology coarse = crossed_sheet(8, 6);
  conversion::RepresentationSpec spec;
  conversion::GeometryImageSpec kind;
  kind.layout = GetParam();
  kind.image.coarse_width = 12, kind.image.coarse_height = 10, kind.image.scale = 2;
  spec.kind = kind, spec.window = 2;
  const auto representation = conversion::make_representation(coarse, spec);
  PairData data;
  data.representation = spec;
  data.input_channels = representation->input_channels(), data.answer_channels = representation->answer_channels();
  data.meshes[0].constants = representation->constants();
  data.meshes[0].sheet_axes = {{1, 0, 0}, {0, 0, -1}};
  for (auto [ranges, count] : {std::pair{&data.input_ranges, data.input_channels.size()},
                               std::pair{&data.output_ranges, data.answer_channels.size()}}) {
    for (std::size_t c = 0; c < count; ++c) {
      ranges->offset.push_back(0.1F * static_cast<float>(c));
      ranges->scale.push_back(0.3F + 0.05F * static_cast<float>(c));
    }
  }
  const auto pair_of = [&](std::uint64_t bits) {
    const Frame frames[] = {frame_of(coarse, bits, 0.3), frame_of(coarse, bits, 0.4)};
    Frame fine = frame_of(representation->fine(), bits, 0.4);
    const RigidTransform alignment = representation->align(frames[1].positions);
    Tensor input, answer;
    representation->encode(frames, alignment, input, nullptr);
    representation->target(frames[1], fine, alignment, answer);
    const std::size_t size = input.values.size() / 2;
    for (std::size_t t = 0; t < 2; ++t) {
      normalize(data.input_ranges, std::span(input.values).subspan(t * size, size));
    }
    normalize(data.output_ranges, answer);
    auto image = to_torch(input);
    if (data.constant_channels() > 0) image = torch::cat({image, to_torch(data.meshes[0].constants)}, 0);
    return std::pair(image, to_torch(answer));
  };
  const Mirror mirror(data);
  const auto [input, answer] = pair_of(0);
  for (std::uint64_t bits = 0; bits < 8; ++bits) {
    SCOPED_TRACE(bits);
    const auto [expected_input, expected_answer] = pair_of(bits);
    const auto error = (mirror.input(input, bits) - expected_input).abs().amax({1, 2});
    for (std::int64_t c = 0; c < error.size(0); ++c) EXPECT_LT(error[c].item<double>(), 2e-3) << "channel " << c;
    EXPECT_LT((mirror.answer(answer, bits) - expected_answer).abs().max().item<double>(), 5e-3);
    EXPECT_LT((mirror.answer(expected_answer, bits) - answer).abs().max().item<double>(), 5e-3);
  }
}

INSTANTIATE_TEST_SUITE_P(All, MirrorLayouts,
                         testing::Values(conversion::ImageLayout::kPublished, conversion::ImageLayout::kDetail));

TEST(Mirror, RefusesWhatItDoesNotKnow) {
  PairData data;
  data.input_channels = {"normal_x", "normal_y", "normal_z"};
  data.input_ranges = {std::vector<float>(3, 0), std::vector<float>(3, 1), 0};
  EXPECT_THAT(test::error_of([&] { Mirror mirror(data); }).what(), testing::HasSubstr("not flat"));
  data.meshes[0].sheet_axes = {{1, 0, 0}, {0, 0, -1}};
  EXPECT_NO_THROW(Mirror{data});
  data.input_channels = {"density"}, data.input_ranges = {{0}, {1}, 0};
  EXPECT_THAT(test::error_of([&] { Mirror mirror(data); }).what(), testing::HasSubstr("'density'"));
  // In the cloth's own axes any garment has a mirror image.
  data.meshes[0].sheet_axes.clear();
  data.input_channels = {"strain_uv"};
  const Mirror mirror(data);
  const auto image = torch::full({1, 2, 2}, 0.25F);
  EXPECT_EQ(mirror.input(image, 1)[0][0][0].item<float>(), -0.25F);
  EXPECT_EQ(mirror.input(image, 4)[0][0][0].item<float>(), 0.25F);
}

}  // namespace
}  // namespace pleat::superres
