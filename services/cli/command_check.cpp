// `pleat check`: what is wrong or unusual with files, before anything is made of them.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/json.hpp"
#include "common/mesh/charts.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/garment.hpp"
#include "common/mesh/holes.hpp"
#include "common/mesh/mesh_file.hpp"
#include "services/cli/command.hpp"
#include "services/presentation/input/point_sequence.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/presentation/input/sequence_input.hpp"
#include "services/refinement/judge.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;

struct CheckOptions {
  std::vector<std::string> files;
  std::string rest;
  double scale = 1;
  bool json = false;
};

/// What was found in one file. A fault ends the command with an exit code, a note does not.
struct Findings {
  std::string file;
  std::vector<std::string> facts, notes, faults;
};

std::string extent(const Positions& positions) {
  const Eigen::RowVector3f size = positions.colwise().maxCoeff() - positions.colwise().minCoeff();
  char text[80];
  std::snprintf(text, sizeof text, "%.3g x %.3g x %.3g m", static_cast<double>(size.x()), static_cast<double>(size.y()),
                static_cast<double>(size.z()));
  return text;
}

/// Runs `body`; what it throws is a fault.
template <typename Body>
void guarded(Findings& findings, const Body& body) {
  try {
    body();
  } catch (const Error& error) {
    findings.faults.emplace_back(error.what());
  }
}

void check_mesh(const CheckOptions& options, Findings& findings) {
  const Topology mesh = read_mesh(findings.file, MeshUse::kObstacle);
  const Connectivity connectivity = build_connectivity(mesh.vertex_count(), mesh.faces);
  const auto rims = std::count_if(connectivity.edges.begin(), connectivity.edges.end(),
                                  [](const Edge& edge) { return edge.f1 == kNone; });
  findings.facts.push_back(std::to_string(mesh.vertex_count()) + " vertices, " + std::to_string(mesh.face_count()) +
                           " triangles, " + std::to_string(count_components(mesh.vertex_count(), mesh.faces)) +
                           " pieces, " + extent(static_cast<float>(options.scale) * mesh.rest_positions));
  findings.facts.push_back(rims == 0 ? "closed" : std::to_string(rims) + " edges on rims");
  if (const std::size_t pairs = count_self_intersections(mesh.rest_positions, mesh.faces); pairs > 0) {
    findings.faults.push_back(findings.file + ": " + std::to_string(pairs) +
                              " pairs of faces intersect; `pleat run --untangle` relaxes a garment until it is clean");
  }
  bool with_uv = false;
  guarded(findings, [&] { with_uv = read_mesh(findings.file, MeshUse::kGarment).uv_faces.rows() > 0; });
  if (!with_uv) {
    close_holes(mesh, false, findings.file, findings.notes);
    findings.facts.emplace_back("no material coordinates: good for an obstacle, not for a garment");
    return;
  }
  guarded(findings, [&] {
    const Topology garment = read_garment(findings.file, findings.notes, options.scale);
    const std::vector<std::uint32_t> charts = face_charts(garment);
    char ratio[32];
    std::snprintf(ratio, sizeof ratio, "%.3g", material_ratios(garment).median);
    findings.facts.push_back(std::to_string(charts.empty() ? 0 : *std::max_element(charts.begin(), charts.end()) + 1) +
                             " islands; edges are " + ratio + " times as long in space as in material coordinates");
    require_rest_lengths(garment, findings.file);
  });
}

void check_frames(const CheckOptions& options, Findings& findings) {
  if (options.rest.empty()) {
    const auto points = presentation::open_points(findings.file);
    findings.facts.push_back(std::to_string(points->frame_count()) + " frames of " +
                             std::to_string(points->point_count()) + " points, " + extent(points->positions(0)));
    if (!points->warning().empty()) findings.notes.push_back(points->warning());
    findings.notes.push_back(findings.file + ": with --rest MESH its frames are compared with the mesh");
    return;
  }
  const Topology rest = read_garment(options.rest, findings.notes, options.scale);
  const auto frames = presentation::open_frame_sequence(findings.file, rest);
  if (!frames->warning().empty()) findings.notes.push_back(frames->warning());
  for (std::size_t k = 0; k < frames->frame_count(); ++k) {
    const Positions frame = static_cast<float>(options.scale) * frames->positions(k);
    require_frame_of(frame, rest, findings.file + " frame " + std::to_string(k), options.rest);
  }
  findings.facts.push_back(std::to_string(frames->frame_count()) + " frames of " + std::to_string(rest.vertex_count()) +
                           " vertices, all of them frames of " + options.rest);
}

void check_file(const CheckOptions& options, Findings& findings) {
  const fs::path path = findings.file;
  std::error_code ignored;
  if (lower_extension(path) == ".json") {
    const v1::Scene scene =
        presentation::read_scene_file(path, {.frames = 0, .scale = options.scale, .notes = &findings.notes});
    findings.facts.push_back("scene of " + std::to_string(scene.frames()) + " frames, " +
                             std::to_string(scene.garment_mesh().rest_positions_size() / 3) + " vertices, " +
                             std::to_string(scene.obstacles_size()) + " obstacles");
  } else if (is_mesh_file(path) && fs::exists(path, ignored) && options.rest.empty()) {
    check_mesh(options, findings);
  } else {
    check_frames(options, findings);
  }
}

int check(const CheckOptions& options) {
  nlohmann::json report = nlohmann::json::array();
  std::size_t faults = 0;
  std::string first;
  for (const std::string& file : options.files) {
    Findings findings;
    findings.file = file;
    guarded(findings, [&] { check_file(options, findings); });
    faults += findings.faults.size();
    if (first.empty() && !findings.faults.empty()) first = findings.faults.front();
    report.push_back(
        {{"file", file}, {"facts", findings.facts}, {"notes", findings.notes}, {"faults", findings.faults}});
    if (options.json) continue;
    std::printf("%s\n", file.c_str());
    for (const std::string& fact : findings.facts) std::printf("  %s\n", fact.c_str());
    for (const std::string& note : findings.notes) std::printf("  note: %s\n", note.c_str());
    for (const std::string& fault : findings.faults) std::printf("  fault: %s\n", fault.c_str());
  }
  if (options.json) std::printf("%s\n", report.dump(2).c_str());
  std::fflush(stdout);
  if (faults == 0) return kExitDone;
  print_error("pleat", std::to_string(faults) + (faults == 1 ? " fault: " : " faults, the first: ") + first);
  return kExitWrongInput;
}

}  // namespace

std::vector<Command> add_check(CLI::App& root) {
  CLI::App* app = root.add_subcommand("check", "say what is wrong or unusual with garments, bodies, caches and scenes");
  const auto options = std::make_shared<CheckOptions>();
  app->add_option("files", options->files, "meshes, frames (as of `enhance --frames`), scenes")->required();
  app->add_option("--rest", options->rest, "the mesh that the files are frames of");
  app->add_option("--scale", options->scale, "metres per unit of garments and frames")
      ->capture_default_str()
      ->check(positive_number());
  app->add_flag("--json", options->json, "one JSON array: file, facts, notes, faults");
  return {{app, [options] { return check(*options); }}};
}

}  // namespace pleat::cli
