#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "services/presentation/report/encode.hpp"
#include "services/presentation/report/report.hpp"
#include "services/presentation/report/upsampling.hpp"
#include "services/presentation/report/viewer_page.hpp"
#include "services/presentation/report/viewer_template.hpp"

namespace pleat::presentation {

namespace {

using nlohmann::json;

/// What lies in the page besides its code: one JSON object, and binary blobs that it names.
struct Payload {
  json meta = json::object();
  std::map<std::string, std::string> blobs;  ///< name -> base64
};

std::vector<std::uint32_t> words_of(const Faces& faces) { return {faces.data(), faces.data() + faces.size()}; }

template <class Matrix>
std::vector<std::uint32_t> bits_of(const Matrix& floats) {
  std::vector<std::uint32_t> words(static_cast<std::size_t>(floats.size()));
  std::memcpy(words.data(), floats.data(), words.size() * sizeof(std::uint32_t));
  return words;
}

void add_words(Payload& payload, const std::string& name, std::span<const std::uint32_t> words) {
  payload.blobs[name] = base64(deflate(byte_planes(words), 9));
}

json rounded(const std::vector<double>& values) {
  json out = json::array();
  for (const double value : values) out.push_back(std::round(value * 1e3) / 1e3);
  return out;
}

/// Adds the frames as blob `name` and returns their description.
json add_sequence(Payload& payload, const std::string& name, const std::function<Positions(std::size_t)>& frame,
                  std::size_t count, std::size_t stride, Eigen::Index vertices, const Faces& faces) {
  const QuantizedSequence sequence = quantize_sequence(frame, count, stride, vertices, faces, name);
  payload.blobs[name] = base64(sequence.deflated);
  json origin = json::array();
  for (const float value : sequence.origin) origin.push_back(value);
  return {{"blob", name},
          {"frames", sequence.frames},
          {"vertices", sequence.vertices},
          {"step", sequence.step},
          {"origin", std::move(origin)}};
}

constexpr float kSkinTolerance = 2e-4f;  // metres: a body that is farther from its motion waits for pinched cloth
constexpr double kMarkerArm = 0.25;      // metres from a joint to the points that say how it is turned

/// Three points of every joint: where it is, and kMarkerArm along the x and y axes of its turn since rest.
Positions joint_markers(const std::vector<body::RigidTransform>& rest, const std::vector<body::RigidTransform>& world) {
  Positions points(static_cast<Eigen::Index>(3 * world.size()), 3);
  for (std::size_t j = 0; j < world.size(); ++j) {
    const Eigen::Matrix3d turn = (world[j].rotation * rest[j].rotation.conjugate()).toRotationMatrix();
    const auto row = static_cast<Eigen::Index>(3 * j);
    points.row(row) = world[j].translation.transpose().cast<float>();
    for (int axis = 0; axis < 2; ++axis) {
      points.row(row + 1 + axis) = (world[j].translation + kMarkerArm * turn.col(axis)).transpose().cast<float>();
    }
  }
  return points;
}

/// Adds mesh, weights and joints to the obstacle's description, and the points of those frames in which it is not where
/// they say. Returns false, and adds nothing, if that is so in most frames.
bool add_skin(Payload& payload, json& out, const ReportObstacle& obstacle, const std::string& name, std::size_t count,
              std::size_t stride) {
  const body::SkinnedMesh& mesh = obstacle.skin->mesh;
  const body::Motion& motion = obstacle.skin->motion;
  const std::size_t joints = mesh.skeleton.size();
  const auto world = [&](std::size_t t) {
    return body::world_transforms(mesh.skeleton, motion.frames[std::min(t, motion.frames.size() - 1)]);
  };
  std::vector<std::size_t> elsewhere;  // frames
  json stored = json::array();         // among those of the page
  std::size_t frames = 0;
  for (std::size_t t = 0; t < count; t += stride, ++frames) {
    const Positions positions = obstacle.at(t).positions, skinned = body::skin(mesh, world(t), body::Skinning::kLinear);
    if (positions.rows() != skinned.rows()) return false;
    if ((positions - skinned).cwiseAbs().maxCoeff() <= kSkinTolerance) continue;
    elsewhere.push_back(t);
    stored.push_back(frames);
  }
  if (2 * elsewhere.size() > frames) return false;

  const std::vector<body::RigidTransform> rest = body::world_transforms(mesh.skeleton, body::rest_pose(mesh.skeleton));
  const auto of_joint = [&](std::size_t t) { return joint_markers(rest, world(t)); };
  const auto at_rest = [&](std::size_t) { return mesh.mesh.rest_positions; };
  const auto joints_at_rest = [&](std::size_t) { return joint_markers(rest, rest); };
  json& skin = out["skin"];
  skin["rest"] = add_sequence(payload, name + "_rest", at_rest, 1, 1, mesh.mesh.vertex_count(), obstacle.shape.faces);
  skin["joints_at_rest"] = add_sequence(payload, name + "_joints_at_rest", joints_at_rest, 1, 1,
                                        static_cast<Eigen::Index>(3 * joints), Faces());
  skin["joints"] =
      add_sequence(payload, name + "_joints", of_joint, count, stride, static_cast<Eigen::Index>(3 * joints), Faces());
  skin["influences"] = name + "_influences";
  skin["weights"] = name + "_weights";
  std::vector<std::uint32_t> influences, weights;
  for (Eigen::Index k = 0; k < mesh.joints.size(); ++k) {
    influences.push_back(mesh.joints.data()[k]);
    weights.push_back(static_cast<std::uint32_t>(std::lround(65535.0f * mesh.weights.data()[k])));
  }
  add_words(payload, name + "_influences", influences);
  add_words(payload, name + "_weights", weights);
  if (elsewhere.empty()) return true;
  out["sequence"] = add_sequence(
      payload, name, [&](std::size_t k) { return obstacle.at(elsewhere[k]).positions; }, elsewhere.size(), 1,
      mesh.mesh.vertex_count(), obstacle.shape.faces);
  out["sequence_frames"] = std::move(stored);
  return true;
}

json add_obstacle(Payload& payload, const ReportObstacle& obstacle, std::size_t index, std::size_t count,
                  std::size_t stride) {
  json out = {{"name", obstacle.shape.name}};
  if (obstacle.shape.faces.rows() == 0) {
    json centers = json::array();
    json radii = json::array();
    for (std::size_t t = 0; t < count; t += stride) {
      const ObstacleFrame frame = obstacle.at(t);
      for (int axis = 0; axis < 3; ++axis) centers.push_back(frame.center[axis]);
      radii.push_back(frame.radius);
    }
    out["centers"] = std::move(centers);
    out["radii"] = std::move(radii);
    return out;
  }
  const std::string name = "obstacle" + std::to_string(index);
  out["faces"] = name + "_faces";
  add_words(payload, name + "_faces", words_of(obstacle.shape.faces));
  if (obstacle.skin && add_skin(payload, out, obstacle, name, count, stride)) return out;
  const Eigen::Index vertices = count > 0 ? obstacle.at(0).positions.rows() : 0;
  out["sequence"] = add_sequence(
      payload, name, [&](std::size_t t) { return obstacle.at(t).positions; }, count, stride, vertices,
      obstacle.shape.faces);
  return out;
}

Payload make_payload(const ReportInput& input, const json& report, std::size_t stride) {
  Payload payload;
  json& meta = payload.meta;
  meta["report"] = report;
  meta["stride"] = stride;
  meta["stages"] = json::array();
  for (const ReportStage& stage : input.stages) {
    meta["stages"].push_back({{"name", stage.name}, {"ms", rounded(stage.ms)}});
  }
  meta["counts"] = json::array();
  for (const ReportCount& count : input.counts) {
    // The page marks and sums what is wrong with frames; these only say how they were made.
    if (count.name.starts_with("fold_")) continue;
    meta["counts"].push_back({{"name", count.name}, {"values", count.values}});
  }
  add_words(payload, "coarse_faces", words_of(input.coarse_topology.faces));
  add_words(payload, "fine_faces", words_of(input.fine_topology.faces));
  const std::size_t count = input.frame_count;
  meta["coarse"] = add_sequence(payload, "coarse", input.coarse, count, stride, input.coarse_topology.vertex_count(),
                                input.coarse_topology.faces);
  meta["enhanced"] = add_sequence(payload, "enhanced", input.enhanced, count, stride,
                                  input.fine_topology.vertex_count(), input.fine_topology.faces);
  if (input.reference) {
    meta["reference"] = add_sequence(payload, "reference", input.reference, count, stride,
                                     input.fine_topology.vertex_count(), input.fine_topology.faces);
  }
  if (const auto upsampling = find_upsampling(input.coarse_topology, input.fine_topology)) {
    add_words(payload, "parent_faces", upsampling->parent_face);
    add_words(payload, "barycentric", bits_of(upsampling->barycentric));
    meta["upsampling"] = {{"parent_faces", "parent_faces"}, {"barycentric", "barycentric"}};
  }
  meta["obstacles"] = json::array();
  for (std::size_t o = 0; o < input.obstacles.size(); ++o) {
    meta["obstacles"].push_back(add_obstacle(payload, input.obstacles[o], o, count, stride));
  }
  return payload;
}

}  // namespace

void write_report_html(const ReportInput& input, const std::filesystem::path& path, const ReportHtmlOptions& options) {
  if (input.frame_count == 0) throw_invalid_argument("a report needs at least one frame");
  const json report = make_report_json(input);
  // Quantised frames deflate to a fifth at best, and base64 adds a third: a stride below this one can't fit, and
  // starting here bounds the memory for long results.
  const auto vertices = static_cast<double>(input.coarse_topology.vertex_count() +
                                            input.fine_topology.vertex_count() * (input.reference ? 2 : 1));
  const double least_bytes = 6.0 * vertices * static_cast<double>(input.frame_count) / 5 * 4 / 3;
  auto stride =
      static_cast<std::size_t>(std::max(1.0, std::ceil(least_bytes / static_cast<double>(options.max_bytes))));
  for (;;) {
    const Payload payload = make_payload(input, report, stride);
    std::string data =
        "<script type=\"application/json\" id=\"pleat-meta\">" + script_safe(payload.meta) + "</script>\n";
    for (const auto& [name, text] : payload.blobs) {
      data += "<script type=\"application/octet-stream\" id=\"pleat-" + name + "\">" + text + "</script>\n";
    }
    const std::size_t bytes = viewer_template().size() + data.size();
    if (bytes > options.max_bytes) {
      if (stride >= input.frame_count) {
        throw Error(ErrorCode::kResourceExhausted, path.string() + ": one frame alone needs " + std::to_string(bytes) +
                                                       " bytes, the limit is " + std::to_string(options.max_bytes));
      }
      const double ratio = static_cast<double>(bytes) / static_cast<double>(options.max_bytes);
      stride = std::min(input.frame_count,
                        std::max(stride + 1, static_cast<std::size_t>(static_cast<double>(stride) * ratio)));
      continue;
    }
    write_whole_file(path, viewer_page(input.summary.title, "'none'", data));
    return;
  }
}

}  // namespace pleat::presentation
