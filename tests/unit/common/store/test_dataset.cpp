#include <cstdlib>
#include <fstream>

#include "common/store/hdf5.hpp"
#include "tests/unit/common/store/samples.hpp"

namespace pleat {
namespace {

using namespace testing_store;

class Dataset : public ::testing::Test {
 protected:
  void write_sequence(const std::string& name, std::uint64_t frames, bool deflate) {
    SequenceOptions options = sample_sequence(meshes, name, frames);
    options.deflate = deflate;
    SequenceWriter writer(folder.path(), options);
    for (std::uint64_t k = writer.frames_complete(); k < frames; ++k) writer.append(sample_frame(meshes, k));
    writer.finish();
  }
  std::filesystem::path sequence_file(const std::string& name) { return folder.path() / "sequences" / (name + ".h5"); }

  TemporaryFolder folder;
  MeshPair meshes = sample_meshes();
};

TEST_F(Dataset, ReadsWhatWasWritten) {
  DatasetMaster master = sample_master(meshes, {"b", "a", "planned"});
  master.normalization = ChannelRanges{std::vector<float>(9, 0), std::vector<float>(9, 1)};
  master.normalization->offset[8] = -3;
  master.normalization->scale[0] = 2;
  write_dataset_master(folder.path(), master);
  write_sequence("a", 5, false);
  write_sequence("b", 3, true);

  const DatasetReader reader(folder.path());
  EXPECT_EQ(reader.master().time_step_s, 0.005);
  EXPECT_EQ(reader.master().frame_time_s, 0.04);
  EXPECT_EQ(reader.master().seed, 7u);
  EXPECT_EQ(reader.master().git_revision, "abc");
  EXPECT_EQ(topology_hash(reader.topology().coarse), topology_hash(meshes.coarse));
  EXPECT_EQ(topology_hash(reader.topology().fine), topology_hash(meshes.fine));
  EXPECT_EQ(reader.topology().feature_vertices, meshes.feature_vertices);
  ASSERT_TRUE(reader.master().normalization.has_value());
  EXPECT_EQ(*reader.master().normalization, *master.normalization);

  const auto infos = reader.sequences();
  ASSERT_EQ(infos.size(), 2u);
  for (const SequenceInfo& info : infos) {
    const std::uint64_t frames = info.name == "a" ? 5 : 3;
    EXPECT_EQ(info.frames_complete, frames);
    EXPECT_EQ(info.frames, frames);
    EXPECT_TRUE(info.finished);
    EXPECT_EQ(info.split, "train");
    EXPECT_EQ(info.scene, R"({"name":"sample"})");
    ASSERT_EQ(info.obstacles.size(), 3u);
    EXPECT_EQ(info.obstacles[0].name, "zz-sphere");
    EXPECT_EQ(info.obstacles[1].faces.rows(), 2);
    const auto coarse = reader.coarse(info.name, 1, 3);
    const auto fine = reader.fine(info.name, 1, 3);
    const auto times = reader.times(info.name, 1, 3);
    const auto obstacles = reader.obstacles(info.name, 1, 3);
    for (std::uint64_t k = 1; k < 3; ++k) {
      const SequenceFrame expected = sample_frame(meshes, k);
      EXPECT_EQ(coarse[k - 1], expected.coarse);
      EXPECT_EQ(fine[k - 1], expected.fine);
      EXPECT_EQ(times[k - 1], expected.time_s);
      EXPECT_EQ(obstacles[k - 1][0].center, expected.obstacles[0].center);
      EXPECT_EQ(obstacles[k - 1][0].radius, expected.obstacles[0].radius);
      EXPECT_EQ(obstacles[k - 1][1].positions, expected.obstacles[1].positions);
      EXPECT_EQ(obstacles[k - 1][2].capsule_ends, expected.obstacles[2].capsule_ends);
      EXPECT_EQ(obstacles[k - 1][2].capsule_radii, expected.obstacles[2].capsule_radii);
    }
  }
}

TEST_F(Dataset, ASequenceMayHaveMeshesOfItsOwn) {
  write_dataset_master(folder.path(), sample_master(meshes, {"a", "b"}));
  write_sequence("a", 2, false);
  const MeshPair other = sample_meshes(3);
  const auto record = [&](const MeshPair& claimed, const std::string& hash) {
    SequenceOptions options = sample_sequence(other, "b", 2);
    options.meshes = std::make_shared<MeshPair>(claimed);
    options.topology_hash = hash;
    options.deflate = true;
    SequenceWriter writer(folder.path(), options);
    for (std::uint64_t k = writer.frames_complete(); k < 2; ++k) writer.append(sample_frame(other, k));
    writer.finish();
  };
  EXPECT_EQ(code_of([&] { record(meshes, topology_hash(meshes.fine)); }, "its own meshes"),
            ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { record(other, topology_hash(meshes.fine)); }, "its own meshes"), ErrorCode::kInvalidArgument);
  record(other, topology_hash(other.fine));

  std::shared_ptr<const MeshPair> kept;
  {
    const DatasetReader reader(folder.path());
    const auto infos = reader.sequences();
    ASSERT_EQ(infos.size(), 2u);
    EXPECT_FALSE(infos[0].own_meshes);
    EXPECT_TRUE(infos[1].own_meshes);
    EXPECT_EQ(reader.coarse("b", 1, 2)[0], sample_frame(other, 1).coarse);
    EXPECT_EQ(reader.fine("b", 1, 2)[0], sample_frame(other, 1).fine);
    EXPECT_EQ(reader.fine("a", 1, 2)[0], sample_frame(meshes, 1).fine);
    EXPECT_EQ(topology_hash(reader.meshes("b")->coarse), topology_hash(other.coarse));
    EXPECT_EQ(reader.meshes("b")->feature_vertices, other.feature_vertices);
    kept = reader.meshes("a");
  }
  EXPECT_EQ(topology_hash(kept->fine), topology_hash(meshes.fine)) << "outlives the reader";

  hdf5::File file = hdf5::File::open_own(folder.path() / "sequences/b.h5", true);
  file.set_attribute("/", "topology_hash", topology_hash(meshes.fine));
  file.close();
  EXPECT_EQ(code_of([&] { DatasetReader(folder.path()).meshes("b"); }, "topology_hash"), ErrorCode::kDataLoss);
}

TEST_F(Dataset, ContinuesAfterTheLastCompleteFrame) {
  write_dataset_master(folder.path(), sample_master(meshes, {"a"}));
  {
    SequenceWriter writer(folder.path(), sample_sequence(meshes, "a", 4));
    writer.append(sample_frame(meshes, 0));
    writer.append(sample_frame(meshes, 1));
    EXPECT_EQ(code_of([&] { writer.finish(); }, "2 of 4"), ErrorCode::kFailedPrecondition);
  }
  EXPECT_FALSE(DatasetReader(folder.path()).sequences()[0].finished);
  EXPECT_EQ(DatasetReader(folder.path()).fine("a", 0, 2)[1], sample_frame(meshes, 1).fine);
  SequenceWriter writer(folder.path(), sample_sequence(meshes, "a", 4));
  EXPECT_EQ(writer.frames_complete(), 2u);
  writer.append(sample_frame(meshes, 2));
  writer.append(sample_frame(meshes, 3));
  EXPECT_EQ(code_of([&] { writer.append(sample_frame(meshes, 4)); }, "planned 4"), ErrorCode::kInvalidArgument);
  writer.finish();
  const DatasetReader reader(folder.path());
  EXPECT_TRUE(reader.sequences()[0].finished);
  for (std::uint64_t k = 0; k < 4; ++k) EXPECT_EQ(reader.coarse("a", k, k + 1)[0], sample_frame(meshes, k).coarse);
}

TEST_F(Dataset, StartsAnewWhenThePlanChanged) {
  {
    SequenceWriter writer(folder.path(), sample_sequence(meshes, "a", 4));
    writer.append(sample_frame(meshes, 0));
  }
  SequenceOptions other = sample_sequence(meshes, "a", 4);
  other.scene = "{}";
  EXPECT_EQ(SequenceWriter(folder.path(), other).frames_complete(), 0u);
}

TEST_F(Dataset, RefusesASecondWriter) {
  const SequenceWriter first(folder.path(), sample_sequence(meshes, "a", 4));
  EXPECT_EQ(code_of([&] { SequenceWriter second(folder.path(), sample_sequence(meshes, "a", 4)); }, "a.h5.partial"),
            ErrorCode::kFailedPrecondition);
}

TEST_F(Dataset, RefusesFramesOfOtherSizes) {
  SequenceWriter writer(folder.path(), sample_sequence(meshes, "a", 4));
  SequenceFrame frame = sample_frame(meshes, 0);
  frame.fine.conservativeResize(3, 3);
  EXPECT_EQ(code_of([&] { writer.append(frame); }, "3 fine"), ErrorCode::kInvalidArgument);
  frame = sample_frame(meshes, 0);
  frame.obstacles.pop_back();
  EXPECT_EQ(code_of([&] { writer.append(frame); }, "obstacles"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(writer.frames_complete(), 0u);
}

TEST_F(Dataset, NamesTheFileThatIsWrong) {
  EXPECT_EQ(code_of([&] { DatasetReader reader(folder.path()); }, "dataset.h5"), ErrorCode::kNotFound);
  const auto path = folder.path() / "dataset.h5";
  std::ofstream(path) << "this is no HDF5 file";
  EXPECT_EQ(code_of([&] { DatasetReader reader(folder.path()); }, path.string()), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { write_dataset_master(folder.path(), sample_master(meshes, {"a"})); }, path.string()),
            ErrorCode::kAlreadyExists);
  std::filesystem::remove(path);

  write_dataset_master(folder.path(), sample_master(meshes, {"a", "gone"}));
  write_sequence("a", 3, false);
  const DatasetReader reader(folder.path());
  EXPECT_EQ(code_of([&] { reader.coarse("b", 0, 1); }, "b"), ErrorCode::kNotFound);
  EXPECT_EQ(code_of([&] { reader.coarse("gone", 0, 1); }, "gone.h5"), ErrorCode::kNotFound);
  EXPECT_EQ(code_of([&] { reader.coarse("a", 2, 4); }, "a.h5"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { write_dataset_master(folder.path(), sample_master(meshes, {"../a"})); }, "../a"),
            ErrorCode::kInvalidArgument);

  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  EXPECT_EQ(code_of([&] { DatasetReader again(folder.path()); }, path.string()), ErrorCode::kDataLoss);
  std::filesystem::resize_file(sequence_file("a"), 700);
  EXPECT_EQ(code_of([&] { reader.coarse("a", 0, 1); }, "a.h5"), ErrorCode::kDataLoss);
}

TEST_F(Dataset, ForeignFilesInItsWaySurvive) {
  const auto text_of = [](const std::filesystem::path& path) {
    std::ifstream file(path);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  const auto precious = folder.path() / "precious";
  std::ofstream(precious) << "mine";
  std::filesystem::create_directories(folder.path() / "sequences");
  std::filesystem::create_symlink(precious, folder.path() / "dataset.h5.partial");
  std::filesystem::create_symlink(precious, sequence_file("a").string() + ".partial.new");
  std::ofstream(sequence_file("a").string() + ".partial") << "mine too";
  write_dataset_master(folder.path(), sample_master(meshes, {"a", "b"}));
  write_sequence("a", 3, true);
  EXPECT_EQ(text_of(precious), "mine");
  EXPECT_EQ(text_of(sequence_file("a").string() + ".partial.aside-1"), "mine too");
  std::ofstream(sequence_file("b")) << "mine";
  EXPECT_EQ(code_of([&] { write_sequence("b", 3, false); }, "b.h5"), ErrorCode::kAlreadyExists);
  EXPECT_EQ(text_of(sequence_file("b")), "mine");
}

TEST_F(Dataset, RefusesOtherFormatsAndVersions) {
  write_dataset_master(folder.path(), sample_master(meshes, {}));
  const auto path = folder.path() / "dataset.h5";
  {
    const auto lock = hdf5::lock();
    hdf5::File::open(path, true).set_attribute("/", "version", std::uint64_t{99});
  }
  EXPECT_EQ(code_of([&] { DatasetReader reader(folder.path()); }, "99"), ErrorCode::kInvalidArgument);
  {
    const auto lock = hdf5::lock();
    hdf5::File::open(path, true).set_attribute("/", "format", std::string("pleat.result"));
  }
  EXPECT_EQ(code_of([&] { DatasetReader reader(folder.path()); }, path.string()), ErrorCode::kInvalidArgument);
}

TEST_F(Dataset, RefusesInconsistentContents) {
  MeshPair wrong = meshes;
  wrong.coarse.faces(0, 0) = 1000;
  write_dataset_master(folder.path(), sample_master(wrong, {}));
  EXPECT_EQ(code_of([&] { DatasetReader reader(folder.path()); }, "coarse"), ErrorCode::kDataLoss);

  // frames of another mesh
  write_dataset_master(folder.path(), sample_master(meshes, {"a"}));
  meshes = sample_meshes(3);
  write_sequence("a", 2, false);
  const DatasetReader reader(folder.path());
  EXPECT_EQ(code_of([&] { reader.fine("a", 0, 1); }, "vertices"), ErrorCode::kDataLoss);
}

TEST_F(Dataset, DoesNotFollowLinksOutOfAFile) {
  write_dataset_master(folder.path(), sample_master(meshes, {"a"}));
  write_sequence("a", 2, false);
  write_sequence("b", 2, false);
  {
    const auto lock = hdf5::lock();
    const hdf5::File file = hdf5::File::open(sequence_file("a"), true);
    H5Ldelete(file.id(), "/fine/positions", H5P_DEFAULT);
    H5Lcreate_external("b.h5", "/fine/positions", file.id(), "/fine/positions", H5P_DEFAULT, H5P_DEFAULT);
  }
  const DatasetReader reader(folder.path());
  EXPECT_EQ(code_of([&] { reader.fine("a", 0, 1); }, "link"), ErrorCode::kDataLoss);
}

TEST_F(Dataset, OpensInH5py) {
  if (std::system("/usr/bin/python3 -c 'import h5py' 2>/dev/null") != 0) GTEST_SKIP() << "no h5py";
  DatasetMaster master = sample_master(meshes, {"a"});
  master.normalization = ChannelRanges{std::vector<float>(9, 0), std::vector<float>(9, 1)};
  write_dataset_master(folder.path(), master);
  write_sequence("a", 4, true);
  const std::string script = R"(
import h5py, sys
d = h5py.File(sys.argv[1] + '/dataset.h5')
assert d.attrs['format'] == 'pleat.dataset' and d.attrs['version'] == 1 and d.attrs['seed'] == 7
assert d.attrs['time_step_s'] == 0.005 and d.attrs['frame_time_s'] == 0.04 and d.attrs['git_revision'] == 'abc'
assert 'm' in d.attrs['units']
for mesh, v in (('coarse', 9), ('fine', 81)):
    t = d['topology'][mesh]
    assert t['rest_positions'].shape == (v, 3) and t['faces'].shape[1] == 3
    assert t['uv'].shape[1] == 2 and t['uv_faces'].shape == t['faces'].shape
assert d['topology/feature_vertices'].shape == (9,)
assert d['normalization/minimum'].shape == (9,) and d['normalization/maximum'].shape == (9,)
s = d['sequences/a']
assert s['coarse/positions'].shape == (4, 9, 3) and s['fine/positions'].shape == (4, 81, 3)
assert s['fine/positions'].dtype == 'f4' and s['fine/positions'].chunks == (1, 81, 3)
assert s['fine/positions'].compression == 'gzip' and s['fine/positions'].shuffle
assert list(s['time_s']) == [0.04 * k for k in range(4)]
assert s['obstacles/zz-sphere/center'].shape == (4, 3) and s['obstacles/zz-sphere/radius'].shape == (4,)
assert s['obstacles/box/faces'].shape == (2, 3) and s['obstacles/box/positions'].shape == (4, 4, 3)
assert s.attrs['split'] == 'train' and s.attrs['scene'] == '{"name":"sample"}' and s.attrs['frames_complete'] == 4
)";
  std::ofstream(folder.path() / "read.py") << script;
  const std::string command = "/usr/bin/python3 " + (folder.path() / "read.py").string() + " " + folder.path().string();
  EXPECT_EQ(std::system(command.c_str()), 0);
}

}  // namespace
}  // namespace pleat
