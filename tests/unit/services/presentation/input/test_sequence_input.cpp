// Frames from files: what is accepted, and how hostile files are refused.
#include "services/presentation/input/sequence_input.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>

#include "common/base/error.hpp"
#include "common/mesh/obj.hpp"
#include "common/store/dataset.hpp"
#include "common/store/result.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

Topology two_triangles() {
  Topology t;
  t.rest_positions.resize(4, 3);
  t.rest_positions << 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0, 1;
  t.faces.resize(2, 3);
  t.faces << 0, 2, 1, 1, 2, 3;
  t.uv.resize(4, 2);
  t.uv << 0, 0, 1, 0, 0, 1, 1, 1;
  t.uv_faces = t.faces;
  return t;
}

class SequenceInput : public testing::Test {
 protected:
  Positions frame(int k) const {
    Positions p = rest_.rest_positions;
    p.col(1).array() += static_cast<float>(k);
    return p;
  }
  void write_obj_frame(const std::string& name, int k) const { write_obj(folder_ / name, rest_, frame(k)); }

  fs::path write_pc2(const std::string& name, std::int32_t version, std::int32_t points, std::int32_t samples,
                     const std::vector<float>& values, const char* magic = "POINTCACHE2\0") const {
    std::ofstream file(folder_ / name, std::ios::binary);
    file.write(magic, 12);
    const float start = 0, rate = 1;
    file.write(reinterpret_cast<const char*>(&version), 4);
    file.write(reinterpret_cast<const char*>(&points), 4);
    file.write(reinterpret_cast<const char*>(&start), 4);
    file.write(reinterpret_cast<const char*>(&rate), 4);
    file.write(reinterpret_cast<const char*>(&samples), 4);
    file.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size() * 4));
    return folder_ / name;
  }

  void expect_error(const std::string& source, ErrorCode code, const std::string& part) const {
    try {
      const auto sequence = open_frame_sequence(source, rest_);
      for (std::size_t k = 0; k < sequence->frame_count(); ++k) sequence->positions(k);
      ADD_FAILURE() << source << " was accepted";
    } catch (const Error& error) {
      EXPECT_EQ(to_string(error.code()), to_string(code)) << error.what();
      EXPECT_THAT(error.what(), testing::HasSubstr(part));
      EXPECT_THAT(error.what(), testing::Not(testing::HasSubstr("\n")));
    }
  }

  const pleat::test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
  Topology rest_ = two_triangles();
};

TEST_F(SequenceInput, FilesThatAShellListedAreInTheOrderOfTheirNumbers) {
  std::vector<std::string> files;
  for (const int k : {10, 11, 8, 9}) {
    write_obj_frame("cloth" + std::to_string(k) + ".obj", k);
    files.push_back((folder_ / ("cloth" + std::to_string(k) + ".obj")).string());
  }
  const auto sequence = open_frame_sequence(files, rest_);
  ASSERT_EQ(sequence->frame_count(), 4u);
  for (int k = 0; k < 4; ++k) EXPECT_EQ(sequence->positions(static_cast<std::size_t>(k)), frame(8 + k));
  const auto refused = [&](const std::string& more, const char* cause) {
    std::vector<std::string> all = files;
    all.push_back((folder_ / more).string());
    const Error error = test::error_of([&] { open_frame_sequence(all, rest_); });
    EXPECT_THAT(error.what(), testing::AllOf(testing::HasSubstr(more), testing::HasSubstr(cause)));
  };
  refused("none.obj", "no such file");
  std::ofstream(folder_ / "cache.pc2") << "x";
  refused("cache.pc2", "named alone");
  files.erase(files.begin());
  EXPECT_THAT(test::error_of([&] { open_frame_sequence(files, rest_); }).what(),
              testing::HasSubstr("frame 10 is missing"));
}

TEST_F(SequenceInput, FramesBringTheirGarment) {
  std::vector<std::string> notes;
  write_obj_frame("cloth1.obj", 1);
  write_obj_frame("cloth2.obj", 2);
  const RestMesh first =
      rest_of_frames({(folder_ / "cloth2.obj").string(), (folder_ / "cloth1.obj").string()}, 1, notes);
  EXPECT_EQ(first.mesh.rest_positions, frame(1));
  EXPECT_EQ(first.name, (folder_ / "cloth1.obj").string());
  EXPECT_EQ(rest_of_frames({folder_.string()}, 1, notes).mesh.faces, rest_.faces);
  EXPECT_EQ(rest_of_frames({(folder_ / "cloth2.obj").string()}, 0.01, notes).mesh.rest_positions, 0.01F * frame(2));
  const fs::path cache = write_pc2("cache.pc2", 1, 4, 1, std::vector<float>(12, 0));
  EXPECT_THAT(test::error_of([&] { rest_of_frames({cache.string()}, 1, notes); }).what(), testing::HasSubstr("--rest"));
  EXPECT_THAT(test::error_of([&] { rest_of_frames({(folder_ / "none.pc2").string()}, 1, notes); }).what(),
              testing::HasSubstr("none.pc2: no such file"));
  write_obj(folder_ / "cache.obj", rest_);
  EXPECT_EQ(rest_of_frames({cache.string()}, 1, notes).name, (folder_ / "cache.obj").string());
  Topology plain = rest_;
  plain.uv.resize(0, 2);
  plain.uv_faces.resize(0, 3);
  write_obj(folder_ / "plain.obj", plain);
  EXPECT_THAT(test::error_of([&] { rest_of_frames({(folder_ / "plain.obj").string()}, 1, notes); }).what(),
              testing::HasSubstr("no material coordinates; name the garment by --rest"));
}

TEST_F(SequenceInput, ReadsAFolderInTheOrderOfItsNumbers) {
  for (const int k : {9, 11, 8, 10}) write_obj_frame("v2_cloth" + std::to_string(k) + ".obj", k);
  const auto sequence = open_frame_sequence(folder_.string(), rest_);
  ASSERT_EQ(sequence->frame_count(), 4u);
  for (int k = 0; k < 4; ++k) EXPECT_EQ(sequence->positions(static_cast<std::size_t>(k)), frame(8 + k));
}

TEST_F(SequenceInput, ThreeSpellingsFollowOneRule) {
  const fs::path cases = "tests/cases/15-sequence-gap-and-negative-frames";
  rest_ = read_obj(cases / "garment.obj");
  for (const char* spelling : {"", "*.obj", "cloth_%04d.obj"}) {
    expect_error((cases / "gap" / spelling).string(), ErrorCode::kNotFound, "frame 4 is missing");
    const auto sequence = open_frame_sequence((cases / "preroll" / spelling).string(), rest_);
    ASSERT_EQ(sequence->frame_count(), 5u) << spelling;
    const float first = sequence->positions(0)(0, 0);
    for (int k = 0; k < 5; ++k) {
      EXPECT_NEAR(sequence->positions(static_cast<std::size_t>(k))(0, 0) - first, 0.1f * static_cast<float>(k), 1e-5f);
    }
  }
}

TEST_F(SequenceInput, RefusesNamesThatGiveNoOrder) {
  write_obj_frame("cloth1.obj", 1);
  write_obj_frame("cloth02.obj", 2);
  EXPECT_EQ(open_frame_sequence(folder_.string(), rest_)->frame_count(), 2u);
  write_obj_frame("cloth2.obj", 2);
  expect_error(folder_.string(), ErrorCode::kInvalidArgument, "are both frame 2");
  fs::remove(folder_ / "cloth2.obj");
  write_obj_frame("rest.obj", 0);
  expect_error(folder_.string(), ErrorCode::kInvalidArgument, "differ in more than a number");
  EXPECT_EQ(open_frame_sequence((folder_ / "cloth%d.obj").string(), rest_)->frame_count(), 2u);
}

TEST_F(SequenceInput, ReadsTheCachesOfOtherTools) {
  const fs::path cases = "tests/cases/34-mdd-and-big-endian-caches";
  rest_ = read_obj(cases / "garment.obj");
  const auto array = open_frame_sequence((cases / "cloth-positions.h5").string(), rest_);
  for (const char* file : {"frames.mdd", "big-endian.pc2", "cloth-positions.h5", "cloth-positions.h5:/positions"}) {
    const auto sequence = open_frame_sequence((cases / file).string(), rest_);
    ASSERT_EQ(sequence->frame_count(), 4u) << file;
    for (std::size_t k = 0; k < 4; ++k) {
      EXPECT_LT((sequence->positions(k) - array->positions(k)).cwiseAbs().maxCoeff(), 1e-5f) << file;
    }
    EXPECT_EQ(sequence->warning(), "") << file;
  }
  EXPECT_NEAR(open_frame_sequence((cases / "frames.mdd").string(), rest_)->frame_time_s(), 1.0 / 24, 1e-6);
  const auto more = open_frame_sequence((cases / "header-says-fewer.pc2").string(), rest_);
  EXPECT_EQ(more->frame_count(), 3u);
  EXPECT_THAT(more->warning(), testing::HasSubstr("3 frames, but 1452 bytes follow them"));
  expect_error((cases / "cut-short.pc2").string(), ErrorCode::kDataLoss, "5740 bytes instead of 5840");
  expect_error((cases / "positions-points-first.h5").string(), ErrorCode::kInvalidArgument, "4 vertices");
  expect_error((cases / "cloth-positions.h5:/other").string(), ErrorCode::kInvalidArgument, "no such array");
}

TEST_F(SequenceInput, ReadsNumPyArrays) {
  const auto write = [&](const std::string& dictionary, const std::string& data) {
    std::string header = dictionary;
    header.resize(118, ' ');
    std::ofstream file(folder_ / "a.npy", std::ios::binary);
    file.write("\x93NUMPY\1\0\x76\0", 10);
    file << header << data;
    file.close();
    return (folder_ / "a.npy").string();
  };
  std::string floats, doubles;
  for (const int k : {0, 1}) {
    const Positions p = frame(k);
    for (Eigen::Index i = 0; i < p.size(); ++i) {
      const double wide = static_cast<double>(p.data()[i]);
      floats.append(reinterpret_cast<const char*>(p.data() + i), 4);
      std::string bytes(reinterpret_cast<const char*>(&wide), 8);
      doubles.append(bytes.rbegin(), bytes.rend());
    }
  }
  for (const auto& [type, data] : {std::pair{"<f4", floats}, std::pair{">f8", doubles}}) {
    const auto sequence = open_frame_sequence(
        write(std::string("{'descr': '") + type + "', 'fortran_order': False, 'shape': (2, 4, 3), }", data), rest_);
    ASSERT_EQ(sequence->frame_count(), 2u);
    EXPECT_EQ(sequence->positions(1), frame(1)) << type;
  }
  const auto expect_refused = [&](const std::string& dictionary, ErrorCode code, const std::string& cause) {
    expect_error(write(dictionary, floats), code, cause);
  };
  expect_refused("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4, 3), }", ErrorCode::kDataLoss, "truncated");
  expect_refused("{'descr': '<i4', 'fortran_order': False, 'shape': (2, 4, 3), }", ErrorCode::kInvalidArgument,
                 "float32");
  expect_refused("{'descr': '<f4', 'fortran_order': True, 'shape': (2, 4, 3), }", ErrorCode::kInvalidArgument,
                 "C order");
  expect_refused("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3, 4), }", ErrorCode::kInvalidArgument,
                 "(2, 3, 4)");
}

TEST_F(SequenceInput, ReadsAGlob) {
  for (const int k : {0, 1}) write_obj_frame("cloth" + std::to_string(k) + ".obj", k);
  write_obj_frame("other.obj", 5);
  const auto sequence = open_frame_sequence((folder_ / "cloth*.obj").string(), rest_);
  ASSERT_EQ(sequence->frame_count(), 2u);
  EXPECT_EQ(sequence->positions(1), frame(1));
}

TEST_F(SequenceInput, ReadsAPrintfPatternFromItsFirstNumber) {
  for (const int k : {7, 8, 9}) write_obj_frame("c_000" + std::to_string(k) + "_x.obj", k);
  const auto sequence = open_frame_sequence((folder_ / "c_%04d_x.obj").string(), rest_);
  ASSERT_EQ(sequence->frame_count(), 3u);
  EXPECT_EQ(sequence->positions(0), frame(7));
}

TEST_F(SequenceInput, NamesAGapInAPattern) {
  write_obj_frame("c1.obj", 1);
  write_obj_frame("c3.obj", 3);
  expect_error((folder_ / "c%d.obj").string(), ErrorCode::kNotFound, "frame 2 is missing");
}

TEST_F(SequenceInput, RefusesOtherPatterns) {
  expect_error((folder_ / "c%s.obj").string(), ErrorCode::kInvalidArgument, "%d");
  expect_error((folder_ / "c%d_%d.obj").string(), ErrorCode::kInvalidArgument, "%d");
  expect_error((folder_ / "c%d.obj").string(), ErrorCode::kNotFound, "no file matches");
  expect_error((folder_ / "c*.obj").string(), ErrorCode::kNotFound, "no file matches");
  expect_error((folder_ / "missing.pc2").string(), ErrorCode::kNotFound, "missing.pc2");
  expect_error(folder_.string(), ErrorCode::kNotFound, "no .obj");
}

TEST_F(SequenceInput, RefusesAnObjOfAnotherTopology) {
  std::ofstream(folder_ / "a.obj") << "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n";
  expect_error((folder_ / "a.obj").string(), ErrorCode::kInvalidArgument, "3 vertices, the rest mesh 4");
  std::ofstream(folder_ / "b.obj") << "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nf 1 3 2\nf 4 3 2\n";
  expect_error((folder_ / "b.obj").string(), ErrorCode::kInvalidArgument, "faces are not those");
}

TEST_F(SequenceInput, RefusesAnObjWithNan) {
  write_obj_frame("c0.obj", 0);
  std::ofstream(folder_ / "c1.obj") << "v nan 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nf 1 3 2\nf 2 3 4\n";
  expect_error(folder_.string(), ErrorCode::kInvalidArgument, "c1.obj:1");
}

TEST_F(SequenceInput, ReadsAPointCache) {
  std::vector<float> values;
  for (const int k : {0, 1}) {
    const Positions p = frame(k);
    values.insert(values.end(), p.data(), p.data() + p.size());
  }
  const auto sequence = open_frame_sequence(write_pc2("a.pc2", 1, 4, 2, values).string(), rest_);
  ASSERT_EQ(sequence->frame_count(), 2u);
  EXPECT_EQ(sequence->positions(0), frame(0));
  EXPECT_EQ(sequence->positions(1), frame(1));
  EXPECT_THROW(sequence->positions(2), Error);
}

TEST_F(SequenceInput, RefusesHostilePointCaches) {
  const std::vector<float> one(12, 0.0f);
  const auto pc2 = [&](auto... arguments) { return write_pc2("x.pc2", arguments...).string(); };
  expect_error(pc2(1, 4, 1, one, "POINTCACHE1\0"), ErrorCode::kInvalidArgument, "not a PC2");
  expect_error(pc2(2, 4, 1, one), ErrorCode::kInvalidArgument, "version 2");
  expect_error(pc2(1, -4, 1, one), ErrorCode::kInvalidArgument, "-4 points");
  expect_error(pc2(1, 4, 0, one), ErrorCode::kInvalidArgument, "0 samples");
  expect_error(pc2(1, 4, 2, one), ErrorCode::kDataLoss, "truncated");
  expect_error(pc2(1, 4'000'000, std::numeric_limits<std::int32_t>::max(), one), ErrorCode::kDataLoss, "truncated");
  expect_error(pc2(1, std::numeric_limits<std::int32_t>::max(), 1, one), ErrorCode::kInvalidArgument, "points");
  expect_error(pc2(1, 3, 1, one), ErrorCode::kInvalidArgument, "3 vertices, the rest mesh 4");
  std::vector<float> bad = one;
  bad[7] = std::numeric_limits<float>::quiet_NaN();
  expect_error(pc2(1, 4, 1, bad), ErrorCode::kInvalidArgument, "vertex 2 is not finite");
  std::ofstream(folder_ / "x.pc2") << "POINT";
  expect_error((folder_ / "x.pc2").string(), ErrorCode::kDataLoss, "truncated");
}

TEST_F(SequenceInput, RefusesUnknownAndForeignFiles) {
  std::ofstream(folder_ / "frames.abc") << "abc";
  expect_error((folder_ / "frames.abc").string(), ErrorCode::kInvalidArgument, "frames.abc");
  std::ofstream(folder_ / "frames.h5") << "not HDF5";
  try {
    open_frame_sequence((folder_ / "frames.h5").string(), rest_);
    ADD_FAILURE() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("frames.h5"));
  }
}

TEST_F(SequenceInput, ReadsTheCoarseFramesAndObstaclesOfAResult) {
  ResultOptions options;
  options.topology = {rest_, rest_, {0, 1, 2, 3}};
  options.frames = 2;
  options.frame_time_s = 0.02;
  options.model = "none";
  options.obstacles = {{"ball", {}}};
  options.obstacle_vertices = {0};
  ResultWriter writer(folder_ / "result.h5", options);
  for (const int k : {0, 1}) {
    ResultFrame out;
    out.time_s = 0.02 * k;
    out.coarse = frame(k);
    out.enhanced = frame(k);
    out.obstacles.resize(1);
    out.obstacles[0].name = "ball";
    out.obstacles[0].radius = 0.5f;
    out.obstacles[0].center = {static_cast<float>(k), 0, 0};
    writer.append(out);
  }
  writer.finish();
  const auto sequence = open_frame_sequence((folder_ / "result.h5").string(), rest_);
  ASSERT_EQ(sequence->frame_count(), 2u);
  EXPECT_EQ(sequence->positions(1), frame(1));
  EXPECT_DOUBLE_EQ(sequence->frame_time_s(), 0.02);
  ASSERT_EQ(sequence->obstacle_shapes().size(), 1u);
  EXPECT_FLOAT_EQ(sequence->obstacles(1).at(0).center.x(), 1);
}

TEST_F(SequenceInput, ReadsASequenceOfADataSet) {
  DatasetMaster master;
  master.time_step_s = 0.005;
  master.frame_time_s = 0.04;
  master.topology = {rest_, rest_, {0, 1, 2, 3}};
  master.sequences = {"fall"};
  write_dataset_master(folder_, master);
  SequenceOptions options;
  options.name = "fall";
  options.split = "test";
  options.frames = 1;
  options.coarse_vertices = options.fine_vertices = 4;
  options.topology_hash = topology_hash(rest_);
  SequenceWriter writer(folder_, options);
  writer.append({0.0, frame(3), frame(3), {}});
  writer.finish();
  const auto sequence = open_frame_sequence((folder_ / "sequences" / "fall.h5").string(), rest_);
  ASSERT_EQ(sequence->frame_count(), 1u);
  EXPECT_EQ(sequence->positions(0), frame(3));
  EXPECT_DOUBLE_EQ(sequence->frame_time_s(), 0.04);
  expect_error(folder_.string(), ErrorCode::kInvalidArgument, "name one of its sequences");
}

}  // namespace
}  // namespace pleat::presentation
