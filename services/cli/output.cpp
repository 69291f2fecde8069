#include "services/cli/output.hpp"

#include <cstdio>
#include <cstdlib>

#include "common/base/error.hpp"
#include "common/base/machine.hpp"
#include "common/base/own_file.hpp"
#include "common/base/terminal.hpp"
#include "common/rpc/trace.hpp"
#include "common/store/hdf5.hpp"
#include "services/cli/command.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/simulation/body/animated_body.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;

// The second of the page: in those of versions before its first.
constexpr std::string_view kReportMarks[] = {"\"format\": \"pleat.report\"",
                                             "<meta name=\"generator\" content=\"pleat.report\">",
                                             "<div class=\"brand\">\n    <svg viewBox=\"0 0 28 28\""};

bool has_bundle(const fs::path& folder) {
  std::error_code ignored;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, ignored))
    if (entry.path().extension() == ".pt") return true;
  return false;
}

void print_figures(const fs::path& folder, const presentation::ReportInput& input, const nlohmann::json& report) {
  std::printf("%zu frames, %lld -> %lld vertices, %.2f s, %.2f frames a second\n", input.frame_count,
              static_cast<long long>(input.coarse_topology.vertex_count()),
              static_cast<long long>(input.fine_topology.vertex_count()), report.value("wall_s", 0.0),
              report.value("frames_per_s", 0.0));
  for (const presentation::ReportStage& stage : input.stages) {
    const nlohmann::json& figures = report.at("stages").at(stage.name);
    std::printf("  %-14s median %8.2f ms   p95 %8.2f ms\n", stage.name.c_str(), figures.value("median_ms", 0.0),
                figures.value("p95_ms", 0.0));
  }
  std::printf("penetrations %llu, self-intersections %llu\n",
              static_cast<unsigned long long>(report.value("penetrations", 0ull)),
              static_cast<unsigned long long>(report.value("self_intersections", 0ull)));
  for (const char* name : {"result.h5", "report.json", "report.html"}) std::printf("%s\n", (folder / name).c_str());
}

}  // namespace

std::string shipped_or(const std::string& text, const std::string& folder) {
  std::error_code ignored;
  if (text.empty() || fs::path(text).has_parent_path() || fs::exists(text, ignored)) return text;
  const fs::path shipped = shipped_file(fs::path(folder) / (text.ends_with(".json") ? text : text + ".json"));
  return fs::exists(shipped, ignored) ? shipped.string() : text;
}

void print_notes(const std::vector<std::string>& notes) {
  if (verbosity() == Verbosity::kQuiet) return;
  const std::size_t most = verbosity() == Verbosity::kVerbose ? notes.size() : 3;
  for (std::size_t i = 0; i < notes.size() && i < most; ++i) {
    const bool more = i + 1 == most && notes.size() > most;
    std::fprintf(
        stderr, "%s %s\n", colored("note:", Color::kYellow).c_str(),
        more ? (std::to_string(notes.size() - i) + " more notes; `pleat check` prints all").c_str() : notes[i].c_str());
  }
}

std::string traceparent() {
  const char* given = std::getenv("TRACEPARENT");
  const auto known = given == nullptr ? std::nullopt : telemetry::parse_traceparent(given);
  const telemetry::TraceContext trace = known ? *known : telemetry::new_trace();
  say("trace " + trace.trace_id + (known ? " of $TRACEPARENT" : ""));
  return to_traceparent(trace);
}

void make_output_folder(const fs::path& folder) {
  make_writable_folder(folder);
  for (const char* name : {"result.h5", "result.h5.partial"}) {
    require_absent_or(hdf5::is_own(folder / name), folder / name);
  }
  for (const char* name : {"report.json", "report.html"}) require_replaceable(folder / name, kReportMarks);
}

int write_reports(const fs::path& folder, presentation::ReportSummary summary, bool json,
                  const std::vector<presentation::SceneBody>& bodies) {
  summary.git_revision = git_revision();
  summary.extra["machine"] = machine_info();
  presentation::ReportInput input = presentation::read_report_input(folder / "result.h5", std::move(summary));
  for (presentation::ReportObstacle& obstacle : input.obstacles) {
    for (const auto& [name, body] : bodies) {
      if (name != obstacle.shape.name) continue;
      obstacle.skin =
          std::make_shared<const presentation::ReportSkin>(presentation::ReportSkin{body->mesh(), body->motion()});
    }
  }
  presentation::write_report_json(input, folder / "report.json");
  presentation::write_report_html(input, folder / "report.html");
  const nlohmann::json report = presentation::make_report_json(input);
  if (json)
    std::printf("%s\n", report.dump(2).c_str());
  else
    print_figures(folder, input, report);
  std::fflush(stdout);
  const auto penetrations = report.value("penetrations", 0ull),
             intersections = report.value("self_intersections", 0ull);
  if (penetrations == 0 && intersections == 0) return kExitDone;
  print_error("pleat", (folder / "result.h5").string() + ": " + std::to_string(penetrations) + " penetrations and " +
                           std::to_string(intersections) + " self-intersections are left; of " +
                           std::to_string(input.frame_count) + " coarse frames " +
                           std::to_string(report.value("input_intersects", 0ull)) + " were not free of them");
  return kExitNotClean;
}

v1::Detail choose_detail(std::string& text, std::string& model) {
  if (model == "none") {
    if (!text.empty() && text != "none") throw_invalid_argument("--model none: --detail " + text + " is not none");
    text = model;
    model.clear();
  }
  const v1::Detail detail = checked_detail(detail_named(text), model, "--detail");
  if (!uses_network(detail) && !model.empty())
    throw_invalid_argument("--model " + model + ": --detail " + std::string(name_of(detail)) + " uses no bundle");
  return detail;
}

ModelChoice choose_model(const std::string& text) {
  ModelChoice choice;
  std::error_code ignored;
  if (text.empty()) {
    const fs::path folder = default_models_folder();
    if (!has_bundle(folder)) throw_not_found(folder.string() + ": no model bundle (.pt) there; name one with --model");
    return choice;
  }
  fs::path file = text;
  if (file.extension() != ".pt") file += ".pt";
  if (file.has_parent_path())
    choice.folder = file.parent_path();
  else if (fs::is_regular_file(default_models_folder() / file, ignored))
    file = default_models_folder() / file;
  else if (const fs::path other = shipped_file("models" / file); fs::is_regular_file(other, ignored)) {
    file = other;
    choice.folder = other.parent_path();
  } else {
    file = default_models_folder() / file;
  }
  if (!fs::is_regular_file(file, ignored)) throw_not_found(file.string() + ": no such model bundle");
  choice.name = file.stem().string();
  return choice;
}

}  // namespace pleat::cli
