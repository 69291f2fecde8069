#include "services/dataset/generate.hpp"

#include <algorithm>
#include <chrono>
#include <fstream>
#include <iterator>
#include <map>
#include <optional>

#include "common/base/error.hpp"
#include "common/base/parallel.hpp"
#include "common/store/dataset.hpp"
#include "services/dataset/normalization.hpp"
#include "services/dataset/sequence.hpp"
#include "services/dataset/shard_folder.hpp"
#include "services/dataset/workers.hpp"

namespace pleat::dataset {

DatasetMaster make_master(const GenerateOptions& options, const std::vector<SequencePlan>& plans) {
  const simulation::Scene& scene = plans.front().scene;
  DatasetMaster master;
  master.frame_time_s = scene.frame_time_s;
  master.time_step_s = scene.frame_time_s / scene.steps_per_frame;
  master.seed = options.scenes.seed;
  master.tracked = plans.front().tracked;
  master.git_revision = options.git_revision;
  const auto same = [&](const SequencePlan& plan) { return plan.material_json == plans.front().material_json; };
  if (std::all_of(plans.begin(), plans.end(), same)) master.material = plans.front().material_json;
  if (!options.scenes.material.empty()) {
    std::ifstream material(options.scenes.material, std::ios::binary);
    master.material.assign(std::istreambuf_iterator<char>(material), {});
  }
  master.topology = meshes_of(plans.front());
  return master;
}

std::map<std::string, std::uint64_t> inspect_folder(const GenerateOptions& options,
                                                    const std::vector<SequencePlan>& plans,
                                                    const DatasetMaster& master) {
  std::map<std::string, std::uint64_t> complete;
  std::error_code error;
  if (!std::filesystem::exists(options.folder / "dataset.h5", error)) return complete;
  const DatasetReader reader(options.folder);
  const std::string advice = ": begun with other options; remove the folder or choose another";
  if (topology_hash(reader.topology().fine) != topology_hash(master.topology.fine) ||
      reader.master().seed != master.seed || reader.master().tracked != master.tracked ||
      (!reader.master().material.empty() && reader.master().material != master.material)) {
    throw Error(ErrorCode::kFailedPrecondition, options.folder.string() + advice);
  }
  for (const SequenceInfo& info : reader.sequences()) {
    const auto plan = std::find_if(plans.begin(), plans.end(), [&](const auto& p) { return p.name == info.name; });
    const auto other_meshes = [&] {
      return plan->own_meshes && info.topology_hash != topology_hash(meshes_of(*plan).fine);
    };
    if (plan == plans.end() || plan->scene_json != info.scene || plan->split != info.split || other_meshes()) {
      throw Error(ErrorCode::kFailedPrecondition, options.folder.string() + ", sequence " + info.name + advice);
    }
    complete[info.name] = info.frames_complete;
  }
  return complete;
}

std::string how_it_ended(const WorkerEvent& event) {
  switch (event.kind) {
    case WorkerEvent::Kind::kFailed:
      return " failed: " + event.text;
    case WorkerEvent::Kind::kDropped:
      return " is dropped: " + event.text;
    case WorkerEvent::Kind::kInterrupted:
      return " is interrupted";
    default:
      return " is finished: " + event.text;
  }
}

void generate(const GenerateOptions& options, const std::function<void(const Progress&)>& progress) {
  std::vector<std::string> notes;
  std::vector<SequencePlan> plans = plan_sequences(options.scenes, &notes);
  DatasetMaster master = make_master(options, plans);
  require_no_shards(options.folder);
  const std::map<std::string, std::uint64_t> complete = inspect_folder(options, plans, master);

  const std::size_t processors = available_processors();
  std::vector<std::size_t> waiting;
  std::vector<std::uint64_t> done(plans.size(), 0);
  std::vector<char> dropped(plans.size(), 0);
  for (std::size_t i = plans.size(); i-- > 0;) {
    if (const auto found = complete.find(plans[i].name); found != complete.end()) done[i] = found->second;
    dropped[i] = why_dropped(options.folder, plans[i]).has_value();
    if (!dropped[i] && !is_finished(options.folder, plans[i].name)) waiting.push_back(i);
  }
  const auto write_master = [&] {
    master.sequences.clear();
    for (std::size_t i = 0; i < plans.size(); ++i) {
      if (dropped[i] == 0) master.sequences.push_back(plans[i].name);
    }
    write_dataset_master(options.folder, master);
  };
  write_master();
  const std::size_t most = options.workers > 0 ? static_cast<std::size_t>(options.workers) : processors;
  const std::size_t workers_wanted = std::max<std::size_t>(1, std::min(most, waiting.size()));
  for (SequencePlan& plan : plans) {
    plan.scene.threads = static_cast<int>(std::max<std::size_t>(1, processors / workers_wanted));
  }

  const auto start = std::chrono::steady_clock::now();
  const auto total = [&] {
    std::uint64_t sum = 0;
    for (const std::uint64_t frames : done) sum += frames;
    return sum;
  };
  const std::uint64_t before = total();
  const auto report = [&](const std::string& message) {
    Progress now;
    now.frames_done = total();
    now.frames = 0;
    for (std::size_t i = 0; i < plans.size(); ++i) {
      if (dropped[i] == 0) now.frames += static_cast<std::uint64_t>(plans[i].scene.frames);
    }
    now.elapsed_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const auto made = static_cast<double>(now.frames_done - before);
    if (made > 0) now.left_s = now.elapsed_s * static_cast<double>(now.frames - now.frames_done) / made;
    now.message = message;
    progress(now);
  };
  for (const std::string& note : notes) report("note: " + note);

  WorkerPool workers;
  std::optional<Error> failure;
  const auto on_event = [&](const WorkerEvent& event) {
    if (event.kind == WorkerEvent::Kind::kFrame) {
      done[event.plan] = std::max(done[event.plan], event.frames);
      return report("");
    }
    if (event.kind == WorkerEvent::Kind::kDropped) {
      dropped[event.plan] = 1;
      done[event.plan] = 0;
    }
    const std::string& name = plans[event.plan].name;
    report(name + how_it_ended(event));
    if (event.error && !failure) failure.emplace(event.error->code(), name + ": " + event.text);
  };
  while (!waiting.empty() || workers.size() > 0) {
    while (workers.size() < workers_wanted && !waiting.empty()) {
      const std::size_t index = waiting.back();
      waiting.pop_back();
      const SequencePlan& plan = plans[index];
      workers.start(index, [&](const auto& on_frame, const auto&) {
        return make_sequence(options.folder, plan, options.deflate, on_frame);
      });
      report(plan.name + " (" + plan.split + ") begins at frame " + std::to_string(done[index]));
    }
    workers.wait(std::chrono::milliseconds(-1), on_event);
  }
  if (failure) throw *failure;
  write_master();
  report("normalisation of the training split");
  master.normalization = measure_range(DatasetReader(options.folder), options.margin);
  write_master();
}

}  // namespace pleat::dataset
