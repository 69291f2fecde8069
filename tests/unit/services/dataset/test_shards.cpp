#include "services/dataset/shards.hpp"

#include <gmock/gmock.h>

#include <fstream>
#include <iterator>
#include <map>

#include "common/base/lease.hpp"
#include "services/dataset/sequence.hpp"
#include "services/dataset/shard_folder.hpp"
#include "tests/unit/services/dataset/small_set.hpp"

namespace pleat::dataset {
namespace {

using namespace std::chrono_literals;

std::string bytes_of(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// choose_shard() with these variables.
std::optional<Shard> choose(const std::string& flag, const std::map<std::string, std::string>& variables) {
  return choose_shard(flag, [&](const char* name) {
    const auto found = variables.find(name);
    return found == variables.end() ? nullptr : found->second.c_str();
  });
}

std::string chosen(const std::string& flag, const std::map<std::string, std::string>& variables) {
  const auto shard = choose(flag, variables);
  if (!shard) return "none";
  return std::to_string(shard->index) + "/" + std::to_string(shard->count) + " " + shard->source;
}

TEST(ShardChoice, TheFlagWinsThenSlurmThenKubernetes) {
  const std::map<std::string, std::string> kubernetes = {{"JOB_COMPLETION_INDEX", "0"}, {"JOB_COMPLETIONS", "3"}};
  std::map<std::string, std::string> both = kubernetes;
  both.insert({{"SLURM_ARRAY_TASK_ID", "7"}, {"SLURM_ARRAY_TASK_COUNT", "4"}, {"SLURM_ARRAY_TASK_MIN", "5"}});
  EXPECT_EQ(chosen("", {}), "none");
  EXPECT_EQ(chosen("2/5", {}), "2/5 --shard");
  EXPECT_EQ(chosen("", kubernetes), "1/3 JOB_COMPLETION_INDEX");
  EXPECT_EQ(chosen("", both), "3/4 SLURM_ARRAY_TASK_ID");
  EXPECT_EQ(chosen("1/1", both), "1/1 --shard");
  EXPECT_EQ(chosen("none", both), "none");
}

TEST(ShardChoice, ArraysWithStepsAndHolesHavePlacesForAll) {
  std::map<std::string, std::string> slurm = {{"SLURM_ARRAY_TASK_COUNT", "3"}, {"SLURM_ARRAY_TASK_MIN", "0"}};
  slurm["SLURM_ARRAY_TASK_STEP"] = "10";
  slurm["SLURM_ARRAY_TASK_ID"] = "20";
  EXPECT_EQ(chosen("", slurm), "3/3 SLURM_ARRAY_TASK_ID");
  slurm["SLURM_ARRAY_TASK_STEP"] = "1";
  EXPECT_EQ(chosen("", slurm), "3/3 SLURM_ARRAY_TASK_ID");
}

TEST(ShardChoice, WhatIsNoShardIsRefused) {
  for (const char* flag : {"3", "0/4", "5/4", "1/0", "-1/4", "a/b", "1/", "/2", "1/2/3", "1.5/2"}) {
    EXPECT_THROW(choose(flag, {}), Error) << flag;
  }
  EXPECT_THROW(choose("", {{"SLURM_ARRAY_TASK_ID", "1"}}), Error) << "of how many";
  EXPECT_THROW(choose("", {{"JOB_COMPLETION_INDEX", "1"}}), Error) << "of how many";
  EXPECT_THROW(choose("", {{"JOB_COMPLETION_INDEX", "4"}, {"JOB_COMPLETIONS", "4"}}), Error);
  EXPECT_THROW(choose("", {{"JOB_COMPLETION_INDEX", ""}, {"JOB_COMPLETIONS", "4"}}), Error);
}

class ShardSet : public SmallSet {
 protected:
  ShardSet() {
    options.workers = 1;
    shard.shard = {1, 2, "test"};
    shard.expiry = 10s;
  }

  ShardEnd work() {
    return generate_shard(options, shard, [](const Progress&) {});
  }
  ShardEnd join() {
    return merge(options.folder, options.margin, [](const std::string&) {});
  }
  /// The set of one worker that is no shard, in another folder.
  std::filesystem::path single() {
    GenerateOptions alone = options;
    alone.folder = root / "single";
    generate(alone, [](const Progress&) {});
    return alone.folder;
  }
  void expect_same(const std::filesystem::path& wanted) {
    for (const char* file :
         {"dataset.h5", "sequences/draping-00.h5", "sequences/draping-01.h5", "sequences/draping-02.h5"}) {
      ASSERT_FALSE(bytes_of(wanted / file).empty()) << file;
      EXPECT_EQ(bytes_of(options.folder / file), bytes_of(wanted / file)) << file;
    }
  }

  ShardOptions shard;
};

TEST_F(ShardSet, AWorkerAloneMakesTheWholeSetAndMergeCompletesIt) {
  EXPECT_EQ(work(), ShardEnd::kDone);
  EXPECT_FALSE(DatasetReader(options.folder).master().normalization.has_value());
  const VerifyReport unmerged = check();
  EXPECT_TRUE(unmerged.unmerged);
  EXPECT_THAT(unmerged.problems, testing::IsEmpty());
  EXPECT_EQ(unmerged.pending, 0u);
  EXPECT_EQ(unmerged.frames, 15u);
  EXPECT_EQ(join(), ShardEnd::kDone);
  EXPECT_FALSE(std::filesystem::exists(options.folder / "shards"));
  EXPECT_THAT(check().problems, testing::IsEmpty());
  EXPECT_FALSE(check().unmerged);
  expect_same(single());
  EXPECT_EQ(work(), ShardEnd::kDone) << "a worker that comes late finds nothing to do";
  EXPECT_FALSE(std::filesystem::exists(options.folder / "shards"));
  EXPECT_EQ(join(), ShardEnd::kDone) << "and neither does merge";
}

TEST_F(ShardSet, WhatAnotherWorkerHoldsIsLeftToIt) {
  // Somebody alive: it holds the second sequence and renews it whenever we look.
  LeaseFolder other(leases_folder(options.folder), 1s);
  auto held = other.claim("draping-01");
  ASSERT_TRUE(held.has_value());
  shard.expiry = 1s;
  shard.interrupted = [&] {
    EXPECT_TRUE(held->renew());
    return false;
  };
  EXPECT_EQ(work(), ShardEnd::kOthersWork);
  EXPECT_TRUE(is_finished(options.folder, "draping-00"));
  EXPECT_FALSE(is_finished(options.folder, "draping-01"));
  EXPECT_TRUE(is_finished(options.folder, "draping-02"));
  EXPECT_EQ(join(), ShardEnd::kOthersWork);
  EXPECT_EQ(check().pending, 1u);
  EXPECT_THAT(check().problems, testing::IsEmpty());
}

TEST_F(ShardSet, WhatADeadWorkerLeftIsContinuedFromItsCheckpoint) {
  options.scenes.frames = 25;
  LeaseFolder dead(leases_folder(options.folder), 500ms);
  ASSERT_TRUE(dead.claim("draping-01").has_value());
  const auto plans = plan_sequences(options.scenes);
  struct Stop {};
  EXPECT_THROW(make_sequence(work_folder(options.folder, "draping-01", 1), plans[1], true,
                             [](std::uint64_t frames) {
                               if (frames == 23) throw Stop();
                             },
                             {.durable = true}),
               Stop);
  // What is later than the check-point may be lost, or half there, when a machine goes.
  std::vector<std::uint64_t> seen;
  inherit_work(options.folder, "draping-01", 2);
  make_sequence(work_folder(options.folder, "draping-01", 2), plans[1], true,
                [&](std::uint64_t frames) { seen.push_back(frames); }, {.durable = true});
  EXPECT_THAT(seen, testing::ElementsAre(21u, 22u, 23u, 24u, 25u));
  std::filesystem::remove_all(work_folder(options.folder, "draping-01", 2));
  shard.expiry = 500ms;
  EXPECT_EQ(work(), ShardEnd::kDone);
  EXPECT_EQ(join(), ShardEnd::kDone);
  expect_same(single());
}

TEST_F(ShardSet, AnInterruptedWorkerGoesOnWithTheSameBits) {
  options.scenes.frames = 60;
  std::uint64_t frames = 0;
  shard.interrupted = [&] { return frames > 3; };
  const ShardEnd end = generate_shard(options, shard, [&](const Progress& progress) { frames = progress.frames_done; });
  EXPECT_EQ(end, ShardEnd::kInterrupted);
  EXPECT_TRUE(std::filesystem::exists(checkpoint_file(work_folder(options.folder, "draping-00", 1), "draping-00")) ||
              is_finished(options.folder, "draping-00"));
  EXPECT_EQ(join(), ShardEnd::kOthersWork);
  shard.interrupted = {};
  EXPECT_EQ(work(), ShardEnd::kDone) << "nothing has to expire first";
  EXPECT_EQ(join(), ShardEnd::kDone);
  expect_same(single());
}

TEST_F(ShardSet, OtherOptionsAreRefusedWhileItIsMade) {
  shard.interrupted = [] { return true; };
  EXPECT_EQ(work(), ShardEnd::kInterrupted);
  EXPECT_THROW(generate(options, [](const Progress&) {}), Error) << "a worker that is no shard";
  options.scenes.frames = 6;
  EXPECT_THROW(work(), Error);
  options.scenes.frames = 5;
  options.deflate = false;
  EXPECT_THROW(work(), Error);
  options.deflate = true;
  EXPECT_EQ(work(), ShardEnd::kInterrupted);
}

TEST_F(ShardSet, AFailingSequenceDoesNotKeepTheOthersFromBeingMade) {
  std::filesystem::create_directories(options.folder / "shards/work");
  std::ofstream(options.folder / "shards/work/draping-00.1");  // a file where its folder should be
  EXPECT_THROW(work(), Error);
  EXPECT_TRUE(is_finished(options.folder, "draping-01"));
  EXPECT_TRUE(is_finished(options.folder, "draping-02"));
  EXPECT_EQ(work(), ShardEnd::kDone) << "the next holder has another folder";
}

TEST_F(ShardSet, AMergeOfWhatIsNotThereSaysSo) {
  EXPECT_THROW(join(), Error);
  GenerateOptions alone = options;
  generate(alone, [](const Progress&) {});
  std::filesystem::remove(options.folder / "sequences/draping-01.h5");
  EXPECT_THROW(join(), Error) << "no shards make it";
}

}  // namespace
}  // namespace pleat::dataset
