#include "services/coordinator/job.hpp"

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::coordinator {
namespace {

constexpr int kRecordVersion = 1;

constexpr std::array<std::pair<JobState, std::string_view>, 6> kNames{{{JobState::kQueued, "queued"},
                                                                       {JobState::kRunning, "running"},
                                                                       {JobState::kReference, "reference"},
                                                                       {JobState::kDone, "done"},
                                                                       {JobState::kFailed, "failed"},
                                                                       {JobState::kCancelled, "cancelled"}}};

JobState state_from(const std::string& name) {
  for (const auto& [state, text] : kNames) {
    if (text == name) return state;
  }
  throw_data_loss("unknown state '" + name + "'");
}

}  // namespace

std::string_view to_string(JobState state) {
  for (const auto& [candidate, text] : kNames) {
    if (candidate == state) return text;
  }
  return "unknown";
}

bool has_ended(JobState state) {
  return state == JobState::kDone || state == JobState::kFailed || state == JobState::kCancelled;
}

bool may_become(JobState from, JobState to) {
  if (has_ended(from)) return false;
  switch (to) {
    case JobState::kFailed:
    case JobState::kCancelled:
      return true;
    case JobState::kQueued:
      return from == JobState::kRunning || from == JobState::kReference;
    case JobState::kRunning:
      return from == JobState::kQueued;
    case JobState::kReference:
    case JobState::kDone:
      return from == JobState::kRunning || (from == JobState::kReference && to == JobState::kDone);
  }
  return false;
}

bool is_valid_job_id(std::string_view id) {
  return !id.empty() && id.size() <= 64 && std::all_of(id.begin(), id.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
  });
}

std::string to_json(const JobRecord& record) {
  const nlohmann::ordered_json json{{"format", "pleat.job"},
                                    {"version", kRecordVersion},
                                    {"id", record.id},
                                    {"scene_name", record.scene_name},
                                    {"state", to_string(record.state)},
                                    {"order", record.order},
                                    {"frames", record.frames},
                                    {"frames_complete", record.frames_complete},
                                    {"reference", record.reference},
                                    {"reference_frames_complete", record.reference_frames_complete},
                                    {"error", record.error},
                                    {"detail", record.detail},
                                    {"model", record.model},
                                    {"device", record.device},
                                    {"precision", record.precision},
                                    {"coarse_vertices", record.coarse_vertices},
                                    {"fine_vertices", record.fine_vertices},
                                    {"wall_s", record.wall_s},
                                    {"penetrations", record.penetrations},
                                    {"self_intersections", record.self_intersections},
                                    {"frame_errors", record.frame_errors},
                                    {"pinched_frames", record.pinched_frames},
                                    {"pinch_depth_m", record.pinch_depth_m},
                                    {"warnings", record.warnings},
                                    {"owner", record.owner},
                                    {"created_s", record.created_s},
                                    {"ended_s", record.ended_s},
                                    {"bytes", record.bytes},
                                    {"traceparent", record.trace.empty() ? "" : to_traceparent(record.trace)},
                                    {"tracestate", record.trace.state}};
  // Messages may quote what a client sent: what is not UTF-8 must not stop a record from being written.
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

JobRecord job_from_json(const std::string& text, const std::string& origin) {
  try {
    const auto json = nlohmann::json::parse(text);
    if (json.at("format") != "pleat.job" || json.at("version") != kRecordVersion) {
      throw_data_loss("not a job record of version " + std::to_string(kRecordVersion));
    }
    JobRecord record;
    json.at("id").get_to(record.id);
    json.at("scene_name").get_to(record.scene_name);
    record.state = state_from(json.at("state").get<std::string>());
    json.at("order").get_to(record.order);
    json.at("frames").get_to(record.frames);
    json.at("frames_complete").get_to(record.frames_complete);
    json.at("reference").get_to(record.reference);
    json.at("reference_frames_complete").get_to(record.reference_frames_complete);
    json.at("error").get_to(record.error);
    record.detail = json.value("detail", "network");  // older records have none
    json.at("model").get_to(record.model);
    json.at("device").get_to(record.device);
    json.at("precision").get_to(record.precision);
    json.at("coarse_vertices").get_to(record.coarse_vertices);
    json.at("fine_vertices").get_to(record.fine_vertices);
    json.at("wall_s").get_to(record.wall_s);
    json.at("penetrations").get_to(record.penetrations);
    json.at("self_intersections").get_to(record.self_intersections);
    json.at("frame_errors").get_to(record.frame_errors);
    record.pinched_frames = json.value("pinched_frames", 0U);  // older records have neither of these
    record.pinch_depth_m = json.value("pinch_depth_m", 0.0F);
    record.warnings = json.value("warnings", record.warnings);
    record.owner = json.value("owner", std::string());
    record.created_s = json.value("created_s", 0.0);
    record.ended_s = json.value("ended_s", 0.0);
    record.bytes = json.value("bytes", std::uint64_t{0});
    if (auto trace = telemetry::parse_traceparent(json.value("traceparent", std::string()))) {
      record.trace = std::move(*trace);
      record.trace.state = json.value("tracestate", std::string());
    }
    if (!is_valid_job_id(record.id)) throw_data_loss("bad job id");
    return record;
  } catch (const std::exception& e) {
    throw_data_loss(origin + ": " + e.what());
  }
}

}  // namespace pleat::coordinator
