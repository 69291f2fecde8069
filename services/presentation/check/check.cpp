#include "services/presentation/check/check.hpp"

#include <algorithm>
#include <cstdio>
#include <map>
#include <utility>

#include "common/base/error.hpp"
#include "common/mesh/animated_mesh.hpp"
#include "common/mesh/charts.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/garment.hpp"
#include "common/mesh/holes.hpp"
#include "common/mesh/mesh_file.hpp"
#include "services/presentation/input/point_sequence.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/presentation/input/sequence_input.hpp"
#include "services/refinement/judge.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

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

/// Whether the mesh has material coordinates in all faces; if not, a fact says why.
bool is_garment(const std::string& file, Findings& findings) {
  std::string why = "no material coordinates";
  try {
    if (read_mesh(file, MeshUse::kGarment).uv_faces.rows() > 0) return true;
  } catch (const Error& error) {
    why = error.what();
  }
  findings.facts.push_back(why + ": good for an obstacle, not for a garment");
  return false;
}

/// Edges between two faces that are not neighbours in material coordinates.
std::size_t count_seams(const Topology& garment) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::pair<std::uint32_t, std::uint32_t>> seen;  // by vertices: uv
  std::size_t seams = 0;
  for (Eigen::Index f = 0; f < garment.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const int n = (k + 1) % 3;
      std::pair edge{garment.faces(f, k), garment.faces(f, n)}, uv{garment.uv_faces(f, k), garment.uv_faces(f, n)};
      if (edge.first > edge.second) {
        std::swap(edge.first, edge.second);
        std::swap(uv.first, uv.second);
      }
      const auto [other, is_new] = seen.try_emplace(edge, uv);
      if (!is_new && other->second != uv) ++seams;
    }
  }
  return seams;
}

std::string smallest_of(const std::vector<std::uint32_t>& charts) {
  std::map<std::uint32_t, std::size_t> faces;
  for (const std::uint32_t chart : charts) ++faces[chart];
  std::size_t least = charts.size();
  for (const auto& [chart, count] : faces) least = std::min(least, count);
  return "smallest island " + std::to_string(least) + " triangles";
}

/// The frames of a file that has its mesh with them, against that mesh as it is at first.
void check_own_frames(const std::string& file, const Topology& mesh, Findings& findings) {
  const auto frames = open_animated_mesh(file);
  if (frames->frame_count() == 1) return;
  char step[32];
  std::snprintf(step, sizeof step, "%.4g", frames->frame_time_s());
  findings.facts.push_back(std::to_string(frames->frame_count()) + " frames, " + step + " s apart");
  for (std::size_t k = 0; k < frames->frame_count(); ++k)
    require_frame_of(frames->positions(k), mesh, file + " frame " + std::to_string(k), "its first frame");
}

void check_mesh(const std::string& file, const CheckOptions& options, Findings& findings) {
  const Topology mesh = read_mesh(file, MeshUse::kObstacle);
  const Connectivity connectivity = build_connectivity(mesh.vertex_count(), mesh.faces);
  const auto rims = std::count_if(connectivity.edges.begin(), connectivity.edges.end(),
                                  [](const Edge& edge) { return edge.f1 == kNone; });
  findings.facts.push_back(std::to_string(mesh.vertex_count()) + " vertices, " + std::to_string(mesh.face_count()) +
                           " triangles, " + std::to_string(count_components(mesh.vertex_count(), mesh.faces)) +
                           " pieces, " + extent(static_cast<float>(options.scale) * mesh.rest_positions));
  findings.facts.push_back(rims == 0 ? "closed" : std::to_string(rims) + " edges on rims");
  const std::size_t pairs = refinement::count_self_intersections(mesh.rest_positions, mesh.faces);
  const std::string intersecting = file + ": " + std::to_string(pairs) + " pairs of faces intersect";
  if (is_animated_mesh_file(file)) guarded(findings, [&] { check_own_frames(file, mesh, findings); });
  if (!is_garment(file, findings)) {
    if (pairs > 0) findings.notes.push_back(intersecting);
    close_holes(mesh, false, file, findings.notes);
    return;
  }
  if (pairs > 0) {
    findings.faults.push_back(intersecting + "; `pleat run --untangle` relaxes a garment until it is clean");
  }
  guarded(findings, [&] {
    const Topology garment = read_garment(file, findings.notes, options.scale);
    const std::vector<std::uint32_t> charts = face_charts(garment);
    char ratio[32];
    std::snprintf(ratio, sizeof ratio, "%.3g", material_ratios(garment).median);
    findings.facts.push_back(std::to_string(count_seams(garment)) + " edges on seams, " + smallest_of(charts));
    findings.facts.push_back(std::to_string(charts.empty() ? 0 : *std::max_element(charts.begin(), charts.end()) + 1) +
                             " islands; edges are " + ratio + " times as long in space as in material coordinates");
    require_rest_lengths(garment, file);
  });
}

void check_frames(const std::string& file, const CheckOptions& options, Findings& findings) {
  if (options.rest.empty()) {
    const auto points = open_points(file);
    findings.facts.push_back(std::to_string(points->frame_count()) + " frames of " +
                             std::to_string(points->point_count()) + " points, " + extent(points->positions(0)));
    if (!points->warning().empty()) findings.notes.push_back(points->warning());
    findings.notes.push_back(file + ": with --rest MESH its frames are compared with the mesh");
    return;
  }
  const Topology rest = read_garment(options.rest, findings.notes, options.scale);
  const auto frames = open_frame_sequence(file, rest);
  if (!frames->warning().empty()) findings.notes.push_back(frames->warning());
  for (std::size_t k = 0; k < frames->frame_count(); ++k) {
    const Positions frame = static_cast<float>(options.scale) * frames->positions(k);
    require_frame_of(frame, rest, file + " frame " + std::to_string(k), options.rest);
  }
  findings.facts.push_back(std::to_string(frames->frame_count()) + " frames of " + std::to_string(rest.vertex_count()) +
                           " vertices, all of them frames of " + options.rest);
}

void check_scene(const std::string& file, const CheckOptions& options, Findings& findings) {
  const v1::Scene scene = read_scene_file(file, {.frames = 0, .scale = options.scale, .notes = &findings.notes});
  findings.facts.push_back("scene of " + std::to_string(scene.frames()) + " frames, " +
                           std::to_string(scene.garment_mesh().rest_positions_size() / 3) + " vertices, " +
                           std::to_string(scene.obstacles_size()) + " obstacles");
}

}  // namespace

Findings check_file(const std::string& file, const CheckOptions& options) {
  Findings findings;
  guarded(findings, [&] {
    std::error_code ignored;
    if (lower_extension(file) == ".json") {
      check_scene(file, options, findings);
    } else if (is_mesh_file(file) && fs::exists(file, ignored) && options.rest.empty()) {
      check_mesh(file, options, findings);
    } else {
      check_frames(file, options, findings);
    }
  });
  return findings;
}

}  // namespace pleat::presentation
