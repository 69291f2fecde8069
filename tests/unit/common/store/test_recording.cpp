// The experiment: a recording process is killed, or its disk fills up, at many moments; every frame that it had
// reported as complete must be readable, and a new process must continue after it.
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/unit/common/store/samples.hpp"

namespace pleat {
namespace {

using namespace testing_store;

constexpr std::uint64_t kFrames = 2000;

/// Records until killed; writes one byte to `reports` after each frame.
[[noreturn]] void record(const std::filesystem::path& folder, const MeshPair& meshes, int reports) {
  try {
    SequenceWriter writer(folder, sample_sequence(meshes, "a", kFrames));
    for (std::uint64_t k = writer.frames_complete(); k < kFrames; ++k) {
      writer.append(sample_frame(meshes, k));
      if (write(reports, "x", 1) != 1) _exit(2);
    }
  } catch (const std::exception&) {
    _exit(3);
  }
  _exit(0);
}

TEST(Crash, KillLosesNoCompleteFrame) {
  const TemporaryFolder folder;
  const MeshPair meshes = sample_meshes();
  write_dataset_master(folder.path(), sample_master(meshes, {"a"}));
  std::uint64_t reported = 0;
  for (int round = 0; round < 12; ++round) {
    int reports[2];
    ASSERT_EQ(pipe(reports), 0);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) record(folder.path(), meshes, reports[1]);
    close(reports[1]);
    char byte = 0;
    // a different number of frames every round, then a moment inside the next one
    for (int k = 0; k < 3 + 5 * round; ++k) {
      ASSERT_EQ(read(reports[0], &byte, 1), 1);
      ++reported;
    }
    usleep(static_cast<useconds_t>(37 * round));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    EXPECT_TRUE(WIFSIGNALED(status));
    while (read(reports[0], &byte, 1) == 1) ++reported;
    close(reports[0]);

    const DatasetReader reader(folder.path());
    const SequenceInfo info = reader.sequences().at(0);
    EXPECT_FALSE(info.finished);
    ASSERT_GE(info.frames_complete, reported);
    ASSERT_LE(info.frames_complete, reported + 1);  // a frame may be complete and not reported yet
    reported = info.frames_complete;
    const auto fine = reader.fine("a", 0, info.frames_complete);
    for (std::uint64_t k = 0; k < info.frames_complete; ++k) ASSERT_EQ(fine[k], sample_frame(meshes, k).fine) << k;
  }
}

TEST(Crash, AFullDiskKeepsTheCompleteFrames) {
  const TemporaryFolder folder;
  const MeshPair meshes = sample_meshes(8);
  write_dataset_master(folder.path(), sample_master(meshes, {"a"}));
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    int status = 9;
    try {
      SequenceWriter writer(folder.path(), sample_sequence(meshes, "a", 100));
      writer.append(sample_frame(meshes, 0));
      writer.append(sample_frame(meshes, 1));
      signal(SIGXFSZ, SIG_IGN);
      const auto size = std::filesystem::file_size(folder.path() / "sequences" / "a.h5.partial");
      const rlimit limit{size / 2, size / 2};
      if (setrlimit(RLIMIT_FSIZE, &limit) != 0) _exit(8);
      for (std::uint64_t k = 2; k < 100; ++k) writer.append(sample_frame(meshes, k));
      status = 7;
    } catch (const Error& error) {
      const bool named = std::string(error.what()).find("a.h5.partial") != std::string::npos;
      status = error.code() == ErrorCode::kResourceExhausted && named ? 0 : 1;
    }
    _exit(status);
  }
  int status = -1;
  waitpid(child, &status, 0);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);

  const DatasetReader reader(folder.path());
  const std::uint64_t complete = reader.sequences().at(0).frames_complete;
  EXPECT_GT(complete, 2u);
  EXPECT_LT(complete, 100u);
  for (std::uint64_t k = 0; k < complete; ++k) {
    EXPECT_EQ(reader.coarse("a", k, k + 1)[0], sample_frame(meshes, k).coarse);
    EXPECT_EQ(reader.fine("a", k, k + 1)[0], sample_frame(meshes, k).fine);
  }
  // With room again, the work goes on.
  SequenceWriter writer(folder.path(), sample_sequence(meshes, "a", 100));
  EXPECT_EQ(writer.frames_complete(), complete);
  for (std::uint64_t k = complete; k < 100; ++k) writer.append(sample_frame(meshes, k));
  writer.finish();
  EXPECT_EQ(reader.fine("a", 99, 100)[0], sample_frame(meshes, 99).fine);
}

TEST(Crash, AFullDiskAtTheStartIsNamed) {
  const TemporaryFolder folder;
  const MeshPair meshes = sample_meshes();
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{1000, 1000};
    if (setrlimit(RLIMIT_FSIZE, &limit) != 0) _exit(8);
    int status = 7;
    try {
      write_dataset_master(folder.path(), sample_master(meshes, {"a"}));
    } catch (const Error& error) {
      const bool named = std::string(error.what()).find("dataset.h5.partial") != std::string::npos;
      status = error.code() == ErrorCode::kResourceExhausted && named ? 0 : 1;
    }
    _exit(status);
  }
  int status = -1;
  waitpid(child, &status, 0);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

}  // namespace
}  // namespace pleat
