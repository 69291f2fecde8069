// The two phases of a job: enhance (simulation, pipeline, result file) and the reference simulation.
#include <algorithm>
#include <cstring>
#include <map>
#include <utility>

#include "common/base/whole_file.hpp"
#include "common/features/frame_features.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "common/frame/scene_json.hpp"
#include "common/telemetry/stage_timer.hpp"
#include "services/coordinator/fold_stage.hpp"
#include "services/coordinator/job_runner.hpp"
#include "services/coordinator/recorder.hpp"
#include "services/coordinator/result_events.hpp"
#include "services/coordinator/simulation_source.hpp"

namespace pleat::coordinator {
namespace {

namespace fs = std::filesystem;

std::uint64_t frames_on_disk(const fs::path& file) {
  if (!fs::exists(file)) return 0;
  try {
    return ResultReader(file, FileOrigin::kOwn).frames_complete();
  } catch (const Error&) {
    return 0;  // the writer judges the file, and replaces one that it can't continue
  }
}

std::vector<Eigen::Index> obstacle_vertices(const v1::Scene& scene,
                                            const google::protobuf::RepeatedPtrField<v1::ObstacleShape>& shapes) {
  std::vector<Eigen::Index> counts;
  for (const auto& shape : shapes) {
    Eigen::Index count = 0;
    for (const auto& obstacle : scene.obstacles()) {
      if (obstacle.name() == shape.name() && obstacle.has_mesh()) count = obstacle.mesh().rest_positions_size() / 3;
    }
    counts.push_back(count);
  }
  return counts;
}

/// What the simulation makes beside the coarse cloth.
v1::SimulateOpen::Fine simulated_fine(v1::Detail detail) {
  if (detail == v1::DETAIL_TRACKED) return v1::SimulateOpen::FINE_TRACKED;
  return detail == v1::DETAIL_FREE ? v1::SimulateOpen::FINE_FREE : v1::SimulateOpen::FINE_NONE;
}

/// The frames before `first` from which the network's window is filled, from the file that has them.
std::vector<v1::Frame> earlier_frames(const fs::path& partial, std::uint64_t first,
                                      const v1::Representation& representation, double frame_time_s) {
  std::vector<v1::Frame> earlier;
  if (representation.window() < 2 || first == 0) return earlier;
  const std::uint64_t reach =
      std::uint64_t{representation.window() - 1} * std::max<std::uint64_t>(1, representation.window_stride());
  const std::uint64_t begin = first - std::min(first, reach), before = begin > 0 ? begin - 1 : 0;
  const ResultReader reader(partial, FileOrigin::kOwn);
  const std::vector<Positions> positions = reader.coarse(before, first);
  for (std::uint64_t index = begin; index < first; ++index) {
    Frame frame;
    frame.index = index;
    frame.positions = positions[index - before];
    frame.velocities = backward_velocities(frame.positions,
                                           index > before ? positions[index - before - 1] : Positions(), frame_time_s);
    earlier.push_back(to_message(frame));
  }
  return earlier;
}

/// The bundle in `file` that the frames in `partial` were made with; nothing where there are no frames, or those of an
/// older coordinator. If the file is damaged, nothing may follow those frames: they are removed.
std::optional<v1::ModelDescription> load_bundle(const fs::path& file, const fs::path& partial) {
  const auto content = read_file(file);
  if (!content || frames_on_disk(partial) == 0) return std::nullopt;
  v1::ModelDescription bundle;
  if (bundle.ParseFromString(*content) && !bundle.model().empty()) return bundle;
  fs::remove(partial);
  return std::nullopt;
}

/// A simulation that starts at the check-point in `file` if that lies before frame `wanted`, else at the beginning.
struct StartedSimulation {
  std::unique_ptr<SimulationSource> source;
  v1::SimulateOpened opened;
  std::shared_ptr<const FoldMemory> fold;        ///< of the check-point
  std::shared_ptr<const NetworkMemory> network;  ///< the same
};

StartedSimulation start_simulation(ActiveJob& job, SimulationSource::Options options, const fs::path& file,
                                   std::uint64_t wanted) {
  const auto checkpoint = load_checkpoint(file);
  const auto start = [&] {
    StartedSimulation started;
    started.source = std::make_unique<SimulationSource>(options);
    const ActiveJob::Interrupt interrupt(job, [&](const Error&) { started.source->cancel(); });
    started.opened = started.source->open();
    return started;
  };
  if (checkpoint && checkpoint->index < wanted) {
    options.checkpoint = checkpoint->state;
    try {
      auto started = start();
      started.fold = checkpoint->fold;
      started.network = checkpoint->network;
      if (started.opened.next_index() <= wanted) return started;
    } catch (const Error& e) {
      // A check-point of another build of the service costs time, not the job.
      if (may_pass(e.code()) || e.code() == ErrorCode::kCancelled) throw;
    }
    options.checkpoint.clear();
  }
  return start();
}

/// Check-points wait here until the frames up to them are on disk.
class PendingCheckpoints {
 public:
  explicit PendingCheckpoints(fs::path file) : file_(std::move(file)) {}

  void add(std::uint64_t index, std::string state) {
    const std::lock_guard lock(mutex_);
    pending_[index] = {index, std::move(state)};
  }
  /// What the fold step and the network left, before their frame is stored. The frame gives it away.
  void add_memories(PipelineFrame& frame) {
    const std::lock_guard lock(mutex_);
    if (const auto found = pending_.find(frame.sequence); found != pending_.end()) {
      found->second.fold = frame.fold_memory;
      found->second.network = frame.network_memory;
    }
    frame.fold_memory.reset();
    frame.network_memory.reset();
  }
  void frames_are_stored(std::uint64_t frames) {
    std::optional<Checkpoint> newest;
    {
      const std::lock_guard lock(mutex_);
      while (!pending_.empty() && pending_.begin()->first < frames) {
        newest = std::move(pending_.begin()->second);
        pending_.erase(pending_.begin());
      }
    }
    if (newest) save_checkpoint(file_, *newest);
  }

 private:
  const fs::path file_;
  std::mutex mutex_;
  std::map<std::uint64_t, Checkpoint> pending_;
};

}  // namespace

void JobRunner::enhance(ActiveJob& job, const v1::CreateJobRequest& request, const Animations& animations,
                        const LinkOptions& link) {
  const v1::Scene& scene = request.scene();
  const fs::path folder = table_.folder(job.id);
  const fs::path result = folder / "result.h5";
  const fs::path partial = folder / "result.h5.partial";
  const double earlier_s = table_.get(job.id).wall_s;
  const telemetry::StageTimer wall;

  PipelineSession session;
  // The service's default bundle may be another one by now.
  session.detail = checked_detail(request.detail(), request.model(), "detail");
  const bool network = uses_network(session.detail), fold = uses_fold(session.detail);
  const auto bundle = network ? load_bundle(folder / "bundle.pb", partial) : std::nullopt;
  session.window = settings_.window;
  session.model = network ? describe_model(addresses_, link, bundle ? bundle->model() : request.model(),
                                           [&] { return job.cause().has_value(); })
                          : without_model();
  if (fold) session.fold = fold_open_of(scene);
  session.fold_turn = table_.get(job.id).order;
  session.representation = representation_of(scene, session.detail, session.model);

  SimulationSource::Options simulation{.addresses = addresses_.simulation,
                                       .scene = scene,
                                       .animations = animations,
                                       .fine = simulated_fine(session.detail),
                                       .window = settings_.window,
                                       .checkpoint_interval = settings_.checkpoint_interval,
                                       .checkpoint = {},
                                       .link = link};
  auto started = start_simulation(job, simulation, folder / "checkpoint.bin", frames_on_disk(partial));
  const auto start_anew = [&] { started = start_simulation(job, simulation, {}, 0); };
  // The fold step goes on from what it left, and that is kept at check-points alone: the frames behind it are made
  // again, and have the bits that are on disk. So do networks that remember.
  const bool remembers = network_remembers(session);
  if (started.opened.next_index() > 0 && ((fold && !started.fold) || (remembers && !started.network))) start_anew();
  session.coarse = started.opened.coarse();
  session.obstacles = started.opened.obstacles();
  const Topology coarse = from_message(session.coarse, "the simulation's coarse mesh");
  session.coarse.set_hash(topology_hash(coarse));
  if (network) session.network_coarse = coarse_for_network(session.model, coarse);
  const Subdivision subdivision = subdivision_of(session, coarse, [&] {
    if (!network) return;
    session.conversion = describe_conversion(addresses_, link, session, [&] { return job.cause().has_value(); });
  });
  const auto fine_vertices = static_cast<std::size_t>(subdivision.fine.vertex_count());
  if (started.opened.has_fine()) {
    check_fine_hash(topology_hash(from_message(started.opened.fine(), "the simulation's fine mesh")),
                    topology_hash(subdivision.fine));
  }
  if (session.detail == v1::DETAIL_NONE) {
    session.upsampling = std::make_shared<const SmoothUpsampling>(coarse, subdivision);
  }

  ResultOptions options;
  options.topology = {coarse, subdivision.fine, subdivision.feature_vertices};
  options.frames = scene.frames();
  options.frame_time_s = scene.frame_time_s() > 0 ? scene.frame_time_s() : kDefaultFrameTime;
  options.model = session.model.model();
  options.scene = scene_json(scene);
  for (const auto& shape : session.obstacles) options.obstacles.push_back(from_message(shape));
  options.obstacle_vertices = obstacle_vertices(scene, session.obstacles);
  const JobColumns columns = job_columns(session.detail);
  options.stages = columns.stages;
  options.counts = columns.counts;
  options.deflate = settings_.compress && !request.reference();

  // A simulation that is begun again says the same again.
  const auto keep_warnings = [&](const v1::SimulatedFrame& simulated) {
    if (simulated.warnings().empty()) return;
    table_.update(job.id, [&](JobRecord& record) {
      for (const std::string& warning : simulated.warnings()) {
        if (std::find(record.warnings.begin(), record.warnings.end(), warning) == record.warnings.end()) {
          record.warnings.push_back(warning);
        }
      }
    });
  };

  PendingCheckpoints checkpoints(folder / "checkpoint.bin");
  const auto stored = [&](const Recorder::FramePtr& frame, std::uint64_t complete) {
    checkpoints.frames_are_stored(complete);
    const bool failed = frame->error.has_value();
    const std::uint32_t penetrations = frame->report.penetrations_after();
    const std::uint32_t self_intersections = frame->report.self_intersections_after();
    const auto pinch = frame->pinch;
    // The frame belongs to nobody else any more: its arrays go to the watchers without a copy.
    job.feed.publish(frame->index, make_event(*frame));
    table_.update(job.id, [&](JobRecord& record) {
      record.frames_complete = static_cast<std::uint32_t>(complete);
      record.penetrations += penetrations;
      record.self_intersections += self_intersections;
      record.frame_errors += failed ? 1 : 0;
      record.pinched_frames += pinch ? 1 : 0;
      if (pinch) record.pinch_depth_m = std::max(record.pinch_depth_m, pinch->depth_m());
      record.wall_s = earlier_s + wall.milliseconds() * 1e-3;
    });
  };
  const Counts before = counts_of(partial);
  std::uint64_t begin = fold || remembers ? started.opened.next_index() : frames_on_disk(partial);
  auto earlier = earlier_frames(partial, begin, session.representation, options.frame_time_s);
  Recorder recorder(result, options, subdivision, settings_.window,
                    {.stored = stored, .failed = [&](const Error& cause) { job.abort(cause); }});
  const std::uint64_t first = recorder.first_index();
  if (begin > first || first == 0) {
    // The file could not be continued.
    begin = first;
    earlier.clear();
  }
  if (started.opened.next_index() > begin) start_anew();  // the check-point lies beyond it
  table_.update(job.id, [&](JobRecord& record) {
    record.detail = name_of(session.detail);
    record.model = session.model.model();
    record.device = session.model.device();
    record.precision = session.model.precision();
    record.coarse_vertices = static_cast<std::uint32_t>(coarse.vertex_count());
    record.fine_vertices = static_cast<std::uint32_t>(fine_vertices);
    record.frames_complete = static_cast<std::uint32_t>(first);
    const Counts counts = first > 0 ? before : Counts{};
    record.penetrations = counts.penetrations;
    record.self_intersections = counts.self_intersections;
    record.frame_errors = counts.frame_errors;
  });
  job.feed.set_opened(make_opened_event(options.topology, options.obstacles));

  SimulationSource& source = *started.source;
  session.first_sequence = begin;
  session.fold_memory = started.fold;
  session.network_memory = started.network;
  session.earlier = std::move(earlier);
  try {
    if (bundle && first > 0) {
      require_same_bundle(*bundle, session.model);
    } else if (network) {
      write_whole_file(folder / "bundle.pb", session.model.SerializeAsString());
    }
    EnhancementPipeline pipeline(
        addresses_, link, session, fine_vertices, topology_hash(subdivision.fine),
        [&](std::unique_ptr<PipelineFrame> frame) {
          checkpoints.add_memories(*frame);
          if (frame->index >= first) recorder.add(std::move(frame));
        },
        [&] { source.cancel(); });
    const ActiveJob::Interrupt interrupt(job, [&](const Error& cause) { pipeline.fail(cause); });
    try {
      if (first < scene.frames()) {
        source.run([&](v1::SimulatedFrame& simulated) {
          const std::uint64_t index = simulated.coarse().index();
          keep_warnings(simulated);
          if (!simulated.checkpoint().empty()) checkpoints.add(index, std::move(*simulated.mutable_checkpoint()));
          if (index < begin) return true;
          auto frame = std::make_unique<PipelineFrame>();
          frame->sequence = frame->index = index;
          frame->coarse.Swap(simulated.mutable_coarse());
          frame->fine.Swap(simulated.mutable_fine());
          if (session.detail == v1::DETAIL_COARSE) *frame->fine.mutable_positions() = frame->coarse.positions();
          frame->obstacles.Swap(simulated.mutable_obstacles());
          frame->stage_times.Swap(simulated.mutable_stage_times());
          if (simulated.has_pinch()) frame->pinch = simulated.pinch();
          return pipeline.push(std::move(frame));
        });
      }
    } catch (const Error& e) {
      pipeline.fail(e);  // keeps an earlier cause, for example that a stage was lost
    }
    pipeline.close();
    pipeline.wait();
    recorder.finish();
  } catch (const Error&) {
    if (!stopping()) recorder.salvage();
    throw;
  }
}

void JobRunner::simulate_reference(ActiveJob& job, const v1::CreateJobRequest& request, const Animations& animations,
                                   const LinkOptions& link) {
  const fs::path folder = table_.folder(job.id);
  const fs::path result = folder / "result.h5";
  const fs::path path = folder / "reference.h5";
  {
    const ResultReader enhanced(result, FileOrigin::kOwn);
    ResultOptions options = enhanced.info();
    options.has_fine = true;
    options.deflate = settings_.compress;
    ResultWriter writer(path, options, true);

    SimulationSource::Options simulation{.addresses = addresses_.simulation,
                                         .scene = request.scene(),
                                         .animations = animations,
                                         .fine = v1::SimulateOpen::FINE_TRACKED,
                                         .window = settings_.window,
                                         .checkpoint_interval = settings_.checkpoint_interval,
                                         .checkpoint = {},
                                         .link = link};
    const fs::path checkpoint_file = folder / "reference_checkpoint.bin";
    auto started = start_simulation(job, simulation, checkpoint_file, writer.frames_complete());
    SimulationSource& source = *started.source;
    const ActiveJob::Interrupt interrupt(job, [&](const Error&) { source.cancel(); });
    const auto report = [&] {
      table_.update(job.id, [&](JobRecord& record) {
        record.reference_frames_complete = static_cast<std::uint32_t>(writer.frames_complete());
      });
    };
    report();
    source.run([&](v1::SimulatedFrame& simulated) {
      const std::uint64_t index = simulated.coarse().index();
      if (index >= writer.frames_complete()) {
        ResultFrame frame = read_result_frame(enhanced, index);
        const auto& positions = simulated.coarse().positions();
        if (positions.size() != frame.coarse.size() ||
            std::memcmp(positions.data(), frame.coarse.data(),
                        sizeof(float) * static_cast<std::size_t>(positions.size())) != 0) {
          throw_internal("the reference simulation's coarse mesh differs from the enhanced one's in frame " +
                         std::to_string(index));
        }
        frame.fine =
            Eigen::Map<const Positions>(simulated.fine().positions().data(), simulated.fine().positions_size() / 3, 3);
        writer.append(frame);
        report();
      }
      if (!simulated.checkpoint().empty() && index < writer.frames_complete()) {
        save_checkpoint(checkpoint_file, {index, simulated.checkpoint()});
      }
      return true;
    });
    writer.finish();
  }
  fs::rename(path, result);
}

}  // namespace pleat::coordinator
