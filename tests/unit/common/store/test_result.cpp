#include <cstdlib>
#include <fstream>

#include "tests/unit/common/store/samples.hpp"

namespace pleat {
namespace {

using namespace testing_store;

class Result : public ::testing::Test {
 protected:
  ResultOptions options(std::uint64_t frames, bool has_fine) {
    ResultOptions result;
    result.topology = meshes;
    result.frames = frames;
    result.frame_time_s = 0.04;
    result.model = "draping";
    result.scene = "{}";
    result.has_fine = has_fine;
    result.obstacles = sample_obstacle_shapes();
    result.obstacle_vertices = {0, 4, 0};
    result.stages = {"simulation", "superres"};
    result.counts = {"penetrations"};
    return result;
  }
  ResultFrame frame(std::uint64_t k) {
    ResultFrame result;
    result.time_s = 0.04 * static_cast<double>(k);
    result.coarse = moved(meshes.coarse.rest_positions, k);
    result.enhanced = moved(meshes.fine.rest_positions, k + 1);
    result.fine = moved(meshes.fine.rest_positions, k);
    result.obstacles = sample_obstacles(k);
    result.stages_ms = {1.5f, static_cast<float>(k)};
    result.counts = {static_cast<std::uint32_t>(k)};
    return result;
  }

  TemporaryFolder folder;
  MeshPair meshes = sample_meshes();
  std::filesystem::path path = folder.path() / "out" / "result.h5";
};

TEST_F(Result, ReadsWhatWasWritten) {
  for (const bool deflate : {false, true}) {
    ResultOptions made = options(4, true);
    made.deflate = deflate;
    ResultWriter writer(path, made);
    for (std::uint64_t k = 0; k < 4; ++k) writer.append(frame(k));
    writer.finish();
    EXPECT_FALSE(std::filesystem::exists(path.string() + ".partial"));
    const ResultReader reader(path);
    EXPECT_EQ(reader.frames_complete(), 4u);
    EXPECT_EQ(reader.info().model, "draping");
    EXPECT_EQ(reader.info().scene, "{}");
    EXPECT_EQ(reader.info().frame_time_s, 0.04);
    EXPECT_EQ(reader.info().obstacles[0].name, "zz-sphere");
    EXPECT_EQ(topology_hash(reader.info().topology.fine), topology_hash(meshes.fine));
    EXPECT_EQ(reader.coarse(3, 4)[0], frame(3).coarse);
    EXPECT_EQ(reader.enhanced(1, 3)[1], frame(2).enhanced);
    EXPECT_EQ(reader.fine(0, 4)[0], frame(0).fine);
    EXPECT_EQ(reader.times(1, 2), std::vector<double>{0.04});
    EXPECT_EQ(reader.stage_ms("superres", 0, 4), (std::vector<float>{0, 1, 2, 3}));
    EXPECT_EQ(reader.counts("penetrations", 2, 4), (std::vector<std::uint32_t>{2, 3}));
    EXPECT_EQ(reader.obstacles(2, 3)[0][1].positions, frame(2).obstacles[1].positions);
    EXPECT_EQ(reader.info().obstacles[2].capsules, 2u);
    EXPECT_EQ(reader.obstacles(1, 3)[1][2].capsule_ends, frame(2).obstacles[2].capsule_ends);
    EXPECT_EQ(reader.obstacles(1, 3)[1][2].capsule_radii, frame(2).obstacles[2].capsule_radii);
    EXPECT_EQ(code_of([&] { reader.enhanced(0, 5); }, path.string()), ErrorCode::kInvalidArgument);
    EXPECT_EQ(code_of([&] { reader.stage_ms("nothing", 0, 1); }, "nothing"), ErrorCode::kDataLoss);
  }
}

TEST_F(Result, ACancelledJobKeepsItsFramesOnly) {
  ResultWriter writer(path, options(10, false));
  for (std::uint64_t k = 0; k < 3; ++k) writer.append(frame(k));
  writer.finish();
  const ResultReader reader(path);
  EXPECT_EQ(reader.frames_complete(), 3u);
  EXPECT_EQ(reader.enhanced(0, 3)[2], frame(2).enhanced);
  EXPECT_EQ(code_of([&] { reader.fine(0, 1); }, "fine"), ErrorCode::kFailedPrecondition);
  if (std::system("/usr/bin/python3 -c 'import h5py' 2>/dev/null") != 0) GTEST_SKIP() << "no h5py";
  std::ofstream(folder.path() / "read.py") << R"(
import h5py, sys
r = h5py.File(sys.argv[1])
assert r.attrs['format'] == 'pleat.result' and r.attrs['version'] == 1 and r.attrs['frames_complete'] == 3
assert r.attrs['model'] == 'draping' and r.attrs['scene'] == '{}'
assert r['coarse/positions'].shape == (3, 9, 3) and r['enhanced/positions'].shape == (3, 81, 3)
assert 'fine' not in r and r['topology/fine/faces'].shape[1] == 3
assert list(r['stages/superres/ms']) == [0, 1, 2] and list(r['counts/penetrations']) == [0, 1, 2]
assert r['obstacles/limbs/capsule_ends'].shape == (3, 2, 2, 3) and r['obstacles/limbs/capsule_radii'].shape == (3, 2)
assert r['obstacles/zz-sphere/radius'].shape == (3,) and r['time_s'].shape == (3,)
)";
  const std::string command = "/usr/bin/python3 " + (folder.path() / "read.py").string() + " " + path.string();
  EXPECT_EQ(std::system(command.c_str()), 0);
}

TEST_F(Result, IsReadableWhileItIsWritten) {
  ResultWriter writer(path, options(10, false));
  writer.append(frame(0));
  writer.append(frame(1));
  const std::filesystem::path partial = path.string() + ".partial";
  EXPECT_EQ(ResultReader(partial).frames_complete(), 2u);
  EXPECT_EQ(ResultReader(partial).enhanced(0, 2)[1], frame(1).enhanced);
  writer.append(frame(2));
  EXPECT_EQ(ResultReader(partial).frames_complete(), 3u);
}

TEST_F(Result, ContinuesOnlyWhenAsked) {
  {
    ResultWriter writer(path, options(5, false));
    writer.append(frame(0));
  }
  EXPECT_EQ(ResultWriter(path, options(5, false), true).frames_complete(), 1u);
  EXPECT_EQ(ResultWriter(path, options(5, false), false).frames_complete(), 0u);
}

TEST_F(Result, EqualRunsGiveEqualFiles) {
  const auto write = [&](const std::filesystem::path& target) {
    ResultWriter writer(target, options(3, true));
    for (std::uint64_t k = 0; k < 3; ++k) writer.append(frame(k));
    writer.finish();
    std::ifstream stream(target, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(stream), {});
  };
  EXPECT_EQ(write(folder.path() / "a.h5"), write(folder.path() / "b.h5"));
}

TEST_F(Result, RefusesWhatCannotBeStored) {
  EXPECT_EQ(code_of([&] { ResultWriter writer(path, options(0, false)); }, "0 frames"), ErrorCode::kInvalidArgument);
  ResultOptions wrong = options(3, false);
  wrong.obstacles[0].name = "a/b";
  EXPECT_EQ(code_of([&] { ResultWriter writer(path, wrong); }, "a/b"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of([&] { ResultWriter writer("/proc/nowhere/result.h5", options(3, false)); }, "/proc/nowhere"),
            ErrorCode::kInvalidArgument);
  ResultWriter writer(path, options(3, false));
  ResultFrame bad = frame(0);
  bad.stages_ms.pop_back();
  EXPECT_EQ(code_of([&] { writer.append(bad); }, "stage times"), ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace pleat
