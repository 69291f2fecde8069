#include "services/dataset/scenes.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>

#include "common/base/error.hpp"
#include "common/base/random.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/garment.hpp"

namespace pleat::dataset {
namespace {

constexpr int kMostSequences = 10'000;
constexpr double kDegree = std::numbers::pi / 180;

/// Equal on every platform, unlike the standard distributions.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  double uniform(double low, double high) { return low + (high - low) * unit_interval(engine_()); }
  std::size_t below(std::size_t count) { return static_cast<std::size_t>(uniform(0, static_cast<double>(count))); }

 private:
  std::mt19937_64 engine_;
};

/// Whether the garment is modelled as it hangs (y up) and not lying flat.
bool is_upright(const Topology& cloth) {
  const Eigen::RowVector3f size = cloth.rest_positions.colwise().maxCoeff() - cloth.rest_positions.colwise().minCoeff();
  return size.y() > 0.25f * size.maxCoeff();
}

/// The vertices that hold a cloth, along its upper rim. Of one that lies flat: boundary vertices within a hundredth of
/// its size of its smallest z, which becomes the top when it is tilted about x, along x. Of one that is upright: the
/// highest vertices that lie on a boundary, within a hundredth of its height, else all within that of its top.
std::vector<std::uint32_t> upper_edge(const Topology& cloth) {
  const Connectivity connectivity = build_connectivity(cloth.vertex_count(), cloth.faces);
  std::vector<char> boundary(static_cast<std::size_t>(cloth.vertex_count()), 0);
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 == kNone) boundary[edge.v0] = boundary[edge.v1] = 1;
  }
  const bool upright = is_upright(cloth);
  const Eigen::VectorXf depth =
      upright ? Eigen::VectorXf(-cloth.rest_positions.col(1)) : Eigen::VectorXf(cloth.rest_positions.col(2));
  const float size = depth.maxCoeff() - depth.minCoeff();
  std::vector<std::uint32_t> vertices;
  for (const bool on_boundary : {true, false}) {
    float top = std::numeric_limits<float>::max();
    const auto usable = [&](Eigen::Index v) { return !on_boundary || boundary[static_cast<std::size_t>(v)] != 0; };
    for (Eigen::Index v = 0; v < depth.size(); ++v) {
      if (usable(v)) top = std::min(top, depth[v]);
    }
    for (Eigen::Index v = 0; v < depth.size(); ++v) {
      if (usable(v) && depth[v] < top + 0.01f * size) vertices.push_back(static_cast<std::uint32_t>(v));
    }
    if (!vertices.empty()) break;
  }
  std::sort(vertices.begin(), vertices.end(),
            [&](std::uint32_t a, std::uint32_t b) { return cloth.rest_positions(a, 0) < cloth.rest_positions(b, 0); });
  return vertices;
}

/// Further vertices of an upper edge that has fewer than `count`: those next to the top.
void add_next_highest(const Topology& cloth, std::size_t count, std::vector<std::uint32_t>& edge) {
  const int axis = is_upright(cloth) ? 1 : 2;
  const float up = axis == 1 ? 1.0f : -1.0f;
  std::vector<std::uint32_t> others;
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(cloth.vertex_count()); ++v) {
    if (std::find(edge.begin(), edge.end(), v) == edge.end()) others.push_back(v);
  }
  std::stable_sort(others.begin(), others.end(), [&](std::uint32_t a, std::uint32_t b) {
    return up * cloth.rest_positions(a, axis) > up * cloth.rest_positions(b, axis);
  });
  for (const std::uint32_t v : others) {
    if (edge.size() >= count) return;
    edge.push_back(v);
  }
}

/// First `pitch` about x (the upper edge rises), then `roll` about z and `yaw` about y.
Eigen::Vector3d tilt(double pitch_deg, double roll_deg, double yaw_deg) {
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(yaw_deg * kDegree, Eigen::Vector3d::UnitY()) *
                                      Eigen::AngleAxisd(roll_deg * kDegree, Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(pitch_deg * kDegree, Eigen::Vector3d::UnitX());
  const Eigen::AngleAxisd axis_angle(rotation);
  return axis_angle.angle() * axis_angle.axis();
}

simulation::Scene draping_scene(const Topology& cloth, std::uint32_t held, Random& random) {
  simulation::Scene scene;
  scene.garment = cloth;
  scene.transform.rotation = tilt(random.uniform(0, 60), random.uniform(-20, 20), random.uniform(-180, 180));
  scene.transform.translation.y() = random.uniform(1.5, 2.0);
  simulation::Handle handle;
  handle.name = "held";
  handle.vertices = {held};
  handle.hard = true;
  scene.handles = {handle};
  return scene;
}

// Metres. The last of each are in the test split only: one size, and three of the places.
constexpr double kRadii[] = {0.10, 0.13, 0.20, 0.25, 0.16};
constexpr std::size_t kTrainingRadii = 4;
// Where the sphere starts: x, height, and the side of the cloth.
constexpr double kPlaces[][3] = {{-0.3, 1.4, 1},  {0.0, 1.2, 1},   {0.3, 1.4, 1},   {-0.2, 1.1, -1},
                                 {0.25, 1.3, -1}, {0.0, 1.45, -1}, {-0.35, 1.2, 1}, {0.15, 1.05, 1}};
constexpr std::size_t kTrainingPlaces = 5;

// index: in its split. Test sequences have the unseen size, an unseen place, or both, in turn.
simulation::Scene hitting_scene(const Topology& cloth, const std::vector<std::uint32_t>& edge, double duration_s,
                                std::size_t index, bool test, Random& random) {
  simulation::Scene scene;
  scene.garment = cloth;
  const bool upright = is_upright(cloth);
  if (!upright) scene.transform.rotation = tilt(90, 0, 0);
  scene.transform.translation.y() = 1.5;
  simulation::Handle handle;
  handle.name = "held";
  handle.vertices = upright ? edge : std::vector<std::uint32_t>{edge.front(), edge.back()};
  handle.hard = true;
  scene.handles = {handle};
  simulation::Obstacle sphere;
  sphere.name = "ball";
  const bool unseen_radius = test && index % 3 != 1, unseen_place = test && index % 3 != 0;
  const std::size_t places = std::size(kPlaces) - kTrainingPlaces;
  sphere.radius = kRadii[unseen_radius ? kTrainingRadii : index % kTrainingRadii];
  const auto& place =
      kPlaces[unseen_place ? kTrainingPlaces + index % places : (index / kTrainingRadii + index) % kTrainingPlaces];
  const double side = place[2];
  const double reach = random.uniform(0.5, 0.9) + sphere.radius;
  sphere.center = {place[0] + random.uniform(-0.03, 0.03), place[1] + random.uniform(-0.03, 0.03), side * reach};
  const double period = random.uniform(2.5, 4.0);
  const Eigen::Vector3d swing(random.uniform(-0.3, 0.3), random.uniform(-0.1, 0.1), -2 * side * reach);
  // Back and forth, at rest until the cloth hangs.
  for (int k = 0; 1.0 + k * period / 2 < duration_s + period; ++k) {
    simulation::KeyFrame key;
    key.time_s = 1.0 + k * period / 2;
    key.translation = k % 2 == 0 ? Eigen::Vector3d(Eigen::Vector3d::Zero()) : swing;
    sphere.motion.keys.push_back(key);
  }
  scene.obstacles = {sphere};
  return scene;
}

nlohmann::json to_array(const Eigen::Vector3d& vector) { return {vector.x(), vector.y(), vector.z()}; }

}  // namespace

SetSize set_size(const std::string& set, bool full) {
  if (set == "hitting") return {27, 8, full ? 1000 : 150};
  return {10, 3, full ? 400 : 150};
}

std::vector<SequencePlan> plan_sequences(const SceneOptions& options, std::vector<std::string>* notes) {
  if (std::max({options.train, options.test, options.extra}) > kMostSequences) {
    throw_invalid_argument("data set: at most " + std::to_string(kMostSequences) + " sequences of a kind");
  }
  if (options.train < 0 || options.test < 0 || options.extra < 0 || options.train + options.test + options.extra < 1) {
    throw_invalid_argument("data set: at least one sequence is needed");
  }
  if (options.frames < 2) throw_invalid_argument("data set: at least 2 frames per sequence are needed");
  if (options.set != "draping" && options.set != "hitting") {
    throw_invalid_argument("data set '" + options.set + "' is unknown; there are draping and hitting");
  }
  std::vector<std::string> unasked;
  const Topology cloth = read_garment(options.garment, notes != nullptr ? *notes : unasked, options.garment_scale);
  require_rest_lengths(cloth, options.garment.string());
  const simulation::Material material = simulation::read_material(options.material);
  std::vector<std::uint32_t> edge = upper_edge(cloth);
  const auto train = static_cast<std::size_t>(options.train), count = train + static_cast<std::size_t>(options.test),
             all = count + static_cast<std::size_t>(options.extra);
  if (options.set == "draping" && edge.size() < count) add_next_highest(cloth, count, edge);
  if (options.set == "draping" && edge.size() < count) {
    throw_invalid_argument("data set: " + std::to_string(count) + " sequences hang by a vertex each, but " +
                           options.garment.string() + " has only " + std::to_string(edge.size()));
  }
  Random random(options.seed);
  const std::vector<std::uint32_t> ordered_edge = edge;
  for (std::size_t i = edge.size(); i > 1; --i) std::swap(edge[i - 1], edge[random.below(i)]);

  // Of further sequences: vertices that nothing holds yet, then those of the training split again.
  std::vector<std::uint32_t> others = edge;
  others.erase(others.begin() + static_cast<std::ptrdiff_t>(std::min(train, edge.size())),
               others.begin() + static_cast<std::ptrdiff_t>(std::min(count, edge.size())));
  if (options.set == "draping" && all > count && others.empty()) {
    throw_invalid_argument("data set: the test split holds every vertex of the upper edge");
  }

  std::vector<SequencePlan> plans;
  for (std::size_t i = 0; i < all; ++i) {
    SequencePlan plan;
    const bool test = i >= train && i < count;
    const std::size_t in_split = test ? i - train : i < train ? i : i - static_cast<std::size_t>(options.test);
    plan.split = test ? "test" : "train";
    const std::string number = std::to_string(i);
    plan.name = options.set + "-" + std::string(number.size() < 2 ? 1 : 0, '0') + number;
    const double frame_time = simulation::Scene().frame_time_s;
    plan.scene = options.set == "draping"
                     ? draping_scene(cloth, i < count ? edge[i] : others[in_split % others.size()], random)
                     : hitting_scene(cloth, ordered_edge, options.frames * frame_time, in_split, test, random);
    plan.scene.name = plan.name;
    plan.scene.material = material;
    plan.scene.frames = options.frames;
    plan.scene.seed = options.seed;
    plan.tracked = options.tracked;
    if (!plan.tracked) plan.scene.tracking.frequency = 0;
    if (plan.tracked && options.springs) plan.scene.tracking = simulation::published_tracking();
    plan.scene_json = scene_to_json(plan.scene, options.garment, options.material);
    plans.push_back(std::move(plan));
  }
  return plans;
}

std::string scene_to_json(const simulation::Scene& scene, const std::filesystem::path& garment,
                          const std::filesystem::path& material) {
  nlohmann::ordered_json json;
  json["name"] = scene.name;
  json["garmentFile"] = "../garments/" + garment.filename().string();
  nlohmann::ordered_json placement;
  placement["translation"] = to_array(scene.transform.translation);
  const double angle = scene.transform.rotation.norm();
  if (angle > 0) {
    placement["axis"] = to_array(scene.transform.rotation / angle);
    placement["angleDeg"] = angle / kDegree;
  }
  json["placement"] = placement;
  json["materialFile"] = "../materials/" + material.filename().string();
  json["frameTimeS"] = scene.frame_time_s;
  json["stepsPerFrame"] = scene.steps_per_frame;
  json["frames"] = scene.frames;
  json["seed"] = std::to_string(scene.seed);  // 64-bit integers are strings in protobuf's JSON form
  if (scene.tracking.frequency > 0) json["tracking"]["frequency"] = scene.tracking.frequency;
  if (scene.tracking.spring > 0) json["tracking"]["spring"] = scene.tracking.spring;
  if (scene.tracking.two_level) json["tracking"]["twoLevel"] = true;
  for (const simulation::Handle& handle : scene.handles) {
    json["handles"].push_back({{"vertices", handle.vertices}, {"hard", handle.hard}});
  }
  for (const simulation::Obstacle& obstacle : scene.obstacles) {
    nlohmann::ordered_json entry;
    entry["name"] = obstacle.name;
    entry["sphere"] = {{"center", to_array(obstacle.center)}, {"radius", obstacle.radius}};
    for (const simulation::KeyFrame& key : obstacle.motion.keys) {
      entry["motion"].push_back({{"timeS", key.time_s}, {"translation", to_array(key.translation)}});
    }
    json["obstacles"].push_back(entry);
  }
  return json.dump();
}

}  // namespace pleat::dataset
