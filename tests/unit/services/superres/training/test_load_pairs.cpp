// From a data set on disk to normalised pairs, and the judge that turns images back into meshes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "common/mesh/connectivity.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "services/superres/training/pairs.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/superres/example_dataset.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using test::error_of;
using testing::HasSubstr;

class LoadPairs : public testing::Test {
 protected:
  void write(bool normalized) const { write_example_dataset(folder_, master_, normalized); }

  TrainConfig config() const {
    TrainConfig c;
    c.name = "x", c.output = (folder_ / "out").string();
    c.dataset = folder_.string();
    c.images.coarse_width = 12, c.images.coarse_height = 9;
    c.validation.every_frames = 2;
    c.threads = 1;
    return c;
  }

  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path() / "data";
  const DatasetMaster master_ = example_master();
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
  EXPECT_EQ(data.width(), 12);
  EXPECT_EQ(data.meshes[0].topology_hash, topology_hash(master_.topology.coarse));
  EXPECT_EQ(data.meshes[0].sheet_axes.size(), 2U);
  EXPECT_DOUBLE_EQ(data.frame_time_s, 0.04);

  EXPECT_EQ(data.input_ranges, example_range());
  EXPECT_EQ(data.constant_channels(), 0);

  const auto& sequence = data.sequences[1];
  std::vector<float> fine(9 * 48 * 36);
  sequence.answer.read(2, 0, 0, 36, 48, fine.data());
  // The true image is nearly the true mesh; interpolating the coarse mesh is not, because it lacks the 10 mm detail.
  EXPECT_LT(loaded.judge->squared_error(1, 2, fine), 1e-9);
  const double interpolated = loaded.judge->barycentric_squared_error(1, 2);
  EXPECT_GT(interpolated, 2e-5);
  EXPECT_NEAR(loaded.judge->squared_error(1, 2, loaded.judge->barycentric_answer(1, 2)), interpolated,
              0.05 * interpolated);
  EXPECT_THROW(loaded.judge->squared_error(1, 1, fine), Error);
}

TEST_F(LoadPairs, VertexReadMakesTheMeshThatTheJudgeMakes) {
  write(true);
  EXPECT_TRUE(load_pairs(config(), quiet).data.meshes[0].mesh_read.rest.empty());
  TrainConfig c = config();
  c.patch = 0, c.losses.edges = 0.1;
  const LoadedPairs loaded = load_pairs(c, quiet);
  const MeshRead& read = loaded.data.meshes[0].mesh_read;
  const Topology& mesh = master_.topology.fine;
  const auto vertices = static_cast<std::size_t>(mesh.vertex_count()),
             faces = static_cast<std::size_t>(mesh.face_count());
  ASSERT_EQ(read.vertex_count(), mesh.vertex_count());

  const std::size_t plane = 36 * 48;
  std::vector<float> image(9 * plane), other(9 * plane);
  loaded.data.sequences[1].answer.read(2, 0, 0, 36, 48, image.data());
  for (std::size_t i = 0; i < 3 * plane; ++i) other[i] = image[i] + 0.01F * std::sin(static_cast<float>(i));
  double sum = 0;
  for (std::size_t v = 0; v < vertices; ++v) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      double error = 0;
      for (std::size_t i = v; i < read.texels.size(); i += vertices) {
        const std::size_t texel = axis * plane + static_cast<std::size_t>(read.texels[i]);
        error += read.weights[i] * (other[texel] - image[texel]);  // the displacements' range is 1 m
      }
      sum += error * error;
      EXPECT_EQ(read.rest[axis * vertices + v],
                mesh.rest_positions(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(axis)));
    }
  }
  const double expected = loaded.judge->squared_error(1, 2, other);
  EXPECT_NEAR(sum / static_cast<double>(vertices), expected, 1e-3 * expected);

  ASSERT_EQ(read.faces.size(), 3 * faces);
  for (std::size_t f = 0; f < faces; ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_EQ(read.faces[k * faces + f], mesh.faces(static_cast<Eigen::Index>(f), static_cast<Eigen::Index>(k)));
    }
  }
  // Euler: V - E + F = 1 of a sheet without holes.
  const std::size_t edges = vertices + faces - 1;
  ASSERT_EQ(read.edges.size(), 2 * edges);
  for (std::size_t e = 0; e < edges; ++e) EXPECT_NE(read.edges[e], read.edges[edges + e]);
}

TEST_F(LoadPairs, OneFrameInTwoOfTheTrainingSequences) {
  write(true);
  const LoadedPairs all = load_pairs(config(), quiet);
  TrainConfig few = config();
  few.every_frames = 2;
  const LoadedPairs some = load_pairs(few, quiet);
  const PairSequence &whole = all.data.sequences[0], &part = some.data.sequences[0];
  ASSERT_EQ(part.answer.size(), (whole.answer.size() + 1) / 2);
  EXPECT_EQ(some.data.sequences[1].answer.size(), all.data.sequences[1].answer.size());  // validation
  std::vector<float> expected(9 * 48 * 36), image(9 * 48 * 36);
  for (std::size_t f = 0; f < part.answer.size(); ++f) {
    whole.answer.read(2 * f, 0, 0, 36, 48, expected.data());
    part.answer.read(f, 0, 0, 36, 48, image.data());
    EXPECT_EQ(image, expected) << f;  // velocities of the frame before, too
  }
}

TrainConfig any_mesh(TrainConfig c) {
  c.serves = "any";
  c.images.layout = "detail", c.images.units = "coarse_edges";
  c.images.coarse_width = c.images.coarse_height = 0;
  c.losses.kinematic = 0;
  return c;
}

TEST_F(LoadPairs, SequencesMayHaveMeshesOfTheirOwn) {
  write_two_meshes(folder_);
  TrainConfig c = any_mesh(config());
  c.patch = 0, c.losses.vertices = 1;
  const LoadedPairs loaded = load_pairs(c, quiet);
  const PairData& data = loaded.data;
  ASSERT_EQ(data.sequences.size(), 4U);
  ASSERT_EQ(data.meshes.size(), 2U);
  EXPECT_THAT(data.description, HasSubstr("\"meshes\":2"));
  const DatasetReader reader(folder_);
  for (std::size_t s = 0; s < 4; ++s) {
    const PairSequence& sequence = data.sequences[s];
    const PairMesh& mesh = data.mesh_of(sequence);
    const auto meshes = reader.meshes(sequence.name);
    EXPECT_EQ(sequence.mesh, s / 2);
    EXPECT_EQ(mesh.topology_hash, topology_hash(meshes->coarse));
    EXPECT_NEAR(mesh.mesh_read.unit_m, mean_edge_length(meshes->coarse), 1e-6);
    EXPECT_EQ(mesh.mesh_read.vertex_count(), meshes->fine.vertex_count());
    EXPECT_EQ(mesh.constants.shape[1], sequence.input.height());
    const auto height = sequence.answer.height(), width = sequence.answer.width();
    EXPECT_EQ(mesh.answer_mask.size(), static_cast<std::size_t>(height) * static_cast<std::size_t>(width));
    if (!sequence.validation) continue;
    // Each is judged as its own mesh: the true answer is nearly the true mesh.
    std::vector<float> answer(3 * mesh.answer_mask.size()), nothing(answer.size(), 0.0F);
    sequence.answer.read(2, 0, 0, height, width, answer.data());
    const double interpolated = loaded.judge->barycentric_squared_error(s, 2);
    EXPECT_LT(loaded.judge->squared_error(s, 2, answer), 1e-3 * interpolated);
    EXPECT_NEAR(loaded.judge->squared_error(s, 2, nothing), interpolated, 1e-6 * interpolated);
    Positions base;
    data.geometry->base(s, 2, base);
    EXPECT_EQ(base.rows(), meshes->fine.vertex_count());
  }
  EXPECT_NE(data.sequences[0].input.width(), data.sequences[2].input.width());
}

TEST_F(LoadPairs, SeveralMeshesNeedABundleForAny) {
  write_two_meshes(folder_);
  TrainConfig c = any_mesh(config());
  c.serves = "mesh";
  EXPECT_THAT(error_of([&] { load_pairs(c, quiet); }).what(), HasSubstr("'serves' = 'any'"));
}

/// The detail layout, for any rounds and either rule, judged as a mesh.
TEST_F(LoadPairs, DetailOfAnyRoundsAndRule) {
  for (const SubdivisionSpec spec :
       {SubdivisionSpec{1, SubdivisionRule::kMidpoint}, SubdivisionSpec{2, SubdivisionRule::kMidpoint},
        SubdivisionSpec{2, SubdivisionRule::kSmooth}}) {
    SCOPED_TRACE(std::to_string(spec.rounds) + (spec.rule == SubdivisionRule::kSmooth ? " Loop" : ""));
    fs::remove_all(folder_);
    DatasetMaster master = master_;
    const Subdivision subdivision = subdivide(master.topology.coarse, spec);
    master.topology.fine = subdivision.fine, master.topology.feature_vertices = subdivision.feature_vertices;
    write_example_dataset(folder_, master);
    TrainConfig c = config();
    c.images.layout = "detail";
    c.patch = 0, c.losses.kinematic = 0, c.losses.edges = 0.1;
    const LoadedPairs loaded = load_pairs(c, quiet);
    const PairData& data = loaded.data;
    EXPECT_EQ(data.representation.subdivision, spec);
    EXPECT_EQ(data.input_ranges.channels(), 17U);
    EXPECT_EQ(data.input_ranges.limit, 6);
    EXPECT_EQ(data.output_ranges.offset, (std::vector<float>{0, 0, 0}));
    EXPECT_EQ(data.constant_channels(), 32);
    const ImageStore& answers = data.sequences[1].answer;
    std::vector<float> answer(3 * 48 * 36), nothing(3 * 48 * 36, 0.0F);
    answers.read(2, 0, 0, 36, 48, answer.data());
    const double upsampled = loaded.judge->barycentric_squared_error(1, 2);
    EXPECT_LT(loaded.judge->squared_error(1, 2, answer), 1e-3 * upsampled);
    EXPECT_NEAR(loaded.judge->squared_error(1, 2, nothing), upsampled, 1e-3 * upsampled);

    // What losses on vertices add: the base, and the answer turned into the alignment's axes.
    Positions base;
    Tensor axes;
    data.geometry->base(1, 2, base);
    data.geometry->axes(1, 2, axes);
    EXPECT_EQ(base.rows(), subdivision.fine.vertex_count());
    EXPECT_EQ(axes.shape, (std::vector<std::int64_t>{9, 9, 12}));
    data.geometry->base(0, 5, base);
  }
}

TEST_F(LoadPairs, VertexFeaturesHaveAPlaceForEachFace) {
  write(true);
  TrainConfig c = config();
  c.representation = "vertex_features", c.window = 2;
  c.patch = 0, c.losses.kinematic = 0, c.losses.vertices = 1;
  const LoadedPairs loaded = load_pairs(c, quiet);
  const PairData& data = loaded.data;
  EXPECT_TRUE(data.detail());
  EXPECT_FALSE(data.has_axes());
  EXPECT_EQ(data.height(), 1);
  EXPECT_EQ(data.width(), master_.topology.coarse.face_count());
  EXPECT_EQ(data.scale(), 4);
  EXPECT_EQ(data.input_ranges.channels(), 45U);
  EXPECT_EQ(data.sequences[0].input.channels(), 90);
  EXPECT_EQ(data.output_ranges.offset, std::vector<float>(9, 0.0F));
  EXPECT_EQ(data.constant_channels(), 27);
  const ImageStore& answers = data.sequences[1].answer;
  std::vector<float> answer(static_cast<std::size_t>(9 * 16 * data.width())), nothing(answer.size(), 0.0F);
  answers.read(2, 0, 0, 4, 4 * data.width(), answer.data());
  const double upsampled = loaded.judge->barycentric_squared_error(1, 2);
  EXPECT_LT(loaded.judge->squared_error(1, 2, answer), 1e-4 * upsampled);
  EXPECT_NEAR(loaded.judge->squared_error(1, 2, nothing), upsampled, 1e-4 * upsampled);
  EXPECT_EQ(data.meshes[0].mesh_read.vertex_count(), master_.topology.fine.vertex_count());
}

TEST_F(LoadPairs, WindowsShowTheFramesBefore) {
  write(true);
  TrainConfig c = config();
  const LoadedPairs single = load_pairs(c, quiet);
  c.window = 3;
  const LoadedPairs loaded = load_pairs(c, quiet);
  const ImageStore &one = single.data.sequences[0].input, &three = loaded.data.sequences[0].input;
  ASSERT_EQ(three.channels(), 27);
  std::vector<float> images(27 * 108), newest(9 * 108);
  for (const std::size_t f : {0U, 1U, 4U, 6U}) {
    three.read(f, 0, 0, 9, 12, images.data());
    one.read(f, 0, 0, 9, 12, newest.data());
    EXPECT_TRUE(std::equal(newest.begin(), newest.end(), images.begin() + 18 * 108)) << f;
    // At the beginning the first frame stands for those before it.
    const bool same = std::equal(newest.begin(), newest.end(), images.begin());
    EXPECT_EQ(same, f == 0) << f;
  }
}

TEST_F(LoadPairs, AStrideLeavesFramesOutOfTheWindow) {
  write(true);
  TrainConfig c = config();
  c.window = 5;
  const LoadedPairs all = load_pairs(c, quiet);
  c.window = 3, c.window_stride = 2;
  const LoadedPairs some = load_pairs(c, quiet);
  ASSERT_EQ(some.data.representation.window_stride, 2);
  const ImageStore &five = all.data.sequences[0].input, &three = some.data.sequences[0].input;
  constexpr std::size_t kFrame = 9 * 108;
  std::vector<float> dense(5 * kFrame), sparse(3 * kFrame);
  for (const std::size_t f : {0U, 1U, 3U, 6U}) {
    five.read(f, 0, 0, 9, 12, dense.data());
    three.read(f, 0, 0, 9, 12, sparse.data());
    for (std::size_t t = 0; t < 3; ++t) {
      EXPECT_TRUE(std::equal(sparse.begin() + static_cast<std::ptrdiff_t>(t * kFrame),
                             sparse.begin() + static_cast<std::ptrdiff_t>((t + 1) * kFrame),
                             dense.begin() + static_cast<std::ptrdiff_t>(2 * t * kFrame)))
          << f << " " << t;
    }
  }
}

TEST_F(LoadPairs, StopsBetweenAFewFrames) {
  write(true);
  int asked = 0;
  const Error error = error_of([&] { load_pairs(config(), quiet, [&] { return ++asked > 1; }); });
  EXPECT_EQ(error.code(), ErrorCode::kCancelled);
  EXPECT_EQ(asked, 2);
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
  sequence.answer.read(0, 0, 0, 36, 48, now.data());
  for (std::size_t i = 6 * plane; i < 9 * plane; ++i) EXPECT_NEAR(physical(now[i], 2), 0, 1e-3);
  sequence.answer.read(3, 0, 0, 36, 48, now.data());
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
  loaded.data.sequences[0].answer.read(0, 0, 0, 36, 48, fine.data());
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
  EXPECT_THAT(error_of([&] { load_pairs(c, quiet); }).what(), HasSubstr("nobody"));
}

TEST_F(LoadPairs, MemoryLimitIsCheckedFirst) {
  write(true);
  TrainConfig c = config();
  c.images.coarse_width = 240, c.images.coarse_height = 180, c.cache_limit_mb = 1;
  const Error error = error_of([&] { load_pairs(c, quiet); });
  EXPECT_EQ(error.code(), ErrorCode::kResourceExhausted);
  EXPECT_THAT(error.what(), HasSubstr("cache_limit_mb"));
}

TEST_F(LoadPairs, UnusableSequencesAreSkippedAndNamed) {
  write(true);
  DatasetMaster master = master_;
  master.normalization = example_range();
  master.sequences = {"a", "b", "cut", "half"};
  write_dataset_master(folder_, master);
  write_sequence(folder_, master, "cut", "train", 2);
  write_sequence(folder_, master, "half", "train", 3, kFrames / 2);
  const fs::path cut = folder_ / "sequences" / "cut.h5";
  fs::resize_file(cut, fs::file_size(cut) / 2);
  std::string said;
  const auto collect = [&](const std::string& line) { said += line + "\n"; };
  const LoadedPairs loaded = load_pairs(config(), collect);
  EXPECT_EQ(loaded.data.sequences.size(), 2U);
  EXPECT_THAT(said, HasSubstr("warning: skipped: sequence cut"));
  EXPECT_THAT(said, HasSubstr("warning: skipped: sequence half: 3 of 7 frames"));
  TrainConfig strict = config();
  strict.strict = true;
  const Error error = error_of([&] { load_pairs(strict, quiet); });
  EXPECT_EQ(error.code(), ErrorCode::kDataLoss);
  EXPECT_THAT(error.what(), HasSubstr("sequence cut"));
}

TEST_F(LoadPairs, AnotherMeshOrNothingToTrainOnIsRefused) {
  write(true);
  DatasetMaster other = master_;
  other.topology.fine.rest_positions(3, 1) += 0.1F;
  write_sequence(folder_, other, "a", "train", 0);
  EXPECT_THROW(load_pairs(config(), quiet), Error);
  fs::remove_all(folder_);
  DatasetMaster untrained = master_;
  untrained.sequences = {"b"};
  write_dataset_master(folder_, untrained);
  write_sequence(folder_, untrained, "b", "test", 1);
  const Error error = error_of([&] { load_pairs(config(), quiet); });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_THAT(error.what(), HasSubstr("split 'train'"));
}

TEST_F(LoadPairs, ImagesAreConvertedOnceAndDamagedFilesAgain) {
  write(true);
  const auto read_fine = [](const LoadedPairs& loaded) {
    std::vector<float> fine(9 * 48 * 36);
    loaded.data.sequences[0].answer.read(4, 0, 0, 36, 48, fine.data());
    return fine;
  };
  const std::vector<float> first = read_fine(load_pairs(config(), quiet));
  std::string said;
  const auto collect = [&](const std::string& line) { said += line + "\n"; };
  EXPECT_EQ(read_fine(load_pairs(config(), collect)), first);
  EXPECT_THAT(said, HasSubstr("7 frames from"));
  EXPECT_THAT(said, testing::Not(HasSubstr("converted")));

  for (const auto& file : fs::directory_iterator(folder_ / "images")) {
    fs::resize_file(file.path(), fs::file_size(file.path()) - 1);
  }
  said.clear();
  EXPECT_EQ(read_fine(load_pairs(config(), collect)), first);
  EXPECT_THAT(said, HasSubstr("converted"));

  // Another kind of image has files of its own.
  TrainConfig exact = config();
  exact.cache = "float32";
  exact.cache_folder = (folder_ / "elsewhere").string();
  const std::vector<float> values = read_fine(load_pairs(exact, quiet));
  EXPECT_NE(values, first);
  for (std::size_t i = 0; i < values.size(); ++i) ASSERT_NEAR(values[i], first[i], 1.6e-5);
}

TEST_F(LoadPairs, StoppingIsHeardWhileImagesAreConverted) {
  write(true);
  std::atomic<bool> stop{false};
  const auto stop_after_first = [&](const std::string& line) { stop = stop || line.find("converted") != line.npos; };
  const Error error = error_of([&] { load_pairs(config(), stop_after_first, [&] { return stop.load(); }); });
  EXPECT_EQ(error.code(), ErrorCode::kCancelled);
  EXPECT_THAT(error.what(), HasSubstr("while images were converted"));
  // What was whole by then is used by the next training, and nothing else lies about.
  std::string said;
  load_pairs(config(), [&](const std::string& line) { said += line + "\n"; });
  EXPECT_THAT(said, testing::AllOf(HasSubstr("frames from"), HasSubstr("converted")));
  for (const auto& file : fs::directory_iterator(folder_ / "images")) EXPECT_EQ(file.path().extension(), ".bin");
}

TEST_F(LoadPairs, AbsentDataSetIsNamed) {
  EXPECT_EQ(error_of([&] { load_pairs(config(), quiet); }).code(), ErrorCode::kNotFound);
}

TEST_F(LoadPairs, FeaturesAreScaledByChannelByGroupOrToThePublishedRange) {
  write(false);
  TrainConfig c = config();
  c.representation = "vertex_features";
  c.patch = 0, c.losses.kinematic = 0;
  c.vertex_features.answer = "features";
  c.cache = "float32";
  const auto ranges = [&](const char* how) {
    c.vertex_features.normalization = how;
    return load_pairs(c, quiet).data;
  };
  const PairData by_channel = ranges("channel"), by_group = ranges("group"), published = ranges("range");
  const auto& names = by_group.answer_channels;
  ASSERT_EQ(names.size(), 12U);
  for (std::size_t i = 0; i < names.size(); ++i) {
    const bool diagonal = names[i] == "stretch_xx" || names[i] == "stretch_yy" || names[i] == "stretch_zz";
    EXPECT_EQ(by_group.output_ranges.offset[i], diagonal ? 1.0F : 0.0F) << names[i];
    const std::size_t first = i < 3 ? 0 : i < 6 ? 3 : 6;
    EXPECT_EQ(by_group.output_ranges.scale[i], by_group.output_ranges.scale[first]);
    EXPECT_EQ(published.output_ranges.scale[i], published.output_ranges.scale[first]);
    EXPECT_EQ(published.output_ranges.offset[i], published.output_ranges.offset[first]);
  }
  EXPECT_NE(by_channel.output_ranges.scale[3], by_channel.output_ranges.scale[4]);
  EXPECT_EQ(published.input_ranges.limit, 0) << "live values beyond the range are kept";
  // Each group reaches both ends of the published range, and nothing lies beyond.
  const ImageStore& answers = published.sequences[0].answer;
  std::vector<float> values(12 * static_cast<std::size_t>(answers.height()) *
                            static_cast<std::size_t>(answers.width()));
  float low[3] = {1, 1, 1}, high[3] = {-1, -1, -1};
  for (std::size_t f = 0; f < answers.size(); ++f) {
    answers.read(f, 0, 0, answers.height(), answers.width(), values.data());
    const std::size_t plane = values.size() / 12;
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (published.meshes[0].answer_mask[i % plane] == 0) continue;
      const std::size_t channel = i / plane, group = channel < 3 ? 0 : channel < 6 ? 1 : 2;
      low[group] = std::min(low[group], values[i]), high[group] = std::max(high[group], values[i]);
    }
  }
  for (int group = 0; group < 3; ++group) {
    EXPECT_NEAR(low[group], -0.95F, 1e-4F) << group;
    EXPECT_NEAR(high[group], 0.95F, 1e-4F) << group;
  }
}

TEST_F(LoadPairs, ANetworkThatConvolvesKnowsTheMeshes) {
  write(false);
  TrainConfig c = config();
  EXPECT_EQ(load_pairs(c, quiet).data.mesh, nullptr);
  c.representation = "vertex_features";
  c.patch = 0, c.losses.kinematic = 0;
  for (const char* answer : {"gradients", "features_alone"}) {
    c.vertex_features.answer = answer;
    const PairData data = load_pairs(c, quiet).data;
    const MeshPorts& mesh = *data.mesh;
    const Topology &coarse = master_.topology.coarse, &fine = master_.topology.fine;
    EXPECT_EQ(mesh.corners, 3);
    EXPECT_EQ(mesh.features, 9);
    ASSERT_EQ(mesh.coarse.rows(), coarse.vertex_count());
    for (Eigen::Index v = 0; v < coarse.vertex_count(); ++v) {
      const std::int64_t place = mesh.coarse.places[static_cast<std::size_t>(v)];
      EXPECT_EQ(coarse.faces(place % coarse.face_count(), place / coarse.face_count()), v);
    }
    std::size_t edges = 0;
    for (const auto& [map, topology] : {std::pair{&mesh.coarse_ring, &coarse}, std::pair{&mesh.fine_ring, &fine}}) {
      edges = build_connectivity(topology->vertex_count(), topology->faces).edges.size();
      EXPECT_EQ(map->rows(), topology->vertex_count());
      EXPECT_EQ(map->places.size(), 2 * edges);
    }
    // Reading and writing are inverse.
    ASSERT_EQ(mesh.fine_read.rows(), static_cast<std::int64_t>(data.meshes[0].answer_mask.size()));
    for (Eigen::Index v = 0; v < fine.vertex_count(); ++v) {
      const auto first = mesh.fine.offsets[static_cast<std::size_t>(v)],
                 last = mesh.fine.offsets[static_cast<std::size_t>(v) + 1];
      EXPECT_GE(last - first, 1);
      if (answer == std::string("features_alone")) {
        EXPECT_EQ(last - first, 1);
      }
      for (auto k = first; k < last; ++k) {
        const auto place = static_cast<std::size_t>(mesh.fine.places[static_cast<std::size_t>(k)]);
        ASSERT_EQ(mesh.fine_read.offsets[place + 1] - mesh.fine_read.offsets[place], 1);
        EXPECT_EQ(mesh.fine_read.places[static_cast<std::size_t>(mesh.fine_read.offsets[place])], v);
      }
    }
  }
}

}  // namespace
}  // namespace pleat::superres
