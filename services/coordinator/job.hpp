// A job as a value: its states, and its record on disk.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/telemetry/trace.hpp"

namespace pleat::coordinator {

enum class JobState { kQueued, kRunning, kReference, kDone, kFailed, kCancelled };

/// "queued", "running", "reference", "done", "failed", "cancelled".
std::string_view to_string(JobState state);

/// Done, failed or cancelled: nothing changes any more.
bool has_ended(JobState state);

/// queued -> running -> [reference ->] done; failed and cancelled from every state that has not ended. A job that a
/// stopped coordinator left running or in reference may be queued again.
bool may_become(JobState from, JobState to);

struct JobRecord {
  std::string id;
  std::string scene_name;
  JobState state = JobState::kQueued;
  std::uint64_t order = 0;  ///< of creation, over the life of the data folder
  std::uint32_t frames = 0;
  std::uint32_t frames_complete = 0;
  bool reference = false;  ///< a tracked fine simulation was asked for
  std::uint32_t reference_frames_complete = 0;
  std::string error;   ///< one line, where failed
  std::string detail;  ///< "network", "fold" or "both"
  std::string model;   ///< empty with "fold"
  std::string device;
  std::string precision;
  std::uint32_t coarse_vertices = 0;
  std::uint32_t fine_vertices = 0;
  double wall_s = 0;  ///< of the pipeline, over all runs of the coordinator, without the reference
  std::uint32_t penetrations = 0;
  std::uint32_t self_intersections = 0;
  std::uint32_t frame_errors = 0;
  std::uint32_t pinched_frames = 0;   ///< with cloth between parts of an obstacle that left no room for it
  float pinch_depth_m = 0;            ///< how far the obstacle stayed behind its script for that at most, metres
  std::vector<std::string> warnings;  ///< of the simulation, a line each, each once
  std::string owner;                  ///< rpc::Caller::name; empty: made by a coordinator that knew no owners
  double created_s = 0;               ///< Unix time
  double ended_s = 0;                 ///< Unix time; 0: it has not, or that was not written down
  std::uint64_t bytes = 0;            ///< of its folder; before the end what is expected at most
  telemetry::TraceContext trace;      ///< of the call that made it; empty: made by a coordinator that knew none

  bool operator==(const JobRecord&) const = default;
};

/// 1 to 64 of letters, digits, '-', '_': safe as a folder's name.
bool is_valid_job_id(std::string_view id);

std::string to_json(const JobRecord& record);
/// Throws kDataLoss naming `origin` if the text is not a record of this version.
JobRecord job_from_json(const std::string& text, const std::string& origin);

}  // namespace pleat::coordinator
