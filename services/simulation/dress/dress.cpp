#include "services/simulation/dress/dress.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "common/base/error.hpp"
#include "common/mesh/garment.hpp"
#include "services/simulation/dress/bones.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::dress {
namespace {

using Eigen::Vector3d;

// The body begins as thin as that share of itself: flat skin would have no sides.
constexpr double kThinnest = 0.08;
constexpr double kGrid = 0.02;                // m, of the places where a garment is tried
constexpr double kLargest = 3;                // of the body's height: beyond, a garment is in another unit
constexpr double kSmallest = 0.03;            // likewise
constexpr double kOutward = 0.5;              // of the area: with less a garment is inside out
constexpr double kStill = 1e-4;               // m: a body that lags by less has its size
constexpr double kAir = 8;                    // kg/m3: cloth that is pushed stops when the push does
constexpr double kSliding = 0.1;              // friction of a growing body: cloth finds its place
constexpr double kHolding = 0.6;              // of a body that is there
constexpr double kFrame = 0.04;               // s
constexpr int kSteps = 4;                     // a frame
constexpr double kTight = 1.25, kTorn = 1.6;  // stretch that is worth a note, and that no garment is worn with

std::string number(double value, const char* format = "%.3g") {
  char text[32];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

double extent(const Positions& positions) {
  return static_cast<double>((positions.colwise().maxCoeff() - positions.colwise().minCoeff()).maxCoeff());
}

// The length over that in the material which 2 % of the edges are beyond, and where the most stretched of them is.
struct Stretch {
  double ratio = 1;
  Vector3d place = Vector3d::Zero();
};

Stretch most_stretched(const Topology& garment) {
  std::vector<std::pair<double, Vector3d>> ratios;
  for (Eigen::Index f = 0; f < garment.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3;
      const Vector3d a = garment.rest_positions.row(garment.faces(f, k)).cast<double>().transpose(),
                     b = garment.rest_positions.row(garment.faces(f, next)).cast<double>().transpose();
      const auto flat = static_cast<double>(
          (garment.uv.row(garment.uv_faces(f, k)) - garment.uv.row(garment.uv_faces(f, next))).norm());
      if (flat > 0) ratios.emplace_back((b - a).norm() / flat, (a + b) / 2);
    }
  }
  if (ratios.empty()) return {};
  const auto by_ratio = [](const auto& a, const auto& b) { return a.first < b.first; };
  std::sort(ratios.begin(), ratios.end(), by_ratio);
  return {ratios[ratios.size() * 98 / 100].first, ratios.back().second};
}

class Fitting {
 public:
  Fitting(const body::SkinnedMesh& body, const DressOptions& options, const std::function<void(std::size_t)>& on_frame)
      : body_(body), shrunk_(body), options_(options), on_frame_(on_frame) {}

  /// One garment on the body as it grows.
  Positions grow_into(const Garment& garment, std::vector<std::string>& notes) {
    check_size(garment);
    const Placement placement(garment.mesh.rest_positions, garment.mesh.faces, bones_of(body_));
    if (placement.opening_count() == 0) throw_invalid_argument(garment.name + ": has no opening that a body goes into");
    const auto place = placement.nearest_worn(options_.reach_m, kGrid);
    if (!place) fail_beside(garment);
    if (placement.outward_share(*place) < kOutward) {
      throw_invalid_argument(garment.name +
                             ": is inside out: " + number(100 * (1 - placement.outward_share(*place)), "%.0f") +
                             " % of its area looks at the body; turn its faces around");
    }
    if (place->norm() > 0) {
      notes.push_back(garment.name + ": moved by " + number(100 * place->norm()) + " cm, to where the body goes into " +
                      std::to_string(placement.enclosure(*place).pierced_count) + " of its " +
                      std::to_string(placement.opening_count()) + " openings");
    }
    simulation::Scene scene = scene_for({garment});
    scene.garment.rest_positions.rowwise() += place->cast<float>().transpose();
    scene.gravity.setZero();
    scene.wind.density = kAir;
    scene.contact.obstacle_friction = kSliding;
    for (int k = 0; k <= options_.grow_frames; ++k) {
      // Slowly at both ends.
      const double u = std::min(1.0, 1.15 * k / options_.grow_frames), share = u * u * (3 - 2 * u);
      scene.obstacles[0].animation.samples.push_back(shrunk_.at(kThinnest + (1 - kThinnest) * share));
    }
    Positions worn = run(std::move(scene));
    const Placement then(worn, garment.mesh.faces, bones_of(body_));
    if (then.enclosure(Vector3d::Zero()).pierced_count == 0) {
      throw Error(ErrorCode::kFailedPrecondition, garment.name + ": has slipped off the body while that grew");
    }
    return worn;
  }

  /// All of them on the body at its size, and into a pose.
  Positions settle(const std::vector<Garment>& garments) {
    simulation::Scene scene = scene_for(garments);
    scene.contact.obstacle_friction = kHolding;
    auto& samples = scene.obstacles[0].animation.samples;
    samples.assign(static_cast<std::size_t>(options_.settle_frames) + 1, shrunk_.at(1));
    samples.insert(samples.end(), options_.then.begin(), options_.then.end());
    return run(std::move(scene));
  }

 private:
  void check_size(const Garment& garment) const {
    const double height = extent(body_.mesh.rest_positions), size = extent(garment.mesh.rest_positions);
    if (size <= kLargest * height && size >= kSmallest * height) return;
    throw_invalid_argument(garment.name + ": is " + number(size) + " m large, the body " + number(height) +
                           " m; if it is in another unit, give --scale with its metres");
  }

  [[noreturn]] void fail_beside(const Garment& garment) const {
    const auto middle = [](const Positions& p) -> Vector3d {
      return (p.colwise().maxCoeff() + p.colwise().minCoeff()).cast<double>().transpose() / 2;
    };
    const Vector3d way = middle(garment.mesh.rest_positions) - middle(body_.mesh.rest_positions);
    throw_invalid_argument(garment.name + ": is not around the body, nor within " + number(100 * options_.reach_m) +
                           " cm of such a place; its middle is " + number(way.x(), "%.2f") + " m to the left, " +
                           number(way.y(), "%.2f") + " m above and " + number(way.z(), "%.2f") +
                           " m before the body's");
  }

  simulation::Scene scene_for(const std::vector<Garment>& garments) const {
    simulation::Scene scene;
    std::vector<Topology> meshes;
    for (const Garment& garment : garments) {
      meshes.push_back(garment.mesh);
      scene.name += (scene.name.empty() ? "" : ", ") + garment.name;
      scene.layers.push_back({garment.name, garment.mesh.face_count()});
    }
    scene.garment = join_garments(meshes);
    scene.untangle = true;
    scene.material = options_.material;
    scene.frame_time_s = kFrame;
    scene.steps_per_frame = kSteps;
    scene.threads = options_.threads;
    simulation::Obstacle body;
    body.name = "body";
    body.mesh = body_.mesh;
    body.animation.sample_time_s = kFrame;
    scene.obstacles.push_back(std::move(body));
    return scene;
  }

  /// Simulates all frames. Returns the cloth.
  Positions run(simulation::Scene scene) {
    scene.frames = static_cast<int>(scene.obstacles[0].animation.samples.size());
    const Positions wanted = scene.obstacles[0].animation.samples.back();
    const std::string name = scene.name;
    simulation::Simulation simulation(std::move(scene), simulation::Mode::kCoarse);
    simulation::SimulatedFrame frame = simulation.next_frame();
    for (int k = 1; k < simulation.scene().frames; ++k) {
      frame = simulation.next_frame();
      if (on_frame_) on_frame_(++done_);
    }
    Topology worn = simulation.coarse();
    worn.rest_positions = frame.coarse.positions;
    const double lag = static_cast<double>((frame.obstacles[0].positions - wanted).rowwise().norm().maxCoeff());
    const Stretch stretch = most_stretched(worn);
    if (lag > kStill || stretch.ratio > kTorn) {
      throw Error(ErrorCode::kFailedPrecondition,
                  name + ": is stuck: near joint '" + joint_at(stretch.place) + "' the cloth is stretched by " +
                      number(100 * (stretch.ratio - 1)) + " %" +
                      (lag > kStill ? ", and the body is " + number(1000 * lag) + " mm from its place" : "") +
                      "; the garment is too tight there");
    }
    return worn.rest_positions;
  }

  /// Name of the joint that the skin nearest to a place of the body at rest follows.
  std::string joint_at(const Vector3d& place) const {
    Eigen::Index vertex = 0, strongest = 0;
    (body_.mesh.rest_positions.cast<double>().rowwise() - place.transpose()).rowwise().squaredNorm().minCoeff(&vertex);
    body_.weights.row(vertex).maxCoeff(&strongest);
    return body_.skeleton.joints[body_.joints(vertex, strongest)].name;
  }

  const body::SkinnedMesh& body_;
  Shrunk shrunk_;
  const DressOptions& options_;
  const std::function<void(std::size_t)>& on_frame_;
  std::size_t done_ = 0;
};

void check_options(const DressOptions& o) {
  const auto require = [](bool ok, const char* what) {
    if (!ok) throw_invalid_argument(std::string("dress: ") + what);
  };
  require(o.reach_m >= 0 && o.reach_m <= 1, "the reach must be 0 to 1 m");
  require(o.grow_frames >= 5 && o.grow_frames <= 10'000, "the frames of growing must be 5 to 10,000");
  require(o.settle_frames >= 1 && o.settle_frames <= 10'000, "the frames of settling must be 1 to 10,000");
}

}  // namespace

Dressed dress(const std::vector<Garment>& garments, const body::SkinnedMesh& body, const DressOptions& options,
              const std::function<void(std::size_t)>& on_frame) {
  check_options(options);
  if (garments.empty()) throw_invalid_argument("dress: there are no garments");
  Dressed result;
  Fitting fitting(body, options, on_frame);
  std::vector<Garment> worn = garments;
  for (Garment& garment : worn) garment.mesh.rest_positions = fitting.grow_into(garment, result.notes);
  const Positions all = fitting.settle(worn);
  Eigen::Index first = 0;
  for (Garment& garment : worn) {
    garment.mesh.rest_positions = all.middleRows(first, garment.mesh.vertex_count());
    first += garment.mesh.vertex_count();
    const Stretch stretch = most_stretched(garment.mesh);
    result.stretch.push_back(stretch.ratio);
    if (stretch.ratio > kTight) {
      result.notes.push_back(garment.name + ": is tight, stretched by " + number(100 * (stretch.ratio - 1)) + " %");
    }
    result.garments.push_back(garment.mesh.rest_positions);
  }
  return result;
}

}  // namespace pleat::dress
