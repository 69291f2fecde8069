#include "services/dataset/generate.hpp"

#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <optional>

#include "common/base/error.hpp"
#include "common/base/parallel.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "services/dataset/normalization.hpp"
#include "services/dataset/sequence.hpp"

namespace pleat::dataset {
namespace {

using Clock = std::chrono::steady_clock;

/// What a worker writes to its pipe: one of these per event, smaller than PIPE_BUF so that it arrives whole.
struct Event {
  enum Kind : std::uint32_t { kFrame, kDone, kDropped, kFailed };
  std::uint32_t kind = kFrame;
  std::uint32_t code = 0;
  std::uint64_t frames = 0;
  char text[488] = {};
};

/// A process that makes one sequence.
struct Worker {
  std::size_t plan = 0;
  pid_t process = -1;
  int pipe = -1;
  bool ended = false;  ///< it said how it ended
};

void send(int pipe, const Event& event) {
  const ssize_t written = write(pipe, &event, sizeof(event));
  if (written != static_cast<ssize_t>(sizeof(event))) _exit(1);  // the parent has gone
}

[[noreturn]] void run_worker(const GenerateOptions& options, const SequencePlan& plan, int pipe, pid_t parent) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(1);
  Event last;
  try {
    const SequenceReport report = make_sequence(options.folder, plan, options.deflate, [&](std::uint64_t frames) {
      Event event;
      event.frames = frames;
      send(pipe, event);
    });
    last.kind = report.dropped.empty() ? Event::kDone : Event::kDropped;
    if (report.dropped.empty()) {
      std::snprintf(last.text, sizeof(last.text), "%.0f ms coarse and %.0f ms fine a frame, %llu steps cut",
                    report.coarse_ms, report.fine_ms, static_cast<unsigned long long>(report.cut_steps));
    } else {
      std::snprintf(last.text, sizeof(last.text), "%s", report.dropped.c_str());
    }
  } catch (const Error& error) {
    last.kind = Event::kFailed;
    last.code = static_cast<std::uint32_t>(error.code());
    std::snprintf(last.text, sizeof(last.text), "%s", error.what());
  } catch (const std::exception& error) {
    last.kind = Event::kFailed;
    last.code = static_cast<std::uint32_t>(ErrorCode::kInternal);
    std::snprintf(last.text, sizeof(last.text), "%s", error.what());
  }
  send(pipe, last);
  _exit(last.kind == Event::kFailed ? 1 : 0);
}

Worker start_worker(const GenerateOptions& options, const SequencePlan& plan, std::size_t index) {
  int ends[2];
  if (pipe(ends) != 0) throw Error(ErrorCode::kResourceExhausted, "no pipe for a worker");
  const pid_t parent = getpid();
  const pid_t process = fork();
  if (process < 0) {
    close(ends[0]);
    close(ends[1]);
    throw Error(ErrorCode::kResourceExhausted, "no process for a worker");
  }
  if (process == 0) {
    close(ends[0]);
    run_worker(options, plan, ends[1], parent);
  }
  close(ends[1]);
  return {index, process, ends[0], false};
}

DatasetMaster make_master(const GenerateOptions& options, const std::vector<SequencePlan>& plans) {
  const simulation::Scene& scene = plans.front().scene;
  DatasetMaster master;
  master.frame_time_s = scene.frame_time_s;
  master.time_step_s = scene.frame_time_s / scene.steps_per_frame;
  master.seed = options.scenes.seed;
  master.tracked = plans.front().tracked;
  master.git_revision = options.git_revision;
  std::ifstream material(options.scenes.material, std::ios::binary);
  master.material.assign(std::istreambuf_iterator<char>(material), {});
  Subdivision subdivision = subdivide(scene.garment, scene.subdivision_rounds, scene.subdivision_rule);
  master.topology.coarse = scene.garment;
  master.topology.fine = std::move(subdivision.fine);
  master.topology.feature_vertices = std::move(subdivision.feature_vertices);
  return master;
}

/// Throws kFailedPrecondition if the folder holds another data set. Returns the frames that are complete per sequence.
std::map<std::string, std::uint64_t> inspect(const GenerateOptions& options, const std::vector<SequencePlan>& plans,
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
    if (plan == plans.end() || plan->scene_json != info.scene || plan->split != info.split) {
      throw Error(ErrorCode::kFailedPrecondition, options.folder.string() + ", sequence " + info.name + advice);
    }
    complete[info.name] = info.frames_complete;
  }
  return complete;
}

}  // namespace

void generate(const GenerateOptions& options, const std::function<void(const Progress&)>& progress) {
  std::vector<std::string> notes;
  std::vector<SequencePlan> plans = plan_sequences(options.scenes, &notes);
  DatasetMaster master = make_master(options, plans);
  const std::map<std::string, std::uint64_t> complete = inspect(options, plans, master);

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

  const auto start = Clock::now();
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
    now.elapsed_s = std::chrono::duration<double>(Clock::now() - start).count();
    const auto made = static_cast<double>(now.frames_done - before);
    if (made > 0) now.left_s = now.elapsed_s * static_cast<double>(now.frames - now.frames_done) / made;
    now.message = message;
    progress(now);
  };
  for (const std::string& note : notes) report("note: " + note);

  std::vector<Worker> workers;
  std::optional<Error> failure;
  while (!waiting.empty() || !workers.empty()) {
    while (workers.size() < workers_wanted && !waiting.empty()) {
      const std::size_t index = waiting.back();
      waiting.pop_back();
      workers.push_back(start_worker(options, plans[index], index));
      report(plans[index].name + " (" + plans[index].split + ") begins at frame " + std::to_string(done[index]));
    }
    std::vector<pollfd> polled;
    for (const Worker& worker : workers) polled.push_back({worker.pipe, POLLIN, 0});
    poll(polled.data(), polled.size(), -1);
    for (std::size_t i = workers.size(); i-- > 0;) {
      if (polled[i].revents == 0) continue;
      Worker& worker = workers[i];
      const std::string& name = plans[worker.plan].name;
      Event event;
      const ssize_t size = read(worker.pipe, &event, sizeof(event));
      if (size == static_cast<ssize_t>(sizeof(event))) {
        if (event.kind == Event::kFrame) {
          done[worker.plan] = std::max(done[worker.plan], event.frames);
          report("");
        } else {
          worker.ended = true;
          const bool failed = event.kind == Event::kFailed;
          if (event.kind == Event::kDropped) {
            dropped[worker.plan] = 1;
            done[worker.plan] = 0;
          }
          report(name +
                 (failed                      ? " failed: "
                  : dropped[worker.plan] != 0 ? " is dropped: "
                                              : " is finished: ") +
                 event.text);
          if (failed && !failure) failure.emplace(static_cast<ErrorCode>(event.code), name + ": " + event.text);
        }
        continue;
      }
      int status = 0;
      waitpid(worker.process, &status, 0);
      close(worker.pipe);
      if (!worker.ended && !failure) {
        failure.emplace(ErrorCode::kInternal,
                        name + ": its process ended with " +
                            (WIFSIGNALED(status) ? std::string(strsignal(WTERMSIG(status)))
                                                 : "exit code " + std::to_string(WEXITSTATUS(status))));
      }
      workers.erase(workers.begin() + static_cast<std::ptrdiff_t>(i));
    }
  }
  if (failure) throw *failure;
  write_master();
  report("normalisation of the training split");
  master.normalization = measure_range(DatasetReader(options.folder), options.margin);
  write_master();
}

}  // namespace pleat::dataset
