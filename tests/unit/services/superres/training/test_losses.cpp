// Losses against plain loops, their gradients against finite differences, and the kinematic relation on real motion.
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <Eigen/Geometry>
#include <cmath>

#include "common/features/channels.hpp"
#include "services/superres/training/losses.hpp"

namespace pleat::superres {
namespace {

constexpr int kWindows = 2, kFrames = 3, kHeight = 4, kWidth = 8;
constexpr double kFrameTime = 0.04;

torch::Tensor rotation(double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return torch::tensor({c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0}, torch::kFloat64).view({3, 3});
}

/// In double, so that finite differences are sharp.
Batch example_batch() {
  torch::manual_seed(3);
  const auto options = torch::kFloat64;
  Batch batch;
  batch.frames = kFrames;
  const std::int64_t n = kWindows * kFrames;
  batch.input = torch::rand({n, 9, kHeight / 4, kWidth / 4}, options);
  batch.answer = torch::rand({n, 9, kHeight, kWidth}, options);
  batch.mask = torch::ones({n, 1, kHeight, kWidth}, options);
  batch.mask.index_put_({torch::indexing::Slice(), 0, 0, torch::indexing::Slice(0, 3)}, 0);
  std::vector<torch::Tensor> rotations;
  for (int i = 0; i < n; ++i) rotations.push_back(rotation(0.1 * i));
  batch.rotations = torch::stack(rotations);
  return batch;
}

LossConstants example_constants() {
  LossConstants c;
  c.offset = torch::linspace(-2, -1, 9, torch::kFloat64);
  c.scale = torch::linspace(1, 3, 9, torch::kFloat64);
  c.deviation = torch::linspace(0.1, 0.5, 9, torch::kFloat64);
  c.normal = kNormalChannel, c.velocity = kVelocityChannel;
  c.frame_time_s = kFrameTime;
  return c;
}

LossConfig config_of(const char* target, const char* alignment, const char* scaling) {
  LossConfig config;
  config.frames = kFrames - 1;
  config.target = target, config.alignment = alignment, config.scaling = scaling;
  config.displacement = 0.9, config.normal = 0.2, config.velocity = 0.3, config.kinematic = 0.4;
  return config;
}

/// Eq. 2-6 spelled out texel by texel.
double plain_total(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                   const LossConfig& config) {
  const auto s = synthesized.accessor<double, 4>(), f = batch.answer.accessor<double, 4>();
  const auto m = batch.mask.accessor<double, 4>();
  const auto r = batch.rotations.accessor<double, 3>();
  const auto minimum = constants.offset.accessor<double, 1>(), range = constants.scale.accessor<double, 1>();
  const auto deviation = constants.deviation.accessor<double, 1>();
  const bool scaled = config.scaling == "deviation", exact = config.alignment == "exact";
  double sums[3] = {}, texels = 0, kinematic = 0, kinematic_texels = 0, length = 0;
  for (int c = 0; c < 3; ++c) length += range[c] * (scaled ? deviation[c] : 1) / 3;
  for (int n = 0; n < kWindows * kFrames; ++n) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (m[n][0][y][x] == 0) continue;
        texels += 3;
        for (int c = 0; c < 9; ++c) {
          sums[c / 3] += std::pow((s[n][c][y][x] - f[n][c][y][x]) / (scaled ? deviation[c] : 1), 2);
        }
      }
    }
  }
  for (int w = 0; w < kWindows; ++w) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (m[w * kFrames][0][y][x] == 0) continue;
        kinematic_texels += 3;
        // World vectors of the synthesized frame, or of its error, from channels [first, first + 3) of frame k.
        const auto vector = [&](int k, int first, bool truth, int axis) {
          const int n = w * kFrames + k;
          const auto value = [&](int c) {
            const double own = (truth ? f : s)[n][first + c][y][x] * range[first + c] + minimum[first + c];
            const double zero = exact ? f[n][first + c][y][x] * range[first + c] + minimum[first + c] : 0.0;
            return own - zero;
          };
          if (!exact) return value(axis);
          return r[n][0][axis] * value(0) + r[n][1][axis] * value(1) + r[n][2][axis] * value(2);
        };
        for (int k = 1; k < kFrames; ++k) {
          for (int axis = 0; axis < 3; ++axis) {
            double residual = vector(k, 0, config.target == "ground_truth", axis) - vector(0, 0, false, axis);
            for (int j = 1; j <= k; ++j) residual -= kFrameTime * vector(j, 6, false, axis);
            kinematic += std::pow(residual / length, 2);
          }
        }
      }
    }
  }
  return (config.displacement * sums[0] + config.normal * sums[1] + config.velocity * sums[2]) / texels +
         config.kinematic * kinematic / kinematic_texels;
}

class LossVariants : public testing::TestWithParam<std::tuple<const char*, const char*, const char*>> {
 protected:
  LossConfig config() const {
    return config_of(std::get<0>(GetParam()), std::get<1>(GetParam()), std::get<2>(GetParam()));
  }
};

TEST_P(LossVariants, AgreeWithPlainLoopsAndFiniteDifferences) {
  const Batch batch = example_batch();
  const LossConstants constants = example_constants();
  auto synthesized = torch::rand({kWindows * kFrames, 9, kHeight, kWidth}, torch::kFloat64);
  const double expected = plain_total(synthesized, batch, constants, config());
  synthesized.set_requires_grad(true);
  const auto total = compute_losses(synthesized, batch, constants, config()).total;
  EXPECT_NEAR(total.item<double>(), expected, 1e-10 * expected);

  total.backward();
  const auto gradient = synthesized.grad().clone();
  synthesized.set_requires_grad(false);
  const double step = 1e-5;
  for (std::int64_t i = 0; i < synthesized.numel(); i += 37) {
    auto moved = synthesized.clone();
    moved.view({-1})[i] += step;
    const double up = plain_total(moved, batch, constants, config());
    moved.view({-1})[i] -= 2 * step;
    const double down = plain_total(moved, batch, constants, config());
    const double analytic = gradient.view({-1})[i].item<double>();
    EXPECT_NEAR((up - down) / (2 * step), analytic, 1e-7 + 1e-5 * std::abs(analytic)) << i;
  }
}

INSTANTIATE_TEST_SUITE_P(All, LossVariants,
                         testing::Combine(testing::Values("synthesized", "ground_truth"),
                                          testing::Values("exact", "shared"), testing::Values("none", "deviation")));

/// A point that moves and a frame of reference that turns: the true images have no kinematic loss in exact alignment.
TEST(Losses, TrueMotionHasNoKinematicLoss) {
  Batch batch = example_batch();
  const LossConstants constants = example_constants();
  const LossConfig config = config_of("synthesized", "exact", "none");
  const Losses losses = compute_losses(batch.answer, batch, constants, config);
  EXPECT_NEAR(losses.kinematic.item<double>(), 0, 1e-20);
  EXPECT_NEAR(losses.total.item<double>(), 0, 1e-20);
  // A world displacement of all frames alike keeps the relation: turn it into each frame's own axes.
  auto shifted = batch.answer.clone();
  const auto world = torch::tensor({0.1, -0.2, 0.3}, torch::kFloat64);
  for (std::int64_t n = 0; n < shifted.size(0); ++n) {
    const auto own = torch::matmul(batch.rotations[n], world) / constants.scale.slice(0, 0, 3);
    shifted[n].slice(0, 0, 3) += own.view({3, 1, 1});
  }
  EXPECT_NEAR(compute_losses(shifted, batch, constants, config).kinematic.item<double>(), 0, 1e-20);
  // One frame that jumps does not.
  shifted[1].slice(0, 0, 3) += 0.1;
  EXPECT_GT(compute_losses(shifted, batch, constants, config).kinematic.item<double>(), 1e-4);
}

constexpr int kVertices = 5, kReads = 2;

/// Five vertices, four faces around the first one, each vertex the mean of two texels, off centre.
MeshRead example_read() {
  MeshRead read;
  for (int i = 0; i < kReads * kVertices; ++i) {
    read.texels.push_back((7 * i + 4) % (kHeight * kWidth));
    read.weights.push_back(i < kVertices ? 0.25F : 0.75F);
  }
  read.rest = {0, 1, 0, -1, 0, 0.1F, 0, 0.2F, 0, 0, 0, 0, -1, 0, 1};
  read.faces = {0, 0, 0, 0, 1, 2, 3, 4, 2, 3, 4, 1};
  read.edges = {0, 0, 0, 0, 1, 2, 3, 4, 1, 2, 3, 4, 2, 3, 4, 1};
  return read;
}

/// Turns an example into one with vertices, everything in double.
void add_vertices(const MeshRead& read, Batch& batch, LossConstants& constants) {
  constants.set_vertices(read, torch::kCPU);
  constants.vertex_weights = constants.vertex_weights.to(torch::kFloat64);
  constants.edge_lengths = constants.edge_lengths.to(torch::kFloat64);
  constants.ring_average = constants.ring_average.to(torch::kFloat64);
  const std::int64_t images = batch.answer.size(0);
  batch.vertex_base =
      torch::tensor(read.rest).to(torch::kFloat64).view({1, 3, read.vertex_count()}).expand({images, -1, -1});
}

using Points = Eigen::Matrix<double, Eigen::Dynamic, 3>;

/// The mesh of one image, read vertex by vertex.
Points plain_mesh(const torch::Tensor& images, int n, const MeshRead& read, const LossConstants& constants) {
  const auto image = images.accessor<double, 4>()[n];
  const auto minimum = constants.offset.accessor<double, 1>(), range = constants.scale.accessor<double, 1>();
  Points points(kVertices, 3);
  for (int v = 0; v < kVertices; ++v) {
    for (int c = 0; c < 3; ++c) {
      points(v, c) = read.rest[static_cast<std::size_t>(c * kVertices + v)];
      for (int k = 0; k < kReads; ++k) {
        const auto i = static_cast<std::size_t>(k * kVertices + v);
        const auto texel = read.texels[i];
        points(v, c) += read.weights[i] * (image[c][texel / kWidth][texel % kWidth] * range[c] + minimum[c]);
      }
    }
  }
  return points;
}

Points plain_normals(const Points& points, const MeshRead& read) {
  Points normals = Points::Zero(kVertices, 3);
  const std::size_t faces = read.faces.size() / 3;
  for (std::size_t f = 0; f < faces; ++f) {
    const auto a = read.faces[f], b = read.faces[faces + f], c = read.faces[2 * faces + f];
    const Eigen::Vector3d u = points.row(b) - points.row(a), v = points.row(c) - points.row(a);
    for (const auto corner : {a, b, c}) normals.row(corner) += u.cross(v).transpose();
  }
  return normals.rowwise().normalized();
}

/// The three losses on vertices, weighted, mesh by mesh.
double plain_vertex_losses(const torch::Tensor& synthesized, const Batch& batch, const MeshRead& read,
                           const LossConstants& constants, const LossConfig& config) {
  const auto range = constants.scale.accessor<double, 1>(), deviation = constants.deviation.accessor<double, 1>();
  double length = 0, normal_length = 0, sum = 0;
  for (int c = 0; c < 3; ++c) {
    const bool scaled = config.scaling == "deviation";
    length += range[c] * (scaled ? deviation[c] : 1) / 3;
    normal_length += range[3 + c] * (scaled ? deviation[3 + c] : 1) / 3;
  }
  const int images = static_cast<int>(synthesized.size(0));
  const std::size_t edges = read.edges.size() / 2;
  const Eigen::Map<const Eigen::Matrix<float, kVertices, 3>> rest(read.rest.data());
  for (int n = 0; n < images; ++n) {
    const Points s = plain_mesh(synthesized, n, read, constants), h = plain_mesh(batch.answer, n, read, constants);
    sum += config.vertices * (s - h).squaredNorm() / (length * length * 3 * kVertices);
    const double turned = (plain_normals(s, read) - plain_normals(h, read)).squaredNorm();
    sum += config.vertex_normals * turned / (normal_length * normal_length * 3 * kVertices);
    for (std::size_t e = 0; e < edges; ++e) {
      const auto a = read.edges[e], b = read.edges[edges + e];
      const double strain = ((s.row(a) - s.row(b)).norm() - (h.row(a) - h.row(b)).norm()) /
                            (rest.row(a) - rest.row(b)).cast<double>().norm();
      sum += config.edges * std::pow(100 * strain, 2) / static_cast<double>(edges);
    }
  }
  return sum / images;
}

/// The weights of the reads hold the unit: what counts is the answer's own.
TEST(VertexLosses, DoNotDependOnTheUnitOfTheAnswer) {
  Batch batch = example_batch();
  LossConstants metres = example_constants(), edges = metres;
  MeshRead read = example_read();
  add_vertices(read, batch, metres);
  read.unit_m = 0.05F;
  for (float& weight : read.weights) weight *= read.unit_m;
  edges.set_vertices(read, torch::kCPU);
  LossConfig config;
  config.vertices = 1;
  const auto synthesized = torch::rand_like(batch.answer);
  const double expected = compute_losses(synthesized, batch, metres, config).vertices.item<double>();
  EXPECT_NEAR(compute_losses(synthesized, batch, edges, config).vertices.item<double>(), expected, 1e-5 * expected);
}

TEST(VertexLosses, AgreeWithPlainLoopsAndFiniteDifferences) {
  Batch batch = example_batch();
  LossConstants constants = example_constants();
  const MeshRead read = example_read();
  add_vertices(read, batch, constants);
  for (const char* scaling : {"none", "deviation"}) {
    for (int term = 0; term < 3; ++term) {
      SCOPED_TRACE(std::string(scaling) + ", term " + std::to_string(term));
      LossConfig config;
      config.displacement = config.normal = config.velocity = config.kinematic = 0;
      config.scaling = scaling;
      (term == 0 ? config.vertices : term == 1 ? config.vertex_normals : config.edges) = 0.7;
      auto synthesized = torch::rand_like(batch.answer);
      const double expected = plain_vertex_losses(synthesized, batch, read, constants, config);
      synthesized.set_requires_grad(true);
      const Losses losses = compute_losses(synthesized, batch, constants, config);
      EXPECT_NEAR(losses.total.item<double>(), expected, 1e-6 * expected);
      const auto& part = term == 0 ? losses.vertices : term == 1 ? losses.vertex_normals : losses.edges;
      EXPECT_NEAR(0.7 * part.item<double>(), expected, 1e-6 * expected);

      losses.total.backward();
      const auto gradient = synthesized.grad().clone();
      synthesized.set_requires_grad(false);
      const double step = 1e-6, sharpness = gradient.abs().max().item<double>();
      ASSERT_GT(sharpness, 0);
      for (std::int64_t i = 0; i < synthesized.numel(); ++i) {
        const double analytic = gradient.view({-1})[i].item<double>();
        if (analytic == 0 && i % 11 != 0) continue;  // most texels are read by no vertex
        auto moved = synthesized.clone();
        moved.view({-1})[i] += step;
        const double up = plain_vertex_losses(moved, batch, read, constants, config);
        moved.view({-1})[i] -= 2 * step;
        const double down = plain_vertex_losses(moved, batch, read, constants, config);
        ASSERT_NEAR((up - down) / (2 * step), analytic, 2e-5 * sharpness) << i;
      }
    }
  }
}

/// Energies of the normals, round by round; logarithms of their ratios.
double plain_wrinkle_loss(const torch::Tensor& synthesized, const Batch& batch, const MeshRead& read,
                          const LossConstants& constants) {
  Eigen::MatrixXd ring = Eigen::MatrixXd::Identity(kVertices, kVertices);
  const std::size_t edges = read.edges.size() / 2;
  for (std::size_t e = 0; e < edges; ++e) {
    const auto a = read.edges[e], b = read.edges[edges + e];
    ring(a, b) = ring(b, a) = 1;
  }
  const Eigen::VectorXd counts = ring.rowwise().sum();
  ring = (counts.cwiseInverse().asDiagonal() * ring).eval();
  const auto energies = [&](const Points& points) {
    Eigen::Vector3d result;
    Eigen::MatrixXd smooth = plain_normals(points, read);
    for (int band = 0, round = 0; band < 3; ++band) {
      const Eigen::MatrixXd before = smooth;
      for (; round < (band == 0 ? 1 : band == 1 ? 4 : 16); ++round) smooth = ring * smooth;
      result[band] = (before - smooth).squaredNorm() / kVertices;
    }
    return result;
  };
  double sum = 0;
  const int images = static_cast<int>(synthesized.size(0));
  for (int n = 0; n < images; ++n) {
    const Eigen::Vector3d s = energies(plain_mesh(synthesized, n, read, constants)),
                          h = energies(plain_mesh(batch.answer, n, read, constants));
    for (int band = 0; band < 3; ++band) sum += std::pow(std::log((s[band] + 1e-4) / (h[band] + 1e-4)), 2);
  }
  return sum / (3 * images);
}

TEST(WrinkleLoss, AgreesWithPlainLoopsAndFiniteDifferences) {
  Batch batch = example_batch();
  LossConstants constants = example_constants();
  const MeshRead read = example_read();
  add_vertices(read, batch, constants);
  LossConfig config;
  config.displacement = config.normal = config.velocity = config.kinematic = 0;
  config.wrinkles = 0.3;
  auto synthesized = torch::rand_like(batch.answer);
  const double expected = plain_wrinkle_loss(synthesized, batch, read, constants);
  ASSERT_GT(expected, 0.01);
  synthesized.set_requires_grad(true);
  const Losses losses = compute_losses(synthesized, batch, constants, config);
  EXPECT_NEAR(losses.wrinkles.item<double>(), expected, 1e-6 * expected);
  EXPECT_NEAR(losses.total.item<double>(), 0.3 * expected, 1e-6 * expected);

  losses.total.backward();
  const auto gradient = synthesized.grad().clone();
  synthesized.set_requires_grad(false);
  const double step = 1e-6, sharpness = gradient.abs().max().item<double>();
  ASSERT_GT(sharpness, 0);
  for (std::int64_t i = 0; i < synthesized.numel(); ++i) {
    const double analytic = gradient.view({-1})[i].item<double>();
    if (analytic == 0 && i % 11 != 0) continue;
    auto moved = synthesized.clone();
    moved.view({-1})[i] += step;
    const double up = plain_wrinkle_loss(moved, batch, read, constants);
    moved.view({-1})[i] -= 2 * step;
    const double down = plain_wrinkle_loss(moved, batch, read, constants);
    ASSERT_NEAR(0.3 * (up - down) / (2 * step), analytic, 2e-5 * sharpness) << i;
  }
}

/// Folds at another place are no error, half as many are.
TEST(WrinkleLoss, AsksForTheAmountAlone) {
  MeshRead read;
  constexpr int kSide = 16;
  for (int i = 0; i < kSide * kSide; ++i) {
    read.texels.push_back(i);
    read.weights.push_back(1);
    for (const int other : {i + 1, i + kSide}) {
      if (other == i + 1 ? other % kSide == 0 : other >= kSide * kSide) continue;
      read.edges.push_back(i);
      read.edges.push_back(other);
    }
  }
  std::vector<std::int64_t> ends;
  for (std::size_t e = 0; e < read.edges.size(); e += 2) ends.push_back(read.edges[e]);
  for (std::size_t e = 0; e < read.edges.size(); e += 2) ends.push_back(read.edges[e + 1]);
  read.edges = ends;
  read.rest.assign(static_cast<std::size_t>(3 * kSide * kSide), 0);
  std::vector<std::int64_t> corners[3];
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const int i = y * kSide + x;
      read.rest[static_cast<std::size_t>(i)] = static_cast<float>(x);
      read.rest[static_cast<std::size_t>(2 * kSide * kSide + i)] = static_cast<float>(y);
      if (x + 1 == kSide || y + 1 == kSide) continue;
      for (const auto& face : {std::array{i, i + kSide, i + 1}, std::array{i + 1, i + kSide, i + kSide + 1}}) {
        for (std::size_t k = 0; k < 3; ++k) corners[k].push_back(face[k]);
      }
    }
  }
  for (const auto& row : corners) read.faces.insert(read.faces.end(), row.begin(), row.end());
  // Heights of waves across, from texel values.
  const auto waves = [&](double height, double phase) {
    auto image = torch::zeros({1, 3, kSide, kSide}, torch::kFloat64);
    for (int x = 0; x < kSide; ++x) image.select(3, x).select(1, 1).fill_(height * std::sin(x * 1.3 + phase));
    return image;
  };
  Batch batch;
  batch.answer = waves(0.3, 0);
  batch.mask = torch::ones({1, 1, kSide, kSide}, torch::kFloat64);
  LossConstants constants;
  constants.offset = torch::zeros({3}, torch::kFloat64);
  constants.scale = constants.deviation = torch::ones({3}, torch::kFloat64);
  add_vertices(read, batch, constants);
  LossConfig config;
  config.displacement = config.normal = config.velocity = config.kinematic = 0;
  config.wrinkles = 1;
  const auto loss = [&](const torch::Tensor& image) {
    return compute_losses(image, batch, constants, config).wrinkles.item<double>();
  };
  EXPECT_EQ(loss(batch.answer), 0);
  EXPECT_LT(loss(waves(0.3, 2)), 0.05);
  EXPECT_GT(loss(waves(0.15, 0)), 0.5);
}

/// A right triangle with a vertex that is 1 cm or 1 m off.
TEST(VertexLosses, OneTriangleByHand) {
  MeshRead read;
  read.texels = {0, 1, 2};
  read.weights = {1, 1, 1};
  read.rest = {0, 1, 0, 0, 0, 0, 0, 0, 1};  // (0,0,0), (1,0,0), (0,0,1)
  read.faces = {0, 1, 2};
  read.edges = {0, 1, 2, 1, 2, 0};
  Batch batch;
  batch.answer = torch::full({1, 9, 1, 3}, 0.5, torch::kFloat64);
  batch.mask = torch::ones({1, 1, 1, 3}, torch::kFloat64);
  LossConstants constants;
  constants.offset = torch::full({9}, -0.5, torch::kFloat64);
  constants.scale = torch::ones({9}, torch::kFloat64);
  constants.deviation = torch::ones({9}, torch::kFloat64);
  add_vertices(read, batch, constants);
  LossConfig config;
  config.vertices = config.vertex_normals = config.edges = 1;

  auto along = batch.answer.clone();
  along[0][0][0][1] += 0.01;
  Losses losses = compute_losses(along, batch, constants, config);
  EXPECT_NEAR(losses.vertices.item<double>(), 1e-4 / 9, 1e-12);
  EXPECT_NEAR(losses.vertex_normals.item<double>(), 0, 1e-12);
  const double diagonal = (std::sqrt(1.01 * 1.01 + 1) / std::sqrt(2.0) - 1) / 0.01;
  EXPECT_NEAR(losses.edges.item<double>(), (1 + diagonal * diagonal) / 3, 1e-6);

  auto up = batch.answer.clone();
  up[0][1][0][1] += 1;  // the triangle turns by 45 degrees: |n - n'|^2 = 2 - 2 cos
  losses = compute_losses(up, batch, constants, config);
  EXPECT_NEAR(losses.vertices.item<double>(), 1.0 / 9, 1e-12);
  EXPECT_NEAR(losses.vertex_normals.item<double>(), (2 - std::sqrt(2.0)) / 3, 1e-12);
}

/// Vectors in axes of their own, which turn the same error, have the same losses on vertices and lengths.
TEST(VertexLosses, AnswersInOtherAxes) {
  Batch batch = example_batch();
  LossConstants constants = example_constants();
  add_vertices(example_read(), batch, constants);
  constants.offset = torch::zeros({3}, torch::kFloat64), constants.scale = torch::full({3}, 0.5, torch::kFloat64);
  constants.deviation = torch::ones({3}, torch::kFloat64);
  constants.normal = constants.velocity = -1;
  LossConfig config;
  config.vertices = config.vertex_normals = config.edges = 1;
  batch.answer = batch.answer.slice(1, 0, 3);
  const auto answer = torch::rand_like(batch.answer);
  const Losses expected = compute_losses(answer, batch, constants, config);
  EXPECT_EQ(expected.normal.item<double>(), 0);
  EXPECT_EQ(expected.velocity.item<double>(), 0);

  // Rows of a rotation are the axes, everywhere the same.
  const auto axes = rotation(0.8);
  batch.axes = axes.reshape({1, 9, 1, 1}).expand({batch.answer.size(0), 9, kHeight / 4, kWidth / 4}).contiguous();
  const auto in_axes = [&](const torch::Tensor& t) { return torch::einsum("ij,njhw->nihw", {axes, t}); };
  batch.answer = in_axes(batch.answer);
  const Losses actual = compute_losses(in_axes(answer), batch, constants, config);
  EXPECT_NEAR(actual.vertices.item<double>(), expected.vertices.item<double>(), 1e-9);
  EXPECT_NEAR(actual.vertex_normals.item<double>(), expected.vertex_normals.item<double>(), 1e-9);
  EXPECT_NEAR(actual.edges.item<double>(), expected.edges.item<double>(), 1e-6 * expected.edges.item<double>());
}

TEST(VertexLosses, WeightZeroComputesNothing) {
  const Batch batch = example_batch();  // without vertices
  const LossConfig config = config_of("synthesized", "exact", "none");
  const Losses losses = compute_losses(torch::rand_like(batch.answer), batch, example_constants(), config);
  for (const auto& part : {losses.vertices, losses.vertex_normals, losses.edges}) EXPECT_EQ(part.item<double>(), 0);
}

TEST(Losses, TexelsOutsideTheMaskDoNotCount) {
  const Batch batch = example_batch();
  const LossConstants constants = example_constants();
  const LossConfig config = config_of("synthesized", "exact", "none");
  auto a = torch::rand_like(batch.answer);
  const double before = compute_losses(a, batch, constants, config).total.item<double>();
  a = a + 100 * (1 - batch.mask);
  EXPECT_DOUBLE_EQ(compute_losses(a, batch, constants, config).total.item<double>(), before);
}

TEST(Losses, SingleFramesHaveNoKinematicLoss) {
  Batch batch = example_batch();
  batch.frames = 1;
  const auto a = torch::rand_like(batch.answer);
  const LossConfig config = config_of("synthesized", "exact", "none");
  EXPECT_EQ(compute_losses(a, batch, example_constants(), config).kinematic.item<double>(), 0);
}

}  // namespace
}  // namespace pleat::superres
