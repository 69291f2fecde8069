#include "services/fold/fold_step.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/random.hpp"
#include "common/base/simd.hpp"
#include "common/frame/obstacle_field.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/fold/constraints.hpp"
#include "services/fold/layers.hpp"
#include "services/fold/levels.hpp"
#include "services/fold/tracking.hpp"
#include "services/fold/viscosity.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat::fold {
namespace {

using Clock = std::chrono::steady_clock;

// By this factor of the hinges' stiffness the fine tablecloth wrinkles as one that is simulated in steps of 5 ms
// (bench_fold_step).
constexpr float kBending = 0.9f;
constexpr float kUnevenness = 5e-5f;  // m: a sheet that is exactly flat would not know where to fold
constexpr double kMostSteps = 1000;   // in a frame: it must end
constexpr int kPullEvery = 4;         // steps
// What passes through itself goes back to the coarse cloth with this frequency (rad/s), critically damped, and is
// smoothed; so is, less, what is around.
constexpr float kTangleFrequency = 60;
constexpr int kTangleRings = 3;
constexpr float kTangleSmoothing = 0.2f;  // of what a vertex lacks to its neighbours' mean, in a step
constexpr float kDetailDamping = 4;       // 1/s, of motion beside the coarse cloth's
constexpr std::size_t kMostTangles = 20'000;
constexpr float kStartFrequency = 10;  // rad/s, of every vertex about the start's
constexpr float kObstacleFriction = 0.3f;
constexpr double kObstacleReach = 0.02;  // m, within a frame, beside the coarse cloth's motion
constexpr double kObstacleDepth = 0.06;  // m: who is deeper inside a mesh is left to refinement
constexpr float kMostRise = 1e-3f;       // m, of an obstacle between two planes that speak for a third
constexpr float kLeastTurn = 0.9f;       // of these, the cosine
constexpr std::uint32_t kUnmeasured = 0xffffffffu;
constexpr double kRounding = 1e-5;                       // m: of distances in float32, and more
constexpr double kTouchNear = 0.008, kTouchFar = 0.016;  // m: nearer than that coarse cloth touches, farther not
constexpr float kLayerReach = 0.02f;                     // m

float norm(Float4 v) { return std::sqrt(dot(v, v)); }

double milliseconds(Clock::time_point from) {
  return std::chrono::duration<double, std::milli>(Clock::now() - from).count();
}

void check_options(const FoldOptions& o, const Topology& coarse) {
  const auto check = [](bool good, const char* what) {
    if (!good) throw_invalid_argument(std::string("fold step: ") + what);
  };
  check(o.frame_time_s > 0 && o.frame_time_s <= 10, "frame time must be above 0 and at most 10 s");
  check(o.frequency >= 0 && o.frequency <= 50, "frequency must be 0 to 50 rad/s");
  check(o.step_s >= 1e-5 && o.step_s <= 0.1, "step must be 0.01 to 100 ms");
  check(o.frame_time_s <= kMostSteps * o.step_s, "frame time: more than 1000 steps a frame");
  check(o.gravity.allFinite() && o.gravity.norm() <= 1000, "gravity must be finite, at most 1000 m/s2");
  check(o.air_density >= 0 && o.air_density <= 100 && o.air_velocity.allFinite(),
        "the air's density must be 0 to 100 kg/m3, its velocity finite");
  check(o.thickness_m >= 0 && o.thickness_m <= 1, "thickness must be 0 to 1 m");
  check(o.clearance_m >= 0 && o.clearance_m <= 0.1, "clearance must be 0 to 0.1 m");
  check(o.restart_m > 0, "restart distance must be above 0");
  check(o.material.density > 0 && std::isfinite(o.material.density), "the material's density must be above 0");
  check(coarse.uv_faces.rows() == coarse.faces.rows() && coarse.face_count() > 0, "material coordinates are needed");
}

// A half space that a fine vertex stays out of, for a frame.
struct ObstaclePlane {
  std::uint32_t vertex;
  Float4 normal;
  float offset;  // normal . x is at least this
  Float4 place;  // where the obstacle was measured, and how far away it was
  float distance;
};

}  // namespace

struct FoldStep::Work {
  FoldOptions options;
  Topology coarse;
  Subdivision subdivision;
  std::uint32_t count, coarse_count;
  int steps;
  float step_s, frame_s;
  Float4 down;  // unit, or 0 without gravity
  ObstacleField obstacles;
  LayerFinder layers;
  refinement::SelfIntersectionFinder tangles;
  std::vector<float> masses;  // kg per fine vertex
  Tracking tracking;
  Viscosity viscosity;

  CoarserLevels levels;
  FacePacks faces;
  HingePacks hinges;
  std::vector<float> inverse_masses;
  std::vector<char> fixed, fixed_before;  // the latter empty before the first frame
  std::vector<std::uint32_t> pins;

  // One more than there are vertices, as scratch place of packs.
  std::vector<Float4> x, v, before, from, way, given, normals, moved, pull;
  std::span<const LayerContact> layer_contacts;
  std::vector<refinement::FacePair> pairs;
  std::vector<float> tangled, wider;
  std::vector<ObstaclePlane> planes;
  std::vector<std::uint32_t> plane_of;  // per fine vertex; kUnmeasured without a plane
  std::vector<std::uint32_t> near_faces;
  std::vector<Box> near_obstacles;
  std::vector<Float4> unevenness;  // per coarse vertex, where a cloth begins
  std::vector<float> touching;     // per coarse vertex: 1 on an obstacle, 0 away from all

  Work(const Topology& c, const Subdivision& s, std::span<const ObstacleShape> shapes, const FoldOptions& o)
      : options((check_options(o, c), o)),
        coarse(c),
        subdivision(s),
        count(static_cast<std::uint32_t>(s.fine.vertex_count())),
        coarse_count(static_cast<std::uint32_t>(c.vertex_count())),
        steps(static_cast<int>(std::max(std::ceil(o.frame_time_s / o.step_s - 1e-9), 1.0))),
        step_s(static_cast<float>(o.frame_time_s / steps)),
        frame_s(static_cast<float>(o.frame_time_s)),
        down(to_float4(o.gravity.stableNormalized())),
        obstacles(shapes),
        layers(c, s),
        tangles(s.fine.faces, s.fine.vertex_count(), c.faces),
        masses(lumped_masses(s.fine, o.material.density)),
        tracking(c, s, masses),
        viscosity(s.fine),
        levels(c, s, o.material) {
    faces = FacePacks(stretch_faces(s.fine, o.material), count);
    std::vector<Hinge> bending = edge_hinges(s.fine, o.material);
    for (Hinge& hinge : bending) hinge.stiffness *= kBending;
    hinges = HingePacks(std::move(bending), count);
    for (const float mass : masses) inverse_masses.push_back(1 / mass);
    std::uint64_t seed = 1;
    for (std::uint32_t i = 0; i < coarse_count; ++i) {
      const auto some = [&] { return kUnevenness * static_cast<float>(2 * unit_interval(split_mix(seed)) - 1); };
      unevenness.push_back(Float4{some(), some(), some(), 0});  // in braces: from left to right
    }
    touching.assign(coarse_count, 0);
    tangled.assign(count, 0);
    fixed.assign(count, 0);
    for (auto* buffer : {&x, &v, &before, &from, &way, &given, &normals, &moved, &pull})
      buffer->assign(count + 1, Float4{});
  }

  void check(const FoldFrame& frame, const FoldState& state) const {
    const auto check_array = [](const Positions& array, std::uint32_t rows, const char* what) {
      if (array.rows() != static_cast<Eigen::Index>(rows)) {
        throw_invalid_argument(std::string("fold step: ") + what + " has " + std::to_string(array.rows()) +
                               " rows instead of " + std::to_string(rows));
      }
      if (!all_finite(array)) throw_invalid_argument(std::string("fold step: ") + what + " is not finite");
    };
    check_array(frame.coarse, coarse_count, "coarse frame");
    check_array(frame.coarse_velocities, coarse_count, "coarse velocities");
    if (frame.start != nullptr) check_array(*frame.start, count, "start");
    if (state.positions.size() > 0 || state.velocities.size() > 0) {
      check_array(state.positions, count, "state's positions");
      check_array(state.velocities, count, "state's velocities");
    }
    for (const std::uint32_t h : frame.held) {
      if (h >= coarse_count) throw_invalid_argument("fold step: held vertex " + std::to_string(h) + " does not exist");
    }
  }

  // Fine vertices between held coarse ones are fixed; the shares of the constraints know it.
  void hold(std::span<const std::uint32_t> held) {
    std::vector<char> is_held(coarse_count, 0);
    for (const std::uint32_t h : held) is_held[h] = 1;
    pins.clear();
    for (std::uint32_t i = 0; i < count; ++i) {
      bool inside = true;
      for (int k = 0; k < 3; ++k) {
        inside =
            inside && (subdivision.barycentric(i, k) == 0 || is_held[coarse.faces(subdivision.parent_face[i], k)] != 0);
      }
      fixed[i] = inside ? 1 : 0;
      if (inside) pins.push_back(i);
    }
    if (fixed == fixed_before) return;
    fixed_before = fixed;
    std::vector<float> mobile(inverse_masses);
    for (std::uint32_t i = 0; i < count; ++i)
      if (fixed[i]) mobile[i] = 0;
    faces.set_step(mobile, step_s);
    hinges.set_step(mobile, step_s);
    levels.set_step(fixed, step_s);
  }

  // The state's cloth, or the upsampled one in its motion; returns whether it had to be that.
  bool begin(const FoldState& state, const Eigen::Vector3d& origin) {
    bool fits = state.positions.size() > 0;
    if (fits) {
      double sum = 0;
      for (std::uint32_t i = 0; i < count; ++i) {
        x[i] = to_float4(state.positions.row(i).cast<double>().transpose() - origin);
        v[i] = to_float4(state.velocities.row(i).transpose());
        sum += static_cast<double>(dot(x[i] - from[i], x[i] - from[i]));
      }
      fits = sum <= options.restart_m * options.restart_m * static_cast<double>(count);
    }
    if (fits) return false;
    for (std::uint32_t i = 0; i < count; ++i) {
      x[i] = from[i];
      v[i] = way[i] / frame_s;
      if (fixed[i] != 0) continue;
      for (Eigen::Index k = 0; k < 3; ++k) {
        x[i] += subdivision.barycentric(i, k) * unevenness[coarse.faces(subdivision.parent_face[i], k)];
      }
    }
    return true;
  }

  // Another answer says where the cloth is at large better than the coarse cloth does, which may be centimetres away
  // from it: the frame's motion leads from the averages of the state's cloth to those of the answer.
  void follow_start() {
    for (std::uint32_t i = 0; i < count; ++i) {
      if (fixed[i]) continue;
      from[i] = x[i];
      before[i] = given[i] - x[i];
    }
    for (const std::uint32_t i : pins) before[i] = way[i];
    tracking.smooth(before, moved);
    for (std::uint32_t i = 0; i < count; ++i) {
      if (!fixed[i]) way[i] = moved[i];
    }
  }

  // How far each vertex is to go back to what it follows: 1 where the state passes through itself, less around.
  void find_tangles(const Positions& positions) {
    tangles.update(positions);
    // Which ones of too many are found is not specified, and the frame must not depend on it.
    const bool all = tangles.find(positions, kMostTangles, pairs);
    std::fill(tangled.begin(), tangled.end(), all ? 0.0f : 1.0f);
    if (pairs.empty() || !all) return;
    const Faces& corners = subdivision.fine.faces;
    for (const refinement::FacePair& pair : pairs) {
      for (const std::uint32_t face : {pair[0], pair[1]}) {
        for (int k = 0; k < 3; ++k) tangled[corners(face, k)] = 1;
      }
    }
    for (int round = 0; round < kTangleRings; ++round) {
      wider = tangled;
      for (Eigen::Index f = 0; f < corners.rows(); ++f) {
        const float most = 0.7f * std::max({tangled[corners(f, 0)], tangled[corners(f, 1)], tangled[corners(f, 2)]});
        for (int k = 0; k < 3; ++k) wider[corners(f, k)] = std::max(wider[corners(f, k)], most);
      }
      std::swap(tangled, wider);
    }
  }

  // What passes through itself is mostly a crumple of a few edges: it is smoothed out, without a velocity.
  void smooth_tangles() {
    for (std::uint32_t i = 0; i < count; ++i) {
      if (tangled[i] == 0 || fixed[i]) continue;
      const Float4 move = kTangleSmoothing * tangled[i] * viscosity.lack(i, x);
      x[i] += move;
      before[i] += move;
    }
  }

  void find_normals() {
    std::fill(normals.begin(), normals.end(), Float4{});
    const Faces& corners = subdivision.fine.faces;
    for (Eigen::Index f = 0; f < corners.rows(); ++f) {
      const Float4 corner = x[corners(f, 0)];
      const Float4 area = cross(x[corners(f, 1)] - corner, x[corners(f, 2)] - corner);
      for (int k = 0; k < 3; ++k) normals[corners(f, k)] += area;
    }
    for (Float4& normal : normals) normal /= std::sqrt(dot(normal, normal)) + 1e-20f;
  }

  Eigen::Vector3d point_at(const Eigen::Vector3d& origin, Float4 p) const {
    return origin + Eigen::Vector3d(static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2]));
  }

  // Where the coarse cloth lies on an obstacle, it has met its friction: the fine cloth stays there with it.
  void find_touching(const Positions& frame_positions) {
    std::fill(touching.begin(), touching.end(), 0.0f);
    for (std::uint32_t c = 0; c < coarse_count && !obstacles.empty(); ++c) {
      const auto contact = obstacles.contact_near(frame_positions.row(c).cast<double>(), kTouchFar, kTouchFar);
      if (!contact) continue;
      touching[c] =
          static_cast<float>(std::clamp((kTouchFar - contact->distance) / (kTouchFar - kTouchNear), 0.0, 1.0));
    }
    tracking.set_touching(touching);
  }

  // Coarse faces near obstacles, of where the cloth would be at the end of the frame if it went along with the coarse
  // one: a ball around a face's fine vertices tells mostly that none of them is near.
  void find_near_faces(const Eigen::Vector3d& origin) {
    near_faces.clear();
    near_obstacles.clear();
    obstacles.append_bounds(kObstacleReach, near_obstacles);
    // From one place to another the distance changes by the way between them at most: a face with room around it speaks
    // for its neighbours.
    Float4 far_place{};
    double far = -1;
    for (std::uint32_t face = 0; face < static_cast<std::uint32_t>(coarse.face_count()); ++face) {
      const std::span<const std::uint32_t> members = layers.vertices_of(face);
      if (members.empty()) continue;
      Float4 middle{};
      for (const std::uint32_t i : members) middle += x[i] + way[i];
      middle /= static_cast<float>(members.size());
      float squared = 0;
      for (const std::uint32_t i : members) {
        const Float4 offset = x[i] + way[i] - middle;
        squared = std::max(squared, dot(offset, offset));
      }
      const double radius = 1.001 * std::sqrt(static_cast<double>(squared)) + 1e-6;
      const double reach = radius + kObstacleReach, depth = radius + kObstacleDepth;
      if (far - static_cast<double>(norm(middle - far_place)) > reach + kRounding) continue;
      Box place;
      place.extend(point_at(origin, middle), radius);
      if (std::none_of(near_obstacles.begin(), near_obstacles.end(), [&](const Box& b) { return b.overlaps(place); })) {
        continue;
      }
      const auto contact = obstacles.contact_near(point_at(origin, middle), depth, depth);
      if (contact && contact->distance <= reach) {
        near_faces.push_back(face);
      } else if (contact) {
        far = contact->distance;
        far_place = middle;
      }
    }
  }

  // Where vertices would be at the end of the frame. Those of the last round of subdivision, three of four, lie between
  // two others, and mostly so does their plane.
  void find_planes(const Eigen::Vector3d& origin) {
    planes.clear();
    if (obstacles.empty()) return;
    find_near_faces(origin);
    plane_of.assign(count, kUnmeasured);
    const auto rounds = subdivision.level_sizes.size();
    const std::uint32_t earlier = rounds > 1 ? subdivision.level_sizes[rounds - 2] : count;
    for (const bool last_round : {false, true}) {
      for (const std::uint32_t face : near_faces) {
        // From one place to another the distance changes by the way between them at most: a place with room around it
        // speaks for its neighbours.
        Float4 free_place{};
        float room = 0;
        for (const std::uint32_t i : layers.vertices_of(face)) {
          const Float4 end = x[i] + way[i];
          if ((i >= earlier) != last_round) continue;
          if (room > norm(end - free_place) || (last_round && place_between(i, end))) continue;
          const auto contact = obstacles.contact_near(point_at(origin, end), kObstacleDepth, kObstacleDepth);
          const double distance = contact ? contact->distance : kObstacleDepth;
          if (distance >= kObstacleReach) {
            free_place = end;
            room = static_cast<float>(distance - kObstacleReach - kRounding);
            continue;
          }
          add_plane(i, to_float4(contact->normal), end, static_cast<float>(distance), 0);
        }
      }
    }
  }

  // error: of the distance.
  void add_plane(std::uint32_t i, Float4 normal, Float4 end, float distance, float error) {
    plane_of[i] = static_cast<std::uint32_t>(planes.size());
    const float offset = dot(normal, end) + static_cast<float>(options.clearance_m) - distance;
    planes.push_back({i, normal, offset, end, distance - error});
  }

  // The plane of a vertex that halves an edge from those of the edge's ends, where the obstacle bends little between
  // them.
  bool place_between(std::uint32_t i, Float4 end) {
    const auto [first, second] = subdivision.halved_edges[i];
    if (plane_of[first] == kUnmeasured || plane_of[second] == kUnmeasured) return false;
    const ObstaclePlane &a = planes[plane_of[first]], &b = planes[plane_of[second]];
    const Float4 sum = a.normal + b.normal;
    // How far the obstacle rises between them, as an arc does over its chord.
    const float rise = dot(b.normal - a.normal, b.place - a.place) / 8;
    if (std::abs(rise) > kMostRise || dot(a.normal, b.normal) < kLeastTurn) return false;
    const Float4 normal = sum / norm(sum);
    const float distance = 0.5f * (a.distance + b.distance) + dot(normal, end - 0.5f * (a.place + b.place)) - rise;
    add_plane(i, normal, end, distance, std::abs(rise));
    return true;
  }

  // Moves vertices at x and, beyond what they approached within the step, where they came from: what overlapped before
  // is taken apart without a velocity.
  void keep_out() {
    for (const ObstaclePlane& plane : planes) {
      const std::uint32_t i = plane.vertex;
      const float depth = plane.offset - dot(plane.normal, x[i]);
      if (depth <= 0 || fixed[i]) continue;
      const float approach = std::max(0.0f, dot(plane.normal, before[i] - x[i]));
      x[i] += depth * plane.normal;
      before[i] += std::max(0.0f, depth - approach) * plane.normal;
      // Along the obstacle with the coarse cloth, which has met its friction.
      Float4 slide = x[i] - before[i] - way[i] / static_cast<float>(steps);
      slide -= dot(plane.normal, slide) * plane.normal;
      const float length = std::sqrt(dot(slide, slide));
      if (length > 0) x[i] -= std::min(1.0f, kObstacleFriction * depth / length) * slide;
    }
  }

  void sort_layers() {
    for (const LayerContact& c : layer_contacts) {
      const auto between = [&c](const std::vector<Float4>& at) {
        return dot(c.normal, at[c.vertex] - c.weights[0] * at[c.face[0]] - c.weights[1] * at[c.face[1]] -
                                 c.weights[2] * at[c.face[2]]);
      };
      const float distance = between(x);
      if (distance >= c.gap) continue;
      const float depth = c.gap - distance, approach = std::max(0.0f, between(before) - distance);
      const float velocity_part = std::min(depth, approach);
      // Taken apart by a tenth a step, so that layers that are far through each other do not jump.
      const float place_part = 0.1f * (depth - velocity_part);
      const auto mobility = [&](std::uint32_t vertex) { return fixed[vertex] ? 0.0f : inverse_masses[vertex]; };
      float sum = mobility(c.vertex);
      for (std::size_t k = 0; k < 3; ++k) sum += c.weights[k] * c.weights[k] * mobility(c.face[k]);
      if (sum <= 0) continue;
      const auto push = [&](std::uint32_t vertex, float weight) {
        const Float4 direction = (weight * mobility(vertex) / sum) * c.normal;
        x[vertex] += (velocity_part + place_part) * direction;
        before[vertex] += place_part * direction;
      };
      push(c.vertex, 1);
      for (std::size_t k = 0; k < 3; ++k) push(c.face[k], -c.weights[k]);
    }
  }

  void step(int index, bool guided, bool restarted) {
    const float middle = (static_cast<float>(index) + 0.5f) / static_cast<float>(steps);
    const float end = (static_cast<float>(index) + 1) / static_cast<float>(steps);
    if (index % kPullEvery == 0) {
      const float time = middle + static_cast<float>(kPullEvery - 1) / (2 * static_cast<float>(steps));
      const float inverse = 1 / frame_s;
      tracking.update(
          [&](std::uint32_t i) {
            return Tracking::Lack{from[i] + time * way[i] - x[i], inverse * way[i] - v[i], v[i]};
          },
          static_cast<float>(options.frequency), static_cast<float>(kPullEvery) * step_s);
      for (std::uint32_t i = 0; i < count; ++i) pull[i] = tracking.at(i);
    }
    // The velocity with which a cloth without a state begins has met gravity and air in this frame already.
    const Float4 gravity = restarted ? Float4{} : to_float4(options.gravity);
    const float drag = restarted ? 0 : step_s * static_cast<float>(options.air_density / options.material.density);
    const Float4 air = to_float4(options.air_velocity);
    const float viscous = viscosity.share(step_s), along = std::min(1.0f, kDetailDamping * step_s);
    const float per_frame = 1 / frame_s, per_step = 1 / step_s;
    for (std::uint32_t i = 0; i < count; ++i) {
      before[i] = x[i];
      Float4 velocity = v[i] + viscous * viscosity.lack(i, v);
      Float4 acceleration = gravity + pull[i];
      if (guided) {
        acceleration += kStartFrequency * kStartFrequency * (given[i] - (1 - middle) * way[i] - x[i]);
      }
      if (tangled[i] > 0) {
        const float frequency = tangled[i] * kTangleFrequency;
        const Float4 place = guided ? given[i] - (1 - middle) * way[i] : from[i] + middle * way[i];
        acceleration += frequency * frequency * (place - x[i]) + 2 * frequency * (per_frame * way[i] - velocity);
      }
      velocity += step_s * acceleration;
      velocity -= along * (velocity - per_frame * way[i]);
      const float across = dot(normals[i], velocity - air);
      velocity -= (across - across / (1 + drag * std::abs(across))) * normals[i];
      x[i] += step_s * velocity;
    }
    for (const std::uint32_t i : pins) x[i] = from[i] + end * way[i];
    levels.solve(x);
    faces.solve(x, false);
    hinges.solve(x);
    tracking.hold(
        [&](std::uint32_t i) {
          return Tracking::Lack{from[i] + end * way[i] - x[i], per_frame * way[i] - per_step * (x[i] - before[i]), {}};
        },
        step_s, down, x);
    for (const std::uint32_t i : pins) x[i] = from[i] + end * way[i];
    smooth_tangles();
    sort_layers();
    keep_out();
    for (std::uint32_t i = 0; i < count; ++i) v[i] = per_step * (x[i] - before[i]);
  }

  // The obstacles as they are, not planes.
  void leave_obstacles(const Eigen::Vector3d& origin) {
    for (const ObstaclePlane& plane : planes) {
      const std::uint32_t i = plane.vertex;
      // As in find_planes(): most are as far away as they were.
      const auto room = plane.distance - static_cast<float>(options.clearance_m + kRounding);
      if (fixed[i] || room > norm(x[i] - plane.place)) continue;
      const auto contact = obstacles.contact_near(point_at(origin, x[i]), options.clearance_m, kObstacleReach);
      if (!contact || contact->distance >= options.clearance_m) continue;
      x[i] += to_float4((options.clearance_m - contact->distance) * contact->normal);
    }
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
  // Near the cloth float32 is exact enough, however far that is from the origin.
  const Eigen::Vector3d origin = frame.coarse.cast<double>().colwise().mean().transpose();
  const auto local = [&](const Positions& positions) -> Positions {
    return (positions.cast<double>().rowwise() - origin.transpose()).cast<float>();
  };
  const Positions coarse = local(frame.coarse);
  const Positions to = upsample(w.subdivision, w.coarse.faces, coarse);
  const Positions way = w.frame_s * upsample(w.subdivision, w.coarse.faces, frame.coarse_velocities);
  const Positions given = frame.start != nullptr ? local(*frame.start) : Positions();
  for (std::uint32_t i = 0; i < w.count; ++i) {
    w.way[i] = to_float4(way.row(i).transpose());
    w.from[i] = to_float4(to.row(i).transpose());
    if (frame.start != nullptr) w.given[i] = to_float4(given.row(i).transpose());
  }
  FoldReport report;
  report.steps = w.steps;
  for (std::uint32_t i = 0; i < w.count; ++i) w.from[i] -= w.way[i];
  w.hold(frame.held);
  report.restarted = w.begin(state, origin);
  const auto contact_start = Clock::now();
  const bool guided = frame.start != nullptr;
  if (guided && !report.restarted) w.follow_start();
  for (std::uint32_t i = 0; i < w.count; ++i) {
    w.moved[i] = to_float4(to.row(i).transpose());
    w.before[i] = w.x[i] + w.way[i];
  }
  w.layer_contacts = w.layers.find(coarse, w.moved, w.before, kLayerReach, static_cast<float>(w.options.thickness_m));
  w.find_touching(frame.coarse);
  w.find_planes(origin);
  report.contact_ms = milliseconds(contact_start);
  std::fill(w.tangled.begin(), w.tangled.end(), 0.0f);
  if (!report.restarted) w.find_tangles(state.positions);
  w.find_normals();
  for (int index = 0; index < w.steps; ++index) w.step(index, guided, report.restarted);
  w.leave_obstacles(origin);
  report.layer_contacts = w.layer_contacts.size();
  report.obstacle_contacts = w.planes.size();
  state.positions.resize(w.count, 3);
  state.velocities.resize(w.count, 3);
  for (std::uint32_t i = 0; i < w.count; ++i) {
    for (int k = 0; k < 3; ++k) {
      state.positions(i, k) = static_cast<float>(static_cast<double>(w.x[i][k]) + origin[k]);
      state.velocities(i, k) = w.v[i][k];
    }
  }
  report.ms = milliseconds(start);
  return report;
}

}  // namespace pleat::fold
