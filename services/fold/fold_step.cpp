#include "services/fold/fold_step.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/parallel.hpp"
#include "services/refinement/obstacle_field.hpp"
#include "services/simulation/contact.hpp"
#include "services/simulation/dynamics.hpp"

namespace pleat::fold {
namespace {

using Eigen::Vector3d;
using simulation::ContactForce;
using simulation::Points;
using Clock = std::chrono::steady_clock;

// The stiffness of contacts and of what is held, over mass / step^2: they give way by a part in a hundred.
constexpr double kFirm = 100;
constexpr double kObstacleFriction = 0.3;
constexpr std::size_t kGrain = 1024;

double milliseconds(Clock::time_point from) {
  return std::chrono::duration<double, std::milli>(Clock::now() - from).count();
}

void check_options(const FoldOptions& o) {
  const auto check = [](bool good, const char* what) {
    if (!good) throw_invalid_argument(std::string("fold step: ") + what);
  };
  check(o.frame_time_s > 0 && o.frame_time_s <= 10, "frame time must be above 0 and at most 10 s");
  check(o.frequency >= 0 && o.frequency * o.frame_time_s <= 10, "frequency must be 0 to 10 radians a frame");
  check(o.gravity.allFinite() && o.gravity.norm() <= 1000, "gravity must be finite, at most 1000 m/s2");
  check(o.thickness_m > 0 && o.thickness_m <= 1, "thickness must be above 0 and at most 1 m");
  check(o.clearance_m >= 0 && o.clearance_m <= 0.1, "clearance must be 0 to 0.1 m");
  check(o.most_steps >= 1 && o.most_steps <= 64, "steps a frame must be 1 to 64");
  check(o.step_motion_m > 0, "motion of a step must be above 0");
  check(o.tolerance > 0 && o.tolerance < 1, "tolerance must be between 0 and 1");
  check(o.most_iterations >= 1, "at least one iteration is needed");
  check(o.restart_m > 0, "restart distance must be above 0");
  check(o.threads >= 0 && o.threads <= 1024, "threads must be 0 to 1024");
}

// Repulsion of layers, in the scale of a step.
simulation::Scene scene_of(const Topology& coarse, const FoldOptions& o) {
  simulation::Scene scene;
  scene.name = "fold step";
  scene.garment = coarse;
  scene.material = o.material;
  scene.gravity = o.gravity;
  scene.contact.thickness = o.thickness_m;
  scene.contact.stiffness = kFirm * o.material.density / (o.frame_time_s * o.frame_time_s);
  scene.contact.neighbours = false;
  simulation::validate_scene(scene);
  return scene;
}

Points to_points(const Positions& positions) {
  Points points(static_cast<std::size_t>(positions.rows()));
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i] = positions.row(static_cast<Eigen::Index>(i)).cast<double>().transpose();
  }
  return points;
}

Positions to_positions(const Points& points) {
  Positions positions(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t i = 0; i < points.size(); ++i) {
    positions.row(static_cast<Eigen::Index>(i)) = points[i].cast<float>().transpose();
  }
  return positions;
}

}  // namespace

struct FoldStep::Work {
  FoldOptions options;
  Topology coarse;
  Subdivision subdivision;
  simulation::Scene scene;
  ThreadPool pool;
  simulation::Dynamics dynamics;
  simulation::Averages averages;
  simulation::ContactSystem contact;
  ObstacleField obstacles;

  Points from, to;          // the upsampled coarse cloth of the frame before and of this one
  Points x, v;              // the fine cloth at the start of a step
  Points place, departure;  // where a step is linearised, and the velocity that leaves it towards inertia's
  Points target, end;       // of a step
  std::vector<simulation::Pin> pins;
  std::vector<std::vector<ContactForce>> found;

  Work(const Topology& c, const Subdivision& s, std::span<const ObstacleShape> shapes, const FoldOptions& o)
      : options((check_options(o), o)),
        coarse(c),
        subdivision(s),
        scene(scene_of(c, o)),
        pool(static_cast<std::size_t>(o.threads)),
        dynamics(s.fine, scene),
        contact(s.fine, to_points(s.fine.rest_positions), dynamics.areas(), scene),
        obstacles(shapes) {
    dynamics.use_levels(subdivision);
    dynamics.track_averages(subdivision, coarse.faces);
    std::vector<std::uint32_t> identity(dynamics.vertex_count());
    for (std::uint32_t i = 0; i < identity.size(); ++i) identity[i] = i;
    averages = simulation::Averages(subdivision, coarse.faces, dynamics.masses(), identity);
    const std::size_t n = dynamics.vertex_count();
    for (Points* points : {&place, &departure, &target, &end}) points->resize(n);
    found.resize((n + kGrain - 1) / kGrain);
  }

  std::size_t count() const { return dynamics.vertex_count(); }

  void check(const FoldFrame& frame, const FoldState& state) const {
    const Eigen::Index coarse_count = coarse.vertex_count(), fine_count = subdivision.fine.vertex_count();
    const auto check_array = [](const Positions& array, Eigen::Index rows, const char* what) {
      if (array.rows() != rows) {
        throw_invalid_argument(std::string("fold step: ") + what + " has " + std::to_string(array.rows()) +
                               " rows instead of " + std::to_string(rows));
      }
      if (!array.allFinite()) throw_invalid_argument(std::string("fold step: ") + what + " is not finite");
    };
    check_array(frame.coarse, coarse_count, "coarse frame");
    check_array(frame.coarse_velocities, coarse_count, "coarse velocities");
    if (frame.start != nullptr) check_array(*frame.start, fine_count, "start");
    if (state.positions.size() > 0 || state.velocities.size() > 0) {
      check_array(state.positions, fine_count, "state's positions");
      check_array(state.velocities, fine_count, "state's velocities");
    }
    for (const std::uint32_t h : frame.held) {
      if (h >= static_cast<std::uint32_t>(coarse_count)) {
        throw_invalid_argument("fold step: held vertex " + std::to_string(h) + " does not exist");
      }
    }
  }

  // The state's cloth, or the upsampled one in its motion; returns whether it had to be that.
  bool begin(const FoldState& state) {
    bool fits = state.positions.size() > 0;
    if (fits) {
      x = to_points(state.positions);
      v = to_points(state.velocities);
      double sum = 0;
      for (std::size_t i = 0; i < count(); ++i) sum += (x[i] - from[i]).squaredNorm();
      fits = sum <= options.restart_m * options.restart_m * static_cast<double>(count());
    }
    if (fits) return false;
    x = from;
    v.resize(count());
    for (std::size_t i = 0; i < count(); ++i) v[i] = (to[i] - from[i]) / options.frame_time_s;
    return true;
  }

  // By how far the coarse cloth departs from the fine one's inertia decides the steps of the frame.
  int steps() const {
    double most = 0;
    for (std::size_t c = 0; c < averages.count(); ++c) {
      Vector3d sum = Vector3d::Zero();
      for (const auto& [i, weight] : averages.weights(c)) {
        sum += static_cast<double>(weight) * (to[i] - from[i] - options.frame_time_s * v[i]);
      }
      most = std::max(most, sum.norm());
    }
    return static_cast<int>(
        std::clamp(std::ceil(most / options.step_motion_m), 1.0, static_cast<double>(options.most_steps)));
  }

  void collect_pins(const FoldFrame& frame, double step_s) {
    pins.clear();
    if (frame.held.empty()) return;
    std::vector<char> held(static_cast<std::size_t>(coarse.vertex_count()), 0);
    for (const std::uint32_t h : frame.held) held[h] = 1;
    for (std::uint32_t i = 0; i < count(); ++i) {
      bool inside = true;
      for (int k = 0; k < 3; ++k) {
        inside = inside && (subdivision.barycentric(i, k) == 0 || held[coarse.faces(subdivision.parent_face[i], k)]);
      }
      if (inside) pins.push_back({i, target[i], kFirm * dynamics.masses()[i] / (step_s * step_s), false});
    }
  }

  // Vertices nearer to an obstacle than the clearance, or inside, are pushed out; along it they go with the coarse
  // cloth, which has met its friction.
  void push_from_obstacles(double step_s, std::vector<ContactForce>& forces) {
    if (obstacles.empty()) return;
    pool.parallel_for(count(), kGrain, [&](std::size_t begin, std::size_t last) {
      auto& list = found[begin / kGrain];
      list.clear();
      for (std::size_t i = begin; i < last; ++i) {
        const auto near = obstacles.contact(place[i], options.clearance_m);
        if (!near || near->distance >= options.clearance_m) continue;
        const double mass = dynamics.masses()[i], stiffness = kFirm * mass / (step_s * step_s);
        const double force = stiffness * (options.clearance_m - near->distance);
        const Vector3d& normal = near->normal;
        const double sliding = (departure[i] - normal * normal.dot(departure[i])).norm();
        ContactForce contact_force{};
        contact_force.vertices = {static_cast<std::uint32_t>(i), kNone, kNone, kNone};
        contact_force.weights = {1, 0, 0, 0};
        contact_force.normal = normal.cast<float>();
        contact_force.force = static_cast<float>(force);
        contact_force.stiffness = static_cast<float>(stiffness);
        contact_force.friction =
            static_cast<float>(sliding > 0 ? std::min(kObstacleFriction * force / sliding, mass / step_s) : 0);
        contact_force.approach = departure[i].cast<float>();
        list.push_back(contact_force);
      }
    });
    for (const auto& list : found) forces.insert(forces.end(), list.begin(), list.end());
  }

  // One step of Newton for the implicit step from x, v, taken where the cloth would be if it went with the coarse one.
  bool step(const FoldFrame& frame, int index, int count_of_steps, FoldReport& report) {
    const double step_s = options.frame_time_s / count_of_steps;
    const double before = static_cast<double>(index) / count_of_steps, after = (index + 1.0) / count_of_steps;
    const bool given = frame.start != nullptr && index + 1 == count_of_steps;
    for (std::size_t i = 0; i < count(); ++i) {
      const Vector3d way = to[i] - from[i];
      target[i] = from[i] + after * way;
      if (given) {
        place[i] = frame.start->row(static_cast<Eigen::Index>(i)).cast<double>().transpose();
      } else {
        place[i] = x[i] + (after - before) * way;
      }
      departure[i] = (x[i] - place[i]) / step_s + v[i];
    }
    const auto contact_start = Clock::now();
    contact.forget();
    std::vector<ContactForce> forces = contact.repulsion(place, departure, dynamics.masses(), step_s, pool);
    push_from_obstacles(step_s, forces);
    collect_pins(frame, step_s);
    report.contact_ms += milliseconds(contact_start);
    report.contacts += forces.size();

    simulation::Dynamics::Step work;
    work.length_s = step_s;
    work.damping_s = 0;
    // The coarse cloth's velocity over the frame, with which a cloth without a state begins, has met gravity and air.
    work.gravity = report.restarted ? Vector3d(Vector3d::Zero()) : options.gravity;
    work.wind.density = report.restarted ? 0 : 1;
    work.air_velocities = v;
    work.pins = pins;
    work.contacts = forces;
    work.frequency = options.frequency;
    work.targets = target;
    work.tolerance = options.tolerance;
    work.max_iterations = options.most_iterations;
    end = departure;
    dynamics.forget_reference_angles();
    dynamics.start_at_rest(departure);
    report.iterations += dynamics.solve(place, end, work, pool);
    report.assembly_ms += dynamics.assembly_ms();
    report.solve_ms += dynamics.solve_ms();
    for (std::size_t i = 0; i < count(); ++i) {
      end[i] = place[i] + step_s * end[i];
      if (!end[i].allFinite()) return false;
    }
    if (dynamics.bursts(x, end)) return false;
    for (std::size_t i = 0; i < count(); ++i) v[i] = (end[i] - x[i]) / step_s;
    std::swap(x, end);
    return true;
  }
};

FoldStep::FoldStep(const Topology& coarse, const Subdivision& subdivision, std::span<const ObstacleShape> obstacles,
                   const FoldOptions& options)
    : work_(std::make_unique<Work>(coarse, subdivision, obstacles, options)) {}
FoldStep::~FoldStep() = default;
FoldStep::FoldStep(FoldStep&&) noexcept = default;
FoldStep& FoldStep::operator=(FoldStep&&) noexcept = default;

FoldReport FoldStep::fold(const FoldFrame& frame, FoldState& state) {
  const auto start = Clock::now();
  Work& w = *work_;
  w.check(frame, state);
  w.obstacles.update(frame.obstacles);
  const Positions before = frame.coarse - static_cast<float>(w.options.frame_time_s) * frame.coarse_velocities;
  w.from = to_points(upsample(w.subdivision, w.coarse.faces, before));
  w.to = to_points(upsample(w.subdivision, w.coarse.faces, frame.coarse));
  FoldReport report;
  report.restarted = w.begin(state);
  report.steps = w.steps();
  for (int index = 0; index < report.steps && !report.gave_up; ++index) {
    report.gave_up = !w.step(frame, index, report.steps, report);
  }
  if (report.gave_up) {
    w.x = w.to;
    for (std::size_t i = 0; i < w.count(); ++i) w.v[i] = (w.to[i] - w.from[i]) / w.options.frame_time_s;
  }
  state.positions = to_positions(w.x);
  state.velocities = to_positions(w.v);
  report.ms = milliseconds(start);
  return report;
}

}  // namespace pleat::fold
