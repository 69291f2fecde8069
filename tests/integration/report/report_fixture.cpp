// report_fixture DIR [frames] [plain]: a small result.h5 of a cloth that sinks over a sphere, made from formulas, and
// its report.json and report.html. With `plain` it has no reference, and a skinned pole beside it. Material for the
// browser test and for work on the viewer: nothing is simulated.
#include <cmath>
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>

#include "common/base/error.hpp"
#include "common/mesh/obj.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/result.hpp"
#include "services/presentation/report/report.hpp"

namespace {

using pleat::Positions;

constexpr float kSphereRadius = 0.30f;
constexpr double kFrameTime = 0.04;

/// The surface at `rest` (flat, centred at the origin): a dome over the sphere whose rim hangs in `waves` folds, with
/// `fine_detail` metres of short wrinkles on top.
Positions drape(const Positions& rest, float progress, float fine_detail) {
  Positions out(rest.rows(), 3);
  const Eigen::RowVector3f middle = 0.5f * (rest.colwise().maxCoeff() + rest.colwise().minCoeff());
  for (Eigen::Index v = 0; v < rest.rows(); ++v) {
    const Eigen::RowVector3f p = rest.row(v) - middle;
    const float radius = std::hypot(p.x(), p.z());
    const float angle = std::atan2(p.z(), p.x());
    const float cap = 1.02f * kSphereRadius;
    const float arc = std::min(radius, cap * 1.2f) / cap * progress;
    const float beyond = std::max(0.0f, radius - cap * 1.2f);
    const float lean = 1.2f * progress;
    const float fold = progress * std::min(1.0f, 2.5f * beyond) * 0.10f * std::sin(7.0f * angle + 0.4f);
    const float dome = progress > 1e-3f ? cap / progress * std::sin(arc) : radius;
    const float flat = progress > 1e-3f ? dome + beyond * std::cos(lean) : radius;
    const float drop = (progress > 1e-3f ? cap / progress * (1 - std::cos(arc)) : 0.0f) + beyond * std::sin(lean);
    const float wrinkle = fine_detail * progress *
                          (std::sin(31.0f * angle + 9.0f * radius) * std::min(1.0f, 3.0f * radius) +
                           0.6f * std::sin(60.0f * p.x() + 8.0f * std::sin(9.0f * p.z())));
    const float ring = flat + fold + wrinkle;
    out.row(v) = Eigen::RowVector3f(ring * std::cos(angle), 0.9f * cap + cap * 0.12f - drop + 0.4f * wrinkle,
                                    ring * std::sin(angle));
  }
  return out;
}

float stage_time(std::size_t stage, std::size_t frame) {
  static constexpr float kBase[] = {2.6f, 0.4f, 5.1f, 0.3f, 3.2f};
  const float noise = std::fmod(0.618034f * static_cast<float>(frame * 7 + stage * 3), 1.0f);
  return kBase[stage] * (0.9f + 0.25f * noise + (frame % 37 == 20 ? 0.8f : 0.0f));
}

/// A pole of 0.8 m beside the cloth that bends at half its height.
pleat::presentation::ReportSkin bending_pole(std::size_t frames) {
  pleat::presentation::ReportSkin skin;
  auto& [mesh, motion] = skin;
  mesh.skeleton.joints = {{"foot", -1, {0.7, 0, 0}}, {"knee", 0, {0, 0.4, 0}}};
  mesh.mesh.rest_positions.resize(9, 3);
  mesh.joints.setZero(9, pleat::body::kInfluences);
  mesh.weights.setZero(9, pleat::body::kInfluences);
  for (Eigen::Index v = 0; v < 9; ++v) {
    const float angle = 2.0944f * static_cast<float>(v % 3);
    const Eigen::Index ring = v / 3;
    mesh.mesh.rest_positions.row(v) << 0.7f + 0.05f * std::cos(angle), 0.4f * static_cast<float>(ring),
        0.05f * std::sin(angle);
    mesh.joints(v, 0) = 1;
    mesh.weights(v, 0) = 0.5f * static_cast<float>(ring);
    mesh.weights(v, 1) = 1 - mesh.weights(v, 0);
  }
  mesh.mesh.faces.resize(12, 3);
  for (std::uint32_t k = 0; k < 6; ++k) {
    const std::uint32_t a = k / 3 * 3 + k % 3, b = k / 3 * 3 + (k + 1) % 3;
    mesh.mesh.faces.row(2 * k) << a, a + 3, b;
    mesh.mesh.faces.row(2 * k + 1) << b, a + 3, b + 3;
  }
  motion.skeleton = mesh.skeleton;
  motion.frame_time_s = kFrameTime;
  for (std::size_t t = 0; t < frames; ++t) {
    pleat::body::Pose pose = pleat::body::rest_pose(mesh.skeleton);
    const double angle = 1.5707963 * static_cast<double>(t) / static_cast<double>(frames - 1);
    pose.rotations[1] = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ());
    motion.frames.push_back(pose);
  }
  return skin;
}

void make(const std::filesystem::path& folder, std::size_t frames, bool plain) {
  const pleat::Topology coarse = pleat::read_obj("deploy/garments/tablecloth.obj");
  const pleat::Subdivision subdivision = pleat::subdivide(coarse);
  pleat::ResultOptions options;
  options.topology = {coarse, subdivision.fine, subdivision.feature_vertices};
  options.frames = frames;
  options.frame_time_s = kFrameTime;
  options.model = "synthetic";
  options.has_fine = !plain;
  options.obstacles = {{"ball", {}}};
  options.obstacle_vertices = {0};
  const auto pole = std::make_shared<const pleat::presentation::ReportSkin>(bending_pole(frames));
  if (plain) {
    options.obstacles.push_back({"pole", pole->mesh.mesh.faces});
    options.obstacle_vertices.push_back(pole->mesh.mesh.vertex_count());
  }
  options.stages = {"simulation", "to_image", "superres", "to_mesh", "refinement"};
  options.counts = {"penetrations", "self_intersections"};
  std::filesystem::create_directories(folder);
  pleat::ResultWriter writer(folder / "result.h5", options);
  for (std::size_t t = 0; t < frames; ++t) {
    const float share = static_cast<float>(t) / static_cast<float>(std::max<std::size_t>(1, frames - 1));
    const float progress = share * share * (3 - 2 * share);
    pleat::ResultFrame frame;
    frame.time_s = kFrameTime * static_cast<double>(t);
    frame.coarse = drape(coarse.rest_positions, progress, 0);
    frame.enhanced = drape(subdivision.fine.rest_positions, progress, 0.006f);
    if (!plain) frame.fine = drape(subdivision.fine.rest_positions, progress, 0.0075f);
    pleat::ObstacleFrame ball;
    ball.name = "ball";
    ball.center = Eigen::Vector3f(0, 0.02f * std::sin(6.28f * share), 0);
    ball.radius = kSphereRadius;
    frame.obstacles = {ball};
    if (plain) {
      pleat::ObstacleFrame moved;
      moved.name = "pole";
      moved.positions =
          pleat::body::skin(pole->mesh, pleat::body::world_transforms(pole->mesh.skeleton, pole->motion.frames[t]),
                            pleat::body::Skinning::kLinear);
      if (t == 10) moved.positions.col(1).array() += 0.25f;  // not where its joints say
      frame.obstacles.push_back(moved);
    }
    for (std::size_t s = 0; s < options.stages.size(); ++s) frame.stages_ms.push_back(stage_time(s, t));
    frame.counts = {0, 0};
    writer.append(frame);
  }
  writer.finish();

  pleat::presentation::ReportSummary summary;
  summary.title = "Sheet over a ball";
  summary.precision = "bfloat16";
  summary.wall_s = 0.0131 * static_cast<double>(frames);
  pleat::presentation::ReportInput input = pleat::presentation::read_report_input(folder / "result.h5", summary);
  if (plain) input.obstacles[1].skin = pole;
  pleat::presentation::write_report_json(input, folder / "report.json");
  pleat::presentation::write_report_html(input, folder / "report.html");
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::cerr << "usage: report_fixture DIR [frames] [plain]\n";
    return 2;
  }
  try {
    make(argv[1], argc > 2 ? std::stoul(argv[2]) : 40, argc > 3 && std::string(argv[3]) == "plain");
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
  return 0;
}
