#include "services/dataset/shard_folder.hpp"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <system_error>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/base/whole_file.hpp"
#include "services/dataset/sequence.hpp"

namespace pleat::dataset {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFormat = "pleat.dataset_shards";
constexpr int kVersion = 1;

fs::path plan_file(const fs::path& folder) { return shards_folder(folder) / "plan.json"; }

std::string hash_of(const std::string& text) { return Hash().add(text).hex(); }

nlohmann::ordered_json to_json(const ShardPlan& plan) {
  nlohmann::ordered_json json = {{"format", kFormat},
                                 {"version", kVersion},
                                 {"topology_hash", plan.topology_hash},
                                 {"material_hash", plan.material_hash},
                                 {"seed", plan.seed},
                                 {"tracked", plan.tracked},
                                 {"deflate", plan.deflate},
                                 {"git_revision", plan.git_revision},
                                 {"sequences", nlohmann::ordered_json::array()}};
  for (const ShardSequence& sequence : plan.sequences) {
    json["sequences"].push_back({{"name", sequence.name},
                                 {"split", sequence.split},
                                 {"frames", sequence.frames},
                                 {"scene_hash", sequence.scene_hash}});
  }
  return json;
}

ShardPlan plan_of(const nlohmann::json& json) {
  ShardPlan plan;
  plan.topology_hash = json.at("topology_hash").get<std::string>();
  plan.material_hash = json.at("material_hash").get<std::string>();
  plan.seed = json.at("seed").get<std::uint64_t>();
  plan.tracked = json.at("tracked").get<bool>();
  plan.deflate = json.at("deflate").get<bool>();
  plan.git_revision = json.at("git_revision").get<std::string>();
  for (const nlohmann::json& sequence : json.at("sequences")) {
    plan.sequences.push_back({sequence.at("name").get<std::string>(), sequence.at("split").get<std::string>(),
                              sequence.at("frames").get<std::uint64_t>(),
                              sequence.at("scene_hash").get<std::string>()});
  }
  return plan;
}

/// Gives a finished file its name unless there is one of that name. Where the file system has no hard links the last
/// one wins, which matters only if two workers with different options begin in the same moment.
void publish_first(const fs::path& temporary, const fs::path& path) {
  if (::link(temporary.c_str(), path.c_str()) == 0 || errno == EEXIST) return;
  // The answer to a link that was made may get lost on the way from an NFS server.
  std::error_code failed;
  if (fs::equivalent(temporary, path, failed) || fs::exists(path, failed)) return;
  fs::rename(temporary, path, failed);
  if (failed) throw Error(ErrorCode::kResourceExhausted, path.string() + ": can't be made: " + failed.message());
}

bool is_there(const fs::path& path) {
  std::error_code ignored;
  return fs::exists(path, ignored);
}

/// Under its name when it is all there. False if there is nothing to copy (any more).
bool copy_whole(const fs::path& from, const fs::path& to) {
  const fs::path temporary = to.string() + ".copy";
  std::error_code failed;
  if (!fs::copy_file(from, temporary, fs::copy_options::overwrite_existing, failed) || failed) {
    fs::remove(temporary, failed);
    return false;
  }
  fs::rename(temporary, to, failed);
  return !failed;
}

void remove_work(const fs::path& folder, const std::string& name, std::uint64_t up_to) {
  std::error_code ignored;
  for (std::uint64_t generation = up_to; generation > 0; --generation) {
    fs::remove_all(work_folder(folder, name, generation), ignored);
  }
}

}  // namespace

OwnFolder::OwnFolder(const fs::path& parent) {
  std::random_device random;
  path_ = parent / ("own-" + std::to_string(::getpid()) + "-" + std::to_string(random()));
  std::error_code failed;
  fs::create_directories(path_, failed);
  if (failed) throw_invalid_argument(path_.string() + ": can't be made: " + failed.message());
}

OwnFolder::~OwnFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

fs::path shards_folder(const fs::path& folder) { return folder / "shards"; }
fs::path leases_folder(const fs::path& folder) { return shards_folder(folder) / "leases"; }
fs::path work_folder(const fs::path& folder, const std::string& name, std::uint64_t generation) {
  return shards_folder(folder) / "work" / (name + "." + std::to_string(generation));
}

bool has_shards(const fs::path& folder) { return is_there(plan_file(folder)); }

void require_no_shards(const fs::path& folder) {
  if (!has_shards(folder)) return;
  throw Error(ErrorCode::kFailedPrecondition,
              folder.string() + ": shards make it: give --shard, or `pleat dataset merge` when they are done");
}

ShardPlan make_shard_plan(const std::vector<SequencePlan>& plans, const DatasetMaster& master, bool deflate) {
  ShardPlan plan;
  for (const SequencePlan& sequence : plans) {
    plan.sequences.push_back({sequence.name, sequence.split, static_cast<std::uint64_t>(sequence.scene.frames),
                              hash_of(sequence.scene_json)});
  }
  plan.topology_hash = topology_hash(master.topology.fine);
  if (std::any_of(plans.begin(), plans.end(), [](const SequencePlan& p) { return p.own_meshes; })) {
    Hash all;
    for (const SequencePlan& sequence : plans) all.add(topology_hash(sequence.scene.garment));
    plan.topology_hash = all.hex();
  }
  plan.material_hash = hash_of(master.material);
  plan.seed = master.seed;
  plan.tracked = master.tracked;
  plan.deflate = deflate;
  plan.git_revision = master.git_revision;
  return plan;
}

ShardPlan begin_shards(const fs::path& folder, const ShardPlan& plan, const DatasetMaster& planned) {
  if (!has_shards(folder)) {
    DatasetMaster master = planned;
    master.sequences.clear();
    for (const ShardSequence& sequence : plan.sequences) master.sequences.push_back(sequence.name);
    std::error_code failed;
    fs::create_directories(folder / "sequences", failed);
    const OwnFolder own(shards_folder(folder));
    // The master first: where a plan is, it is there too.
    if (!is_there(folder / "dataset.h5")) {
      write_dataset_master(own.path(), master);
      publish_first(own.path() / "dataset.h5", folder / "dataset.h5");
    }
    write_whole_file(own.path() / "plan.json", to_json(plan).dump(1) + "\n");
    publish_first(own.path() / "plan.json", plan_file(folder));
  }
  ShardPlan begun = read_shard_plan(folder);
  ShardPlan wanted = plan;
  wanted.git_revision = begun.git_revision;
  if (to_json(wanted) != to_json(begun)) {
    throw Error(
        ErrorCode::kFailedPrecondition,
        folder.string() + ": shards have begun it with other options; merge it first, or choose another folder");
  }
  return begun;
}

ShardPlan read_shard_plan(const fs::path& folder) {
  std::ifstream stream(plan_file(folder), std::ios::binary);
  const nlohmann::json json = nlohmann::json::parse(stream, nullptr, false);
  try {
    if (json.is_object() && json.value("format", "") == kFormat && json.value("version", 0) == kVersion)
      return plan_of(json);
  } catch (const nlohmann::json::exception&) {  // says less than the line below
  }
  throw_data_loss(plan_file(folder).string() + ": not the plan of a data set's shards, or of another version");
}

bool is_settled(const fs::path& folder, const ShardSequence& sequence) {
  return is_finished(folder, sequence.name) || is_dropped(folder, sequence);
}

bool is_dropped(const fs::path& folder, const ShardSequence& sequence) {
  const auto scene = dropped_scene(folder, sequence.name);
  return scene.has_value() && hash_of(*scene) == sequence.scene_hash;
}

void inherit_work(const fs::path& folder, const std::string& name, std::uint64_t generation) {
  const fs::path own = work_folder(folder, name, generation);
  std::error_code failed;
  fs::create_directories(own / "sequences", failed);
  if (failed) throw Error(ErrorCode::kResourceExhausted, own.string() + ": can't be made: " + failed.message());
  for (std::uint64_t earlier = generation; earlier-- > 0;) {
    const fs::path source = earlier > 0 ? work_folder(folder, name, earlier) : folder;
    // The check-point first: the frames that it counts on are in the recording by then.
    copy_whole(checkpoint_file(source, name), checkpoint_file(own, name));
    if (copy_whole(partial_file(source, name), partial_file(own, name))) return;
    fs::remove(checkpoint_file(own, name), failed);
  }
}

void publish_work(const fs::path& folder, const std::string& name, std::uint64_t generation) {
  const fs::path own = work_folder(folder, name, generation);
  for (const auto file : {&sequence_file, &dropped_file}) {
    if (is_there(file(own, name))) publish_file(file(own, name), file(folder, name));
  }
  remove_work(folder, name, generation);
  std::error_code ignored;
  if (is_finished(folder, name)) fs::remove(dropped_file(folder, name), ignored);  // of another scene
  // Of a worker that was no shard; inherited.
  fs::remove(partial_file(folder, name), ignored);
  fs::remove(checkpoint_file(folder, name), ignored);
}

}  // namespace pleat::dataset
