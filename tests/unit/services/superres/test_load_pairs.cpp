// From a data set on disk to normalised pairs, and the judge that turns images back into meshes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <unistd.h>

#include <cmath>
#include <filesystem>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr int kFrames = 7;

/// A flat sheet of columns x rows quads, each cut in two, 0.1 m wide.
Topology sheet(int columns, int rows) {
  Topology mesh;
  const int stride = columns + 1;
  mesh.rest_positions.resize(stride * (rows + 1), 3);
  mesh.uv.resize(stride * (rows + 1), 2);
  for (int r = 0; r <= rows; ++r) {
    for (int c = 0; c <= columns; ++c) {
      mesh.rest_positions.row(r * stride + c) << 0.1F * static_cast<float>(c), 0.0F, -0.1F * static_cast<float>(r);
      mesh.uv.row(r * stride + c) << 0.1F * static_cast<float>(c), 0.1F * static_cast<float>(r);
    }
  }
  mesh.faces.resize(2 * columns * rows, 3);
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      const auto i = static_cast<std::uint32_t>(r * stride + c);
      const auto s = static_cast<std::uint32_t>(stride);
      mesh.faces.row(2 * (r * columns + c)) << i, i + 1, i + s + 1;
      mesh.faces.row(2 * (r * columns + c) + 1) << i, i + s + 1, i + s;
    }
  }
  mesh.uv_faces = mesh.faces;
  return mesh;
}

Positions wave(const Positions& rest, int frame, int sequence, bool detail) {
  Positions result = rest;
  for (Eigen::Index i = 0; i < rest.rows(); ++i) {
    const float x = rest(i, 0), z = rest(i, 2), t = static_cast<float>(frame) * 0.2F + static_cast<float>(sequence);
    result(i, 1) += 0.1F * std::sin(5 * x + t) + 0.05F * std::cos(4 * z - t);
    result(i, 0) += 0.02F * t;
    if (detail) result(i, 1) += 0.01F * std::sin(25 * x + t);
  }
  return result;
}

class LoadPairs : public testing::Test {
 protected:
  void SetUp() override {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::temp_directory_path() / (std::string("pleat_pairs_") + info->name() + std::to_string(::getpid()));
    const Topology coarse = sheet(8, 6);
    const Subdivision subdivision = subdivide(coarse, 2);
    master_.time_step_s = 0.005;
    master_.frame_time_s = 0.04;
    master_.topology = {coarse, subdivision.fine, subdivision.feature_vertices};
    master_.sequences = {"a", "b"};
  }
  void TearDown() override { fs::remove_all(folder_); }

  void write(bool normalized) {
    if (normalized) {
      master_.normalization.emplace();
      for (std::size_t c = 0; c < 9; ++c) {
        const float reach = c < 3 ? 0.5F : c < 6 ? 1.0F : 2.0F;
        master_.normalization->minimum[c] = -reach;
        master_.normalization->maximum[c] = reach;
      }
    }
    write_dataset_master(folder_, master_);
    for (int s = 0; s < 2; ++s) {
      SequenceOptions options;
      options.name = master_.sequences[static_cast<std::size_t>(s)];
      options.split = s == 0 ? "train" : "test";
      options.scene = "{}";
      options.frames = kFrames;
      options.coarse_vertices = master_.topology.coarse.vertex_count();
      options.fine_vertices = master_.topology.fine.vertex_count();
      options.topology_hash = topology_hash(master_.topology.fine);
      SequenceWriter writer(folder_, options);
      for (int f = 0; f < kFrames; ++f) {
        SequenceFrame frame;
        frame.time_s = 0.04 * f;
        frame.coarse = wave(master_.topology.coarse.rest_positions, f, s, false);
        frame.fine = wave(master_.topology.fine.rest_positions, f, s, true);
        writer.append(frame);
      }
      writer.finish();
    }
  }

  TrainConfig config() const {
    TrainConfig c;
    c.name = "x", c.output = (folder_ / "out").string();
    c.dataset = folder_.string();
    c.images.coarse_width = 12, c.images.coarse_height = 9;
    c.validation.every_frames = 2;
    c.threads = 1;
    return c;
  }

  fs::path folder_;
  DatasetMaster master_;
};

void quiet(const std::string&) {}

TEST_F(LoadPairs, ImagesBelongToTheFrames) {
  write(true);
  LoadedPairs loaded = load_pairs(config(), quiet);
  const PairData& data = loaded.data;
  ASSERT_EQ(data.sequences.size(), 2U);
  EXPECT_FALSE(data.sequences[0].validation);
  EXPECT_TRUE(data.sequences[1].validation);
  EXPECT_EQ(data.training_frames(), static_cast<std::size_t>(kFrames));
  EXPECT_EQ(data.coarse_width(), 12);
  EXPECT_EQ(data.topology_hash, topology_hash(master_.topology.coarse));
  EXPECT_EQ(data.sheet_axes.size(), 2U);
  EXPECT_DOUBLE_EQ(data.frame_time_s, 0.04);

  const auto& sequence = data.sequences[1];
  std::vector<float> fine(9 * 48 * 36), coarse(9 * 12 * 9);
  sequence.fine.read(2, 0, 0, 36, 48, fine.data());
  // The true image is nearly the true mesh; interpolating the coarse mesh is not, because it lacks the 10 mm detail.
  EXPECT_LT(loaded.judge->squared_error(1, 2, fine), 1e-9);
  const double interpolated = loaded.judge->barycentric_squared_error(1, 2);
  EXPECT_GT(interpolated, 2e-5);
  EXPECT_NEAR(loaded.judge->squared_error(1, 2, loaded.judge->barycentric_image(1, 2)), interpolated,
              0.05 * interpolated);
  EXPECT_THROW(loaded.judge->squared_error(1, 1, fine), Error);
}

TEST_F(LoadPairs, VelocitiesAreBackwardDifferences) {
  write(true);
  const LoadedPairs loaded = load_pairs(config(), quiet);
  const auto& sequence = loaded.data.sequences[0];
  const std::size_t plane = 36 * 48;
  std::vector<float> before(9 * plane), now(9 * plane);
  const auto physical = [](float unit, float reach) { return (2 * unit - 1) * reach; };
  // World motion: R^T d changes by dt R^T v, but for the part that the alignment's translation takes out, which is the
  // same for all texels. The rest positions count where the rotation changes, so compare with rotations near identity.
  sequence.fine.read(0, 0, 0, 36, 48, now.data());
  for (std::size_t i = 6 * plane; i < 9 * plane; ++i) EXPECT_NEAR(physical(now[i], 2), 0, 1e-3);
  sequence.fine.read(3, 0, 0, 36, 48, now.data());
  double largest = 0;
  for (std::size_t i = 7 * plane; i < 8 * plane; ++i)
    largest = std::max(largest, std::abs(static_cast<double>(physical(now[i], 2))));
  // d/dt of 0.1 sin(5 x + 0.2 frame) over frames of 0.04 s: 0.5 m/s, and 0.05 m/s and 0.25 m/s of the other waves.
  EXPECT_GT(largest, 0.4);
  EXPECT_LT(largest, 0.9);
}

TEST_F(LoadPairs, MissingNormalisationIsMeasuredOnTheTrainingSplit) {
  write(false);
  std::string said;
  const LoadedPairs loaded = load_pairs(config(), [&](const std::string& line) { said += line + "\n"; });
  EXPECT_THAT(said, HasSubstr("no normalisation"));
  std::vector<float> fine(9 * 48 * 36);
  loaded.data.sequences[0].fine.read(0, 0, 0, 36, 48, fine.data());
  for (const float v : fine) {
    EXPECT_GE(v, -0.01F);
    EXPECT_LE(v, 1.01F);
  }
}

TEST_F(LoadPairs, NamedValidationSequencesLeaveTraining) {
  write(true);
  TrainConfig c = config();
  c.validation.sequences = {"b"};
  EXPECT_TRUE(load_pairs(c, quiet).data.sequences[1].validation);
  c.validation.sequences = {"a", "b"};
  EXPECT_THROW(load_pairs(c, quiet), Error);  // nothing left to train on
  c.validation.sequences = {"nobody"};
  try {
    load_pairs(c, quiet);
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("nobody"));
  }
}

TEST_F(LoadPairs, MemoryLimitIsCheckedFirst) {
  write(true);
  TrainConfig c = config();
  c.images.coarse_width = 240, c.images.coarse_height = 180, c.cache_limit_mb = 1;
  try {
    load_pairs(c, quiet);
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kResourceExhausted);
    EXPECT_THAT(error.what(), HasSubstr("cache_limit_mb"));
  }
}

TEST_F(LoadPairs, AbsentDataSetIsNamed) {
  try {
    load_pairs(config(), quiet);
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kNotFound);
  }
}

}  // namespace
}  // namespace pleat::superres
