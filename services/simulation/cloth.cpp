#include "services/simulation/cloth.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>
#include <utility>

#include "common/base/error.hpp"
#include "services/simulation/obstacles.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using Clock = std::chrono::steady_clock;

// Metres. Nothing of a garment's scene is farther from the origin; NaN isn't nearer either.
constexpr double kFarthest = 1e5;
constexpr int kMostHalvings = 6;
// m/s. How fast a hard handle or an obstacle that something stood against goes back to its script.
constexpr double kCatchUpSpeed = 1;

double milliseconds(Clock::time_point from, Clock::time_point to) {
  return std::chrono::duration<double, std::milli>(to - from).count();
}

Points rest_points(const Topology& mesh) {
  Points points(static_cast<std::size_t>(mesh.vertex_count()));
  for (std::size_t v = 0; v < points.size(); ++v) {
    points[v] = mesh.rest_positions.row(static_cast<Eigen::Index>(v)).cast<double>().transpose();
  }
  return points;
}

}  // namespace

Cloth::Cloth(const Topology& mesh, Points initial, std::vector<std::vector<std::uint32_t>> handle_vertices,
             const Scene& scene, const Topology* coarse, std::span<const std::uint32_t> feature_vertices)
    : scene_(scene),
      dynamics_(mesh, scene, coarse, feature_vertices),
      contact_(mesh, rest_points(mesh), dynamics_.areas(), scene),
      strain_limits_(mesh, scene.strain_limits),
      positions_(std::move(initial)) {
  for (const double mass : dynamics_.masses()) free_inverse_masses_.push_back(1 / mass);
  velocities_.assign(positions_.size(), scene.velocity);
  const Points obstacles = contact_.obstacle_particles(0);
  positions_.insert(positions_.end(), obstacles.begin(), obstacles.end());
  velocities_.resize(positions_.size(), Vector3d::Zero());
  // The linear solver starts from the last change of velocity: from a fall's before the first step.
  const Eigen::Vector3f fall = (scene.gravity * scene.frame_time_s / scene.steps_per_frame).cast<float>();
  for (Float4& change : dynamics_.last_change()) change = Float4{fall.x(), fall.y(), fall.z(), 0};
  for (auto& vertices : handle_vertices) {
    handles_.emplace_back();
    handles_.back().anchors.assign(vertices.size(), Vector3d::Zero());
    handles_.back().vertices = std::move(vertices);
  }
}

void Cloth::check_start(ThreadPool& pool) { contact_.check_start(positions_, pool); }

// The pins of the handles for the step that ends at time_s + step_s. A handle takes hold of its vertices where they are
// at its start and lets go at its end.
void Cloth::collect_pins(double time_s, double step_s) {
  pins_.clear();
  for (std::size_t h = 0; h < handles_.size(); ++h) {
    const Handle& script = scene_.handles[h];
    HandleState& state = handles_[h];
    // Half a step of tolerance: step times are sums.
    const bool active = time_s + 0.5 * step_s >= script.start_s && time_s + 0.5 * step_s < script.end_s;
    if (active && !state.active) {
      state.pivot.setZero();
      for (std::size_t i = 0; i < state.vertices.size(); ++i) {
        state.anchors[i] = positions_[state.vertices[i]];
        state.pivot += state.anchors[i] / static_cast<double>(state.vertices.size());
      }
    }
    state.active = active;
    if (!active) continue;
    const Pose before = pose_at(script.motion, state.pivot, time_s);
    const Pose pose = pose_at(script.motion, state.pivot, time_s + step_s);
    for (std::size_t i = 0; i < state.vertices.size(); ++i) {
      const std::uint32_t v = state.vertices[i];
      Vector3d target = pose.apply(state.anchors[i]);
      if (script.hard) {
        const double farthest = (target - before.apply(state.anchors[i])).norm() + kCatchUpSpeed * step_s;
        const Vector3d way = target - positions_[v];
        const double length = way.norm();
        if (length > farthest) target = positions_[v] + farthest / length * way;
      }
      pins_.push_back({v, target, script.stiffness, script.hard});
    }
  }
}

// Where the obstacles are to be at the end of the step: in their scripted places, or on the way back to them.
std::span<const Eigen::Vector3d> Cloth::obstacle_targets(double time_s, double step_s) {
  // Where the script is now is where the last step was to end.
  if (scripted_time_s_ != time_s) contact_.obstacle_particles(time_s, scripted_);
  contact_.obstacle_particles(time_s + step_s, scripted_next_);
  bool on_the_way = false;
  std::size_t first = 0;
  for (const Obstacle& obstacle : scene_.obstacles) {
    const std::size_t last = first + point_count(obstacle);
    double script = 0, way = 0;
    for (std::size_t i = first; i < last; ++i) {
      script = std::max(script, (scripted_next_[i] - scripted_[i]).squaredNorm());
      way = std::max(way, (scripted_next_[i] - positions_[vertex_count() + i]).squaredNorm());
    }
    script = std::sqrt(script);
    way = std::sqrt(way);
    const double farthest = script + kCatchUpSpeed * step_s;
    if (way > farthest) {
      if (!std::exchange(on_the_way, true)) targets_ = scripted_next_;
      for (std::size_t i = first; i < last; ++i) {
        const Vector3d& now = positions_[vertex_count() + i];
        targets_[i] = now + farthest / way * (scripted_next_[i] - now);
      }
    }
    first = last;
  }
  std::swap(scripted_, scripted_next_);
  scripted_time_s_ = time_s + step_s;
  return on_the_way ? targets_ : scripted_;
}

void Cloth::step(double time_s, double step_s, const Following& following, ThreadPool& pool) {
  advance(time_s, step_s, following, pool, 0);
}

void Cloth::advance(double time_s, double step_s, const Following& following, ThreadPool& pool, int halvings) {
  const auto start = Clock::now();
  if (stopped_ && stopped_()) throw Error(ErrorCode::kCancelled, "cancelled");
  collect_pins(time_s, step_s);
  inverse_masses_ = free_inverse_masses_;
  for (const Pin& pin : pins_) {
    if (pin.hard) inverse_masses_[pin.vertex] = 0;
  }
  pins_.insert(pins_.end(), following.springs.begin(), following.springs.end());

  const std::span<const Vector3d> obstacles = obstacle_targets(time_s, step_s);
  for (std::size_t o = 0; o < obstacles.size(); ++o) {
    const std::size_t particle = vertex_count() + o;
    velocities_[particle] = (obstacles[o] - positions_[particle]) / step_s;
  }
  const auto forces = contact_.repulsion(positions_, velocities_, dynamics_.masses(), time_s, step_s, pool);
  const auto repulsion_done = Clock::now();

  Dynamics::Step step;
  step.length_s = step_s;
  step.damping_s = scene_.damping_s;
  step.gravity = scene_.gravity;
  step.wind = scene_.wind;
  step.pins = pins_;
  step.contacts = forces;
  step.frequency = following.frequency;
  step.targets = following.targets;
  // Those of the obstacles follow from where they are.
  velocities_before_.assign(velocities_.begin(), velocities_.begin() + static_cast<std::ptrdiff_t>(vertex_count()));
  report_.solver_iterations += static_cast<std::uint64_t>(dynamics_.solve(positions_, velocities_, step, pool));
  const auto solve_done = Clock::now();

  Points& end = end_;
  end.resize(positions_.size());
  bool inside = true;  // false for NaN as well
  for (std::size_t i = 0; i < vertex_count(); ++i) {
    end[i] = positions_[i] + step_s * velocities_[i];
    inside = inside && end[i].cwiseAbs().maxCoeff() < kFarthest;
  }
  if (!inside || (halvings < kMostHalvings && dynamics_.bursts(positions_, end))) {
    std::copy(velocities_before_.begin(), velocities_before_.end(), velocities_.begin());
    dynamics_.forget_last_change();
    if (halvings == kMostHalvings) {
      throw Error(ErrorCode::kFailedPrecondition, "scene '" + scene_.name + "': the simulation has diverged at " +
                                                      std::to_string(time_s) + " s, in steps of " +
                                                      std::to_string(1e3 * step_s) + " ms; its forces are too strong");
    }
    ++report_.cut_steps;
    advance(time_s, step_s / 2, following, pool, halvings + 1);
    advance(time_s + step_s / 2, step_s / 2, following, pool, halvings + 1);
    return;
  }
  for (std::size_t o = 0; o < obstacles.size(); ++o) end[vertex_count() + o] = obstacles[o];
  const bool limited = strain_limits_.project(std::span(end).first(vertex_count()), inverse_masses_);
  const Resolution resolution = contact_.resolve(positions_, end, inverse_masses_, free_inverse_masses_, pool);
  if (resolution.impacts > 0 || limited) {
    for (std::size_t i = 0; i < vertex_count(); ++i) velocities_[i] = (end[i] - positions_[i]) / step_s;
  }
  std::swap(positions_, end);

  const auto done = Clock::now();
  report_.contacts += forces.size();
  report_.impacts += resolution.impacts;
  report_.rigid_zones += resolution.rigid_zones;
  report_.cut_steps += resolution.cut ? 1 : 0;
  report_.stopped_vertices = std::max(report_.stopped_vertices, resolution.stopped);
  report_.yielded_steps += resolution.yielded ? 1 : 0;
  report_.assembly_ms += dynamics_.assembly_ms();
  report_.solve_ms += dynamics_.solve_ms();
  report_.contact_ms += milliseconds(start, repulsion_done) + milliseconds(solve_done, done);
  report_.total_ms += milliseconds(start, done);
}

double Cloth::handle_lag(std::size_t handle, double time_s) const {
  const HandleState& state = handles_[handle];
  const Handle& script = scene_.handles[handle];
  if (!state.active || !script.hard) return 0;
  const Pose pose = pose_at(script.motion, state.pivot, time_s);
  double lag = 0;
  for (std::size_t i = 0; i < state.vertices.size(); ++i) {
    lag = std::max(lag, (pose.apply(state.anchors[i]) - positions_[state.vertices[i]]).norm());
  }
  return lag;
}

double Cloth::obstacle_lag(double time_s) const {
  const Points scripted = contact_.obstacle_particles(time_s);
  double lag = 0;
  for (std::size_t i = 0; i < scripted.size(); ++i) {
    lag = std::max(lag, (scripted[i] - positions_[vertex_count() + i]).norm());
  }
  return lag;
}

ClothReport Cloth::take_report() { return std::exchange(report_, {}); }

}  // namespace pleat::simulation
