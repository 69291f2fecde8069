#include "services/dataset/scenes.hpp"

#include <algorithm>

#include "common/base/error.hpp"
#include "common/mesh/garment.hpp"
#include "services/dataset/dressed_sets.hpp"
#include "services/dataset/family_set.hpp"
#include "services/dataset/flat_sets.hpp"
#include "services/dataset/placement.hpp"
#include "services/dataset/random.hpp"
#include "services/dataset/scene_set.hpp"

namespace pleat::dataset {
namespace {

constexpr int kMostSequences = 10'000;
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

// The sets without a body: each sequence has the same number of frames.
std::vector<SequencePlan> plan_flat(const SceneOptions& options, const Topology& cloth) {
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
    const double duration = options.frames * simulation::Scene().frame_time_s;
    if (options.set == "draping") {
      plan.scene = draping_scene(cloth, i < count ? edge[i] : others[in_split % others.size()], random);
    } else if (options.set == "hitting") {
      plan.scene = hitting_scene(cloth, ordered_edge, duration, in_split, test, random);
    } else if (options.set == "sheet") {
      plan.scene = sheet_scene(cloth, duration, i, random);
    } else {
      plan.scene = disk_scene(cloth, i, random);
    }
    plan.scene.frames = options.frames;
    plans.push_back(std::move(plan));
  }
  return plans;
}

/// Of the shipped ones, its name.
std::string garment_of(const std::string& set, int rounds) {
  if (set == "sheet") return rounds <= 2 ? "sheet-289" : rounds == 3 ? "sheet" : "sheet-25";
  if (set == "disk") return "disk";
  if (set == "skirt") return "long-skirt";
  if (set == "tshirt") return "t-shirt";
  if (set == "pants") return "trousers";
  return "tablecloth";
}

}  // namespace

SetSize set_size(const std::string& set, bool full) {
  if (set == "hitting") return {27, 8, full ? 1000 : 150};
  if (set == "sheet") return {16, 4, full ? 200 : 60};
  if (set == "disk") return {8, 2, full ? 200 : 60};
  if (set == "skirt") return {5, 2, full ? 1000 : 150};
  if (is_dressed_set(set)) return {18, 2, full ? 1000 : 150};
  if (set == kFamily) return {96, 12, full ? 120 : 60};
  return {10, 3, full ? 400 : 150};
}

bool is_free_set(const std::string& set) { return set == "sheet" || set == "disk"; }

bool is_dressed_set(const std::string& set) { return set == "skirt" || set == "tshirt" || set == "pants"; }

SetDefaults set_defaults(const std::string& set, int rounds) {
  SetDefaults defaults;
  if (set == kFamily) return defaults;
  if (set == "disk") defaults.rounds = 3;
  // The knit of the other sets stretches so far that a skirt slips over the hips (deploy/garments/README.md).
  defaults.material = is_dressed_set(set) ? "materials/isotropic-medium.json" : "materials/gray-interlock.json";
  defaults.tracked = !is_free_set(set);
  if (set == "tshirt" || set == "pants") {
    defaults.rounds = 3;
    defaults.tracked = false;
  }
  if (rounds > 0) defaults.rounds = rounds;
  defaults.garment = "garments/" + garment_of(set, defaults.rounds) + ".obj";
  return defaults;
}

std::string numbered(const std::string& set, std::size_t number) {
  const std::string text = std::to_string(number);
  return set + "-" + std::string(text.size() < 2 ? 1 : 0, '0') + text;
}

void set_tracking(const SceneOptions& options, SequencePlan& plan) {
  if (options.frequency > 0 && (!plan.tracked || options.springs)) {
    throw_invalid_argument("data set: a frequency is for a fine cloth that follows the coarse one by averages");
  }
  if (!plan.tracked) plan.scene.tracking.frequency = 0;
  if (options.frequency > 0) plan.scene.tracking.frequency = options.frequency;
  if (plan.tracked && options.springs) plan.scene.tracking = simulation::published_tracking();
}

std::vector<SequencePlan> plan_sequences(const SceneOptions& options, std::vector<std::string>* notes) {
  std::vector<std::string> unasked;
  if (options.set == kOwnScenes) return plan_own_scenes(options, notes != nullptr ? *notes : unasked);
  if (std::max({options.train, options.test, options.extra}) > kMostSequences) {
    throw_invalid_argument("data set: at most " + std::to_string(kMostSequences) + " sequences of a kind");
  }
  if (options.train < 0 || options.test < 0 || options.extra < 0 || options.train + options.test + options.extra < 1) {
    throw_invalid_argument("data set: at least one sequence is needed");
  }
  if (options.frames < 2) throw_invalid_argument("data set: at least 2 frames per sequence are needed");
  if (options.set == kFamily) return plan_family(options);
  const bool dressed = is_dressed_set(options.set);
  if (options.set != "draping" && options.set != "hitting" && !is_free_set(options.set) && !dressed) {
    throw_invalid_argument("data set '" + options.set +
                           "' is unknown; there are draping, hitting, sheet, disk, skirt, tshirt, pants and family");
  }
  const Topology cloth = read_garment(options.garment, notes != nullptr ? *notes : unasked, options.garment_scale);
  require_rest_lengths(cloth, options.garment.string());
  const simulation::Material material = simulation::read_material(options.material);
  std::vector<SequencePlan> plans =
      dressed ? plan_dressed(options, cloth, notes != nullptr ? *notes : unasked) : plan_flat(options, cloth);
  for (std::size_t i = 0; i < plans.size(); ++i) {
    SequencePlan& plan = plans[i];
    plan.name = numbered(options.set, i);
    plan.scene.name = plan.name;
    plan.scene.material = material;
    plan.scene.seed = options.seed;
    plan.scene.subdivision_rounds = set_defaults(options.set, options.rounds).rounds;
    plan.tracked = options.tracked;
    set_tracking(options, plan);
    plan.scene_json = scene_to_json(plan, options.garment, options.material);
  }
  return plans;
}

}  // namespace pleat::dataset
