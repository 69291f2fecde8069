#include "services/dataset/family_set.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <optional>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "services/dataset/family_garments.hpp"
#include "services/dataset/flat_sets.hpp"
#include "services/dataset/materials.hpp"
#include "services/dataset/placement.hpp"
#include "services/dataset/random.hpp"

namespace pleat::dataset {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using simulation::Scene;
constexpr double kPi = std::numbers::pi;

constexpr int kAttempts = 6;                       // at a start that is clean
constexpr double kHeight = 1.5;                    // m, of the middle of a cloth that hangs
constexpr double kBumps = 0.15;                    // edges
constexpr double kClear = 0.02;                    // m, between cloth and what it drops onto
constexpr double kGround = 4, kGroundDepth = 0.3;  // m
constexpr int kSteps[] = {3, 4, 4, 6, 8};
constexpr double kMostDamping = 0.005;  // s
constexpr int kStepsOfHits = 8;         // at least
constexpr double kWayOfStep = 0.1;      // edges: of what hits: about a fine edge in a fine step
constexpr double kFastest = 1.6;        // m/s, of what shakes

enum class Motion { kHangs, kDrops, kIsHit, kBlown, kShaken, kTwisted, kWorn };
// Flat ones and rings; the first of any few differ.
constexpr Motion kFlatMotions[] = {Motion::kHangs,  Motion::kDrops, Motion::kIsHit, Motion::kBlown,
                                   Motion::kShaken, Motion::kHangs, Motion::kIsHit, Motion::kTwisted};
constexpr Motion kRingMotions[] = {Motion::kWorn,    Motion::kShaken, Motion::kIsHit, Motion::kBlown,
                                   Motion::kTwisted, Motion::kWorn,   Motion::kDrops};

using Vertices = std::vector<std::uint32_t>;

/// One sequence in the making.
class FamilyScene {
 public:
  FamilyScene(const FamilyGarment& garment, const simulation::Material& material, double duration_s, Random& random)
      : garment_(garment), duration_s_(duration_s), random_(random) {
    scene.material = material;
    const Positions& rest = garment.mesh.rest_positions;
    const Eigen::RowVector3f low = rest.colwise().minCoeff(), high = rest.colwise().maxCoeff();
    middle_ = 0.5 * (low + high).transpose().cast<double>();
    extent_ = (high - low).transpose().cast<double>();
    size_ = extent_.maxCoeff();
    scene.garment = garment.mesh;
    scene.perturbation_m = kBumps * garment.edge;
  }

  void move(Motion motion) {
    scene.steps_per_frame = kSteps[random_.below(std::size(kSteps))];
    if (motion == Motion::kIsHit) scene.steps_per_frame = std::max(scene.steps_per_frame, kStepsOfHits);
    switch (motion) {
      case Motion::kHangs:
        return hang(held_points(1 + random_.below(3)), random_.uniform(0, 80));
      case Motion::kDrops:
        return drop();
      case Motion::kIsHit:
        hang(held_part(), random_.uniform(0, 10));
        return hit();
      case Motion::kBlown:
        hang(held_part(), random_.uniform(0, 30));
        return blow();
      case Motion::kShaken:
        hang(held_part(), random_.uniform(0, 40));
        return shake();
      case Motion::kTwisted:
        return twist();
      case Motion::kWorn:
        return wear();
    }
  }

  Scene scene;

 private:
  Vector3d rest(std::uint32_t v) const { return garment_.mesh.rest_positions.row(v).transpose().cast<double>(); }
  /// m/s, of things that push.
  double fastest() const { return kWayOfStep * garment_.edge * scene.steps_per_frame / scene.frame_time_s; }
  double gap(std::uint32_t a, std::uint32_t b) const { return (rest(a) - rest(b)).norm(); }
  /// Of the border that holds: a ring's upper one.
  const Vertices& border() const { return garment_.borders.front(); }

  /// `count` vertices of the border, each as far as may be from those before it.
  Vertices held_points(std::size_t count) {
    Vertices held{border()[random_.below(border().size())]};
    while (held.size() < count) {
      const auto farthest = [&](std::uint32_t v) {
        double least = 1e300;
        for (const std::uint32_t h : held) least = std::min(least, gap(v, h));
        return least;
      };
      held.push_back(*std::max_element(border().begin(), border().end(),
                                       [&](auto a, auto b) { return farthest(a) < farthest(b); }));
    }
    return held;
  }

  /// A stretch of the border around one of its vertices, `share` of its length.
  Vertices held_stretch(std::uint32_t around, double share) const {
    const auto at = static_cast<std::size_t>(std::find(border().begin(), border().end(), around) - border().begin());
    const std::size_t count = border().size(), half = static_cast<std::size_t>(share * static_cast<double>(count) / 2);
    Vertices held;
    for (std::size_t k = 0; k <= 2 * half; ++k) held.push_back(border()[(at + count - half + k) % count]);
    std::sort(held.begin(), held.end());
    held.erase(std::unique(held.begin(), held.end()), held.end());
    return held;
  }

  /// What a cloth that is hit or blown hangs by: a ring by its whole rim or a part of it; a flat one by a stretch of
  /// its border or by two of its vertices.
  Vertices held_part() {
    if (garment_.ring) {
      if (random_.below(3) > 0) return border();
      return held_stretch(held_points(1)[0], random_.uniform(0.2, 0.5));
    }
    if (random_.below(2) == 0) return held_stretch(held_points(1)[0], random_.uniform(0.1, 0.25));
    // Nearer to each other than they might be: some slack.
    const Vertices ends = held_points(2);
    Vertices held{ends[0]};
    for (const std::uint32_t v : border()) {
      if (gap(v, ends[0]) > 0.4 * size_ && gap(v, ends[0]) < 0.8 * size_) {
        held.push_back(v);
        break;
      }
    }
    if (held.size() < 2) held.push_back(ends[1]);
    return held;
  }

  simulation::Handle& hold(Vertices vertices) {
    simulation::Handle handle;
    handle.name = "held" + std::to_string(scene.handles.size());
    handle.vertices = std::move(vertices);
    handle.hard = true;
    scene.handles.push_back(std::move(handle));
    return scene.handles.back();
  }

  void place(const Matrix3d& rotation, const Vector3d& middle) {
    const Eigen::AngleAxisd turn(rotation);
    scene.transform.rotation = turn.angle() * turn.axis();
    scene.transform.translation = middle - rotation * middle_;
    rotation_ = rotation;
  }
  Vector3d placed(const Vector3d& p) const { return rotation_ * p + scene.transform.translation; }

  Matrix3d heading() { return Eigen::AngleAxisd(random_.uniform(-kPi, kPi), Vector3d::UnitY()).toRotationMatrix(); }

  /// Held where `held` is highest, leaning by `lean` degrees from the vertical: 90 is level.
  void hang(const Vertices& held, double lean) {
    hold(held);
    if (garment_.ring) return place(heading(), {0, kHeight, 0});
    Vector3d top = Vector3d::Zero();
    for (const std::uint32_t v : held) top += rest(v);
    Vector3d up = top / static_cast<double>(held.size()) - middle_;
    up.y() = 0;
    if (up.norm() < 1e-3 * size_) up = Vector3d::UnitX();
    up.normalize();
    // The cloth's own up and normal become the world's up and a horizontal.
    Matrix3d cloth, world;
    cloth << up, Vector3d::UnitY(), up.cross(Vector3d::UnitY());
    world << Vector3d::UnitY(), Vector3d::UnitZ(), Vector3d::UnitX();
    const Matrix3d leant = Eigen::AngleAxisd(-lean * kDegree, Vector3d::UnitX()).toRotationMatrix();
    place(heading() * leant * world * cloth.transpose(), {0, kHeight, 0});
  }

  /// A box that stands on y = 0, or whose top that is.
  static Topology box_at(const Vector3d& sides, bool below) {
    Topology mesh = box(sides);
    mesh.rest_positions.col(1).array() += static_cast<float>((below ? -0.5 : 0.5) * sides.y());
    return mesh;
  }

  void drop() {
    simulation::Obstacle thing;
    thing.name = "thing";
    double top = 0;
    const double reach = random_.uniform(0.15, 0.4) * size_;
    switch (random_.below(4)) {
      case 0:
        thing.radius = reach;
        top = 2 * reach;
        thing.center = {0, reach, 0};
        break;
      case 1: {
        const Vector3d sides(2 * reach, random_.uniform(0.5, 2) * reach, random_.uniform(0.6, 1.4) * reach);
        thing.mesh = box_at(sides, false);
        top = sides.y();
        break;
      }
      case 2: {
        thing.mesh = cylinder();
        const Eigen::RowVector3f size = thing.mesh.rest_positions.colwise().maxCoeff();
        const double wide = reach / static_cast<double>(size.x()), high = random_.uniform(0.5, 2) * reach;
        thing.mesh.rest_positions.col(0) *= static_cast<float>(wide);
        thing.mesh.rest_positions.col(2) *= static_cast<float>(wide);
        thing.mesh.rest_positions.col(1) *= static_cast<float>(high / static_cast<double>(size.y()));
        top = high;
        break;
      }
      default: {
        const double r = 0.5 * reach, half = random_.uniform(0.5, 1.5) * reach;
        const Vector3d along = heading() * Vector3d::UnitX();
        thing.capsules = {{Vector3d(0, r, 0) - half * along, Vector3d(0, r, 0) + half * along, r},
                          {Vector3d(0, r, 0), Vector3d(0, 3 * r, 0), r}};
        top = 4 * r;
      }
    }
    scene.obstacles.push_back(thing);
    simulation::Obstacle ground;
    ground.name = "ground";
    ground.mesh = box_at({kGround, kGroundDepth, kGround}, true);
    scene.obstacles.push_back(ground);
    const double roll = random_.uniform(-12, 12), pitch = random_.uniform(-12, 12);
    const Matrix3d turn = heading() * (Eigen::AngleAxisd(pitch * kDegree, Vector3d::UnitX()) *
                                       Eigen::AngleAxisd(roll * kDegree, Vector3d::UnitZ()))
                                          .toRotationMatrix();
    place(turn, Vector3d::Zero());
    double lowest = 1e300;
    for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(garment_.mesh.vertex_count()); ++v) {
      lowest = std::min(lowest, placed(rest(v)).y());
    }
    const double aside = random_.uniform(0, 0.25) * size_, from = random_.uniform(-kPi, kPi);
    scene.transform.translation +=
        Vector3d(aside * std::cos(from), top + kClear + scene.perturbation_m - lowest, aside * std::sin(from));
  }

  void hit() {
    simulation::Obstacle ball;
    const double radius = random_.uniform(0.08, 0.25) * size_;
    const double from = random_.uniform(-kPi, kPi), start_s = random_.uniform(0.2, 0.7);
    const Vector3d away(std::cos(from), 0, std::sin(from));
    const double reach = 0.5 * size_ + radius + random_.uniform(0.1, 0.4) * size_;
    const Vector3d start = Vector3d(0, kHeight + random_.uniform(-0.35, 0.2) * size_, 0) + reach * away;
    const double speed = std::min(random_.uniform(0.5, 2.0) * std::sqrt(std::max(0.3, size_)), fastest());
    if (random_.below(3) == 0) {
      ball.name = "pole";
      const Vector3d half = 0.7 * size_ * (heading() * Vector3d(std::cos(0.3), std::sin(0.3), 0));
      ball.capsules = {{start - half, start + half, radius / 2}};
    } else {
      ball.name = "ball";
      ball.center = start;
      ball.radius = radius;
    }
    const Vector3d swing = -2 * reach * away + Vector3d(0, random_.uniform(-0.1, 0.1) * size_, 0);
    const double half_period_s = swing.norm() / speed;
    for (int k = 0; start_s + (k - 1) * half_period_s < duration_s_; ++k) {
      simulation::KeyFrame key;
      key.time_s = start_s + k * half_period_s;
      key.translation = k % 2 == 0 ? Vector3d(Vector3d::Zero()) : swing;
      ball.motion.keys.push_back(key);
    }
    scene.obstacles.push_back(ball);
  }

  /// By wind whose pressure on still cloth is up to eight times the cloth's weight.
  void blow() {
    const double from = random_.uniform(-kPi, kPi);
    const double even = std::sqrt(scene.material.density * 9.81 / scene.wind.density);
    const double speed = random_.uniform(0.7, 2.8) * even;
    scene.wind.velocity = speed * Vector3d(std::cos(from), random_.uniform(-0.2, 0.3), std::sin(from));
  }

  /// Everything that is held goes to and fro, and turns a little.
  void shake() {
    const double reach = random_.uniform(0.05, 0.3) * size_;
    simulation::KeyFrame key;
    std::vector<simulation::KeyFrame> keys{key};
    for (key.time_s = random_.uniform(0, 0.4); key.time_s < duration_s_; key.time_s += random_.uniform(0.2, 0.7)) {
      const simulation::KeyFrame& before = keys.back();
      if (key.time_s <= before.time_s) continue;
      const double most = kFastest * (key.time_s - before.time_s);
      Vector3d to(random_.uniform(-reach, reach), 0.4 * random_.uniform(-reach, reach), random_.uniform(-reach, reach));
      const Vector3d way = to - before.translation;
      if (way.norm() > most) to = before.translation + most / way.norm() * way;
      key.translation = to;
      key.rotation = random_.uniform(-25, 25) * kDegree * Vector3d::UnitY();
      keys.push_back(key);
    }
    for (simulation::Handle& handle : scene.handles) handle.motion.keys = keys;
  }

  void twist() {
    Vertices other;
    if (garment_.ring) {
      hang(border(), 0);
      other = garment_.borders.back();
    } else {
      const std::uint32_t first = held_points(1)[0];
      const Vertices upper = held_stretch(first, random_.uniform(0.1, 0.2));
      const std::uint32_t across = *std::max_element(border().begin(), border().end(),
                                                     [&](auto a, auto b) { return gap(a, first) < gap(b, first); });
      hang(upper, 0);
      other = held_stretch(across, random_.uniform(0.1, 0.2));
      std::erase_if(other, [&](std::uint32_t v) { return std::find(upper.begin(), upper.end(), v) != upper.end(); });
    }
    hold(other);
    // Twisted cloth is shorter.
    const double turn = random_.uniform(60, 150) * kDegree * (random_.below(2) == 0 ? -1 : 1),
                 lift = random_.uniform(0.12, 0.35) * size_, time_s = random_.uniform(0.9, 2.0);
    const double sign[] = {1, -1};
    for (std::size_t h = 0; h < 2; ++h) {
      for (int k = 0; k <= 4; ++k) {
        const double share = k % 4 == 0 ? 0 : k == 2 ? 1 : 0.5;
        simulation::KeyFrame key;
        key.time_s = 0.2 + time_s * k / 2;
        key.translation = {0, h == 1 ? share * lift : 0, 0};
        key.rotation = sign[h] * share * turn * Vector3d::UnitY();
        scene.handles[h].motion.keys.push_back(key);
      }
    }
  }

  /// A ring on two legs that walk, held by its waist.
  void wear() {
    hang(border(), 0);
    shake();
    double waist = 1e300;
    for (const std::uint32_t v : border()) waist = std::min(waist, std::hypot(rest(v).x(), rest(v).z()));
    // Between the corners of a coarse ring there is less room.
    const double room = waist * std::cos(kPi / static_cast<double>(border().size())) - 0.6 * garment_.edge;
    const double radius = 0.42 * room, apart = 0.5 * room;
    if (radius < 0.01) return;
    const double length = extent_.y() * random_.uniform(0.7, 1.1);
    const double swing = std::min(random_.uniform(8, 25) * kDegree, std::asin(std::min(1.0, 0.6 * room / length)));
    const Matrix3d turn = heading();
    const Vector3d top = placed({middle_.x(), middle_.y() + extent_.y() / 2, middle_.z()});
    const double sides[] = {-1, 1};
    for (const double side : sides) {
      simulation::Obstacle leg;
      leg.name = side < 0 ? "left" : "right";
      const Vector3d hip = top + turn * Vector3d(side * apart, 0.02, 0);
      leg.capsules = {{hip, hip - Vector3d(0, length, 0), radius}};
      const double step_s = random_.uniform(0.35, 0.7);
      for (const simulation::KeyFrame& key : scene.handles.front().motion.keys) leg.motion.keys.push_back(key);
      for (std::size_t k = 0; k < leg.motion.keys.size(); ++k) {
        simulation::KeyFrame& key = leg.motion.keys[k];
        // About its own middle: the hip goes the other way than the foot.
        const double angle = k == 0 ? 0 : side * swing * std::sin(kPi * key.time_s / step_s);
        key.rotation = angle * (turn * Vector3d::UnitX());
      }
      scene.obstacles.push_back(leg);
    }
  }

  const FamilyGarment& garment_;
  double duration_s_;
  Random& random_;
  Vector3d middle_, extent_;
  double size_ = 0;
  Matrix3d rotation_ = Matrix3d::Identity();
};

simulation::Material draw_material(const std::vector<simulation::Material>& presets, Random& random) {
  const simulation::Material& a = presets[random.below(presets.size())];
  const simulation::Material& b = presets[random.below(presets.size())];
  return between(a, b, random.below(3) == 0 ? 0 : random.uniform(0, 1));
}

// number: of the sequence in the set; turn: in its split.
SequencePlan plan_sequence(const SceneOptions& options, const std::vector<simulation::Material>& presets,
                           const std::string& name, std::size_t turn, int attempt) {
  Random random(Hash().add(name + " " + std::to_string(options.seed) + " " + std::to_string(attempt)).value());
  const FamilyGarment garment = family_garment(turn, random);
  const double duration_s = options.frames * Scene().frame_time_s;
  const std::string material_json = to_json(draw_material(presets, random));
  FamilyScene family(garment, simulation::parse_material(material_json, name), duration_s, random);
  // Every turn of the kinds begins with another motion.
  const std::size_t place = turn + turn / kFamilyKinds;
  family.move(garment.ring ? kRingMotions[(turn / 2) % std::size(kRingMotions)]
                           : kFlatMotions[place % std::size(kFlatMotions)]);
  SequencePlan plan;
  plan.name = name;
  plan.scene = std::move(family.scene);
  Scene& scene = plan.scene;
  scene.name = name;
  scene.frames = options.frames;
  plan.material_json = material_json;
  scene.damping_s = std::max(0.0, random.uniform(-kMostDamping, kMostDamping));
  scene.contact.friction = random.uniform(0.2, 0.9);
  scene.contact.obstacle_friction = random.uniform(0.1, 0.8);
  scene.seed = random.below(std::size_t{1} << 31);
  scene.subdivision_rounds = options.rounds > 0 ? options.rounds : set_defaults(options.set).rounds;
  plan.tracked = options.tracked;
  plan.own_meshes = true;
  set_tracking(options, plan);
  return plan;
}

}  // namespace

std::vector<SequencePlan> plan_family(const SceneOptions& options) {
  std::vector<simulation::Material> presets;
  for (const std::filesystem::path& file : options.materials) presets.push_back(simulation::read_material(file));
  if (presets.empty()) throw_invalid_argument("data set: no materials");
  std::vector<SequencePlan> plans;
  const auto train = static_cast<std::size_t>(options.train), test = static_cast<std::size_t>(options.test),
             all = train + test + static_cast<std::size_t>(options.extra);
  for (std::size_t i = 0; i < all; ++i) {
    const bool tests = i >= train && i < train + test;
    const std::size_t turn = tests ? i - train : i < train ? i : i - test;
    const std::string name = numbered(options.set, i);
    std::optional<SequencePlan> plan;
    std::string fault;
    for (int attempt = 0; attempt < kAttempts && (attempt == 0 || !fault.empty()); ++attempt) {
      plan = plan_sequence(options, presets, name, turn, attempt);
      fault = fault_of_start(plan->scene);
    }
    if (!fault.empty()) throw_internal(name + ": no clean start: " + fault);
    plan->split = tests ? "test" : "train";
    plan->scene_json = scene_to_json(*plan, {}, {});
    plans.push_back(std::move(*plan));
  }
  return plans;
}

}  // namespace pleat::dataset
