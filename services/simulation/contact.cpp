#include "services/simulation/contact.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "common/base/error.hpp"
#include "services/simulation/obstacles.hpp"
#include "services/simulation/union_find.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

// Metres. Cut steps stop pairs here: well above the rounding of a frame's float32.
constexpr double kFloor = 2e-6;
constexpr int kProjectionRounds = 24;
constexpr int kRigidRounds = 40;
constexpr int kCutRounds = 100;  // some ten are usual

// The quarter of the mean edge keeps the neighbours of a vertex out of its repulsion layer.
double repulsion_thickness(const Topology& cloth, const Points& rest, double wanted) {
  double sum = 0;
  for (Eigen::Index f = 0; f < cloth.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) sum += (rest[cloth.faces(f, k)] - rest[cloth.faces(f, (k + 1) % 3)]).norm();
  }
  return std::min(wanted, 0.25 * sum / (3.0 * static_cast<double>(cloth.face_count())));
}

}  // namespace

ContactSystem::ContactSystem(const Topology& cloth, const Points& rest, std::vector<double> areas, const Scene& scene)
    : scene_(scene),
      cloth_count_(static_cast<std::size_t>(cloth.vertex_count())),
      cloth_faces_(static_cast<std::size_t>(cloth.face_count())),
      areas_(std::move(areas)) {
  thickness_ = repulsion_thickness(cloth, rest, scene.contact.thickness);
  slack_ = 0.1 * thickness_;
  std::size_t particles = 0;
  std::vector<char> vertex_owned;
  const auto add_mesh = [&](Eigen::Index vertices, const Faces& faces) {
    const auto first = static_cast<std::uint32_t>(particles);
    const auto first_edge = static_cast<std::uint32_t>(edges_.size());
    const Connectivity connectivity = build_connectivity(vertices, faces);
    std::vector<char> edge_owned(connectivity.edges.size(), 0);
    vertex_owned.resize(particles + static_cast<std::size_t>(vertices), 0);
    for (const Edge& edge : connectivity.edges) edges_.push_back({first + edge.v0, first + edge.v1});
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      std::array<std::uint32_t, 3> face{}, own_edges{kNone, kNone, kNone}, own_vertices{kNone, kNone, kNone};
      for (std::size_t k = 0; k < 3; ++k) {
        face[k] = first + faces(f, static_cast<Eigen::Index>(k));
        const std::uint32_t edge = connectivity.face_edges[static_cast<std::size_t>(f)][k];
        if (!std::exchange(edge_owned[edge], 1)) own_edges[k] = first_edge + edge;
        if (!std::exchange(vertex_owned[face[k]], 1)) own_vertices[k] = face[k];
      }
      faces_.push_back(face);
      std::uint8_t bits = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        if (own_vertices[k] != kNone) bits |= static_cast<std::uint8_t>(1u << k);
        if (own_edges[k] != kNone) bits |= static_cast<std::uint8_t>(8u << k);
      }
      own_bits_.push_back(bits);
      own_edges_.push_back(own_edges);
    }
    particles += static_cast<std::size_t>(vertices);
  };
  add_mesh(cloth.vertex_count(), cloth.faces);
  for (const Obstacle& obstacle : scene.obstacles) {
    first_particle_.push_back(static_cast<std::uint32_t>(particles));
    first_face_.push_back(static_cast<std::uint32_t>(faces_.size()));
    if (obstacle.mesh.face_count() > 0) {
      add_mesh(obstacle.mesh.vertex_count(), obstacle.mesh.faces);
    } else {
      const auto first = static_cast<std::uint32_t>(particles);
      if (obstacle.radius > 0) rounds_.push_back({first, kNone, obstacle.radius});
      for (std::uint32_t c = 0; c < obstacle.capsules.size(); ++c) {
        rounds_.push_back({first + 2 * c, first + 2 * c + 1, obstacle.capsules[c].radius});
      }
      particles += point_count(obstacle);
    }
  }
  first_particle_.push_back(static_cast<std::uint32_t>(particles));
  first_face_.push_back(static_cast<std::uint32_t>(faces_.size()));
  particle_count_ = particles;

  // The hierarchy is built over the rest shape, where near on the surface means near in space.
  cloth_bvh_ = SweptBvh(std::span(faces_).first(cloth_faces_), rest);
  if (faces_.size() > cloth_faces_) {
    Points points(cloth_count_, Vector3d::Zero());
    const Points obstacles = obstacle_particles(0);
    points.insert(points.end(), obstacles.begin(), obstacles.end());
    obstacle_bvh_ = SweptBvh(std::span(faces_).subspan(cloth_faces_), points);
  }
  face_areas_.assign(faces_.size(), 1e30);
  for (std::size_t f = 0; f < cloth_faces_; ++f) {
    const auto& v = faces_[f];
    face_areas_[f] = (rest[v[1]] - rest[v[0]]).cross(rest[v[2]] - rest[v[0]]).norm() / 2;
  }
  boxes_.resize(particle_count_);
  moving_.resize(particle_count_);
  find_neighbours();
  find_layers();
}

// The children of a coarse face are as many of the finer mesh's faces, in its order (subdivide()).
void ContactSystem::find_layers() {
  if (scene_.layers.empty()) return;
  const std::size_t children = cloth_faces_ / static_cast<std::size_t>(scene_.garment.face_count());
  layers_.assign(cloth_count_, 0);
  std::size_t f = 0;
  for (std::uint32_t l = 0; l < scene_.layers.size(); ++l) {
    const std::size_t last = f + children * static_cast<std::size_t>(scene_.layers[l].faces);
    for (; f < last; ++f) {
      for (const std::uint32_t v : faces_[f]) layers_[v] = l;
    }
  }
}

ClosestPoints ContactSystem::closest(const Pair& pair, const Points& x) const {
  const auto& v = pair.v;
  return pair.kind == Kind::kEdgeEdge ? closest_edge_edge(x[v[0]], x[v[1]], x[v[2]], x[v[3]])
                                      : closest_vertex_face(x[v[0]], x[v[1]], x[v[2]], x[v[3]]);
}

std::optional<Collision> ContactSystem::collide(const Pair& pair, const Points& start, const Points& end) const {
  const auto& v = pair.v;
  const std::array<Vector3d, 4> from{start[v[0]], start[v[1]], start[v[2]], start[v[3]]};
  const std::array<Vector3d, 4> to{end[v[0]], end[v[1]], end[v[2]], end[v[3]]};
  const CcdOptions options{static_cast<double>(pair.minimum), kGap, 256};
  return pair.kind == Kind::kEdgeEdge ? edge_edge_ccd(from, to, options) : vertex_face_ccd(from, to, options);
}

// The side of a capsule: the ends of the edge once each where they face the segment. Its caps are spheres.
template <typename Add>
void ContactSystem::repel_from_capsule(const Pair& pair, const Points& x, std::vector<std::uint32_t>& touched,
                                       const Add& add) const {
  const auto marker = static_cast<std::uint32_t>(particle_count_) + pair.v[2];
  const Vector3d &a = x[pair.v[2]], &b = x[pair.v[3]];
  for (std::size_t k = 0; k < 2; ++k) {
    const std::uint32_t end = pair.v[k];
    const double t = closest_on_segment(x[end], a, b);
    if (t <= 0 || t >= 1 || touched[end] == marker) continue;
    touched[end] = marker;
    const Vector3d d = x[end] - a - t * (b - a);
    const double length = d.norm(), clearance = length - static_cast<double>(pair.minimum);
    if (clearance >= thickness_ || length <= 0) continue;
    add({end, pair.v[2], pair.v[3], kNone}, {1, t - 1, -t, 0}, d / length, clearance, areas_[end],
        scene_.contact.obstacle_friction);
  }
}

std::vector<ContactForce> ContactSystem::repulsion(const Points& x, const Points& v, std::span<const double> masses,
                                                   double time_s, double step_s, ThreadPool& pool) {
  // Pairs found for almost the same positions still hold everything within the thickness.
  bool reuse = pairs_end_.size() == x.size();
  for (std::size_t i = 0; reuse && i < x.size(); ++i) reuse = (x[i] - pairs_end_[i]).squaredNorm() <= slack_ * slack_;
  if (!reuse) find_pairs(x, x, pool);

  std::vector<ContactForce> forces;
  const double grown = kLayerSpeed * time_s;
  const bool grows = !start_lag_.empty() && grown < thickness_;
  const auto add = [&](const std::array<std::uint32_t, 4>& particles, const std::array<double, 4>& weights,
                       const Vector3d& normal, double distance, double area, double friction_coefficient) {
    double violation = thickness_ - distance;
    if (grows && std::any_of(particles.begin(), particles.end(),
                             [&](std::uint32_t particle) { return particle >= cloth_count_ && particle != kNone; })) {
      double lag = 0;
      for (std::size_t k = 0; k < 4; ++k) {
        if (particles[k] < cloth_count_ && weights[k] != 0) lag = std::max(lag, start_lag_[particles[k]] - grown);
      }
      violation -= lag;
      if (violation <= 0) return;
    }
    const double stiffness = scene_.contact.stiffness * area;
    ContactForce c;
    Vector3d approach = Vector3d::Zero();
    double mobility = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      const bool free = particles[k] < cloth_count_;
      c.vertices[k] = free && weights[k] != 0 ? particles[k] : kNone;
      c.weights[k] = static_cast<float>(weights[k]);
      if (particles[k] == kNone) continue;
      approach += weights[k] * v[particles[k]];
      if (free) mobility += weights[k] * weights[k] / masses[particles[k]];
    }
    const double force = stiffness * violation * violation / (2 * thickness_);
    const double sliding = (approach - normal * normal.dot(approach)).norm();
    double friction = 0;
    if (mobility > 0 && sliding > 0)
      friction = std::min(friction_coefficient * force / sliding, 1 / (step_s * mobility));
    c.normal = normal.cast<float>();
    c.force = static_cast<float>(force);
    c.stiffness = static_cast<float>(stiffness * violation / thickness_);
    c.friction = static_cast<float>(friction);
    c.approach = approach.cast<float>();
    forces.push_back(c);
  };

  std::vector<std::uint32_t> touched(cloth_count_, kNone);
  for (const Pair& pair : pairs_) {
    const ClosestPoints points = closest(pair, x);
    const double distance = std::sqrt(points.squared_distance);
    const double clearance = distance - static_cast<double>(pair.minimum);
    if (clearance >= thickness_ || distance <= 0) continue;
    if (pair.kind == Kind::kSphereFace) {
      // The corners once each; besides them the face itself where the sphere touches between the corners.
      const std::uint32_t center = pair.v[0];
      for (std::size_t k = 1; k < 4; ++k) {
        const std::uint32_t corner = pair.v[k];
        const Vector3d d = x[corner] - x[center];
        const double length = d.norm(), corner_clearance = length - static_cast<double>(pair.minimum);
        if (corner_clearance >= thickness_ || touched[corner] == center) continue;
        touched[corner] = center;
        add({corner, center, kNone, kNone}, {1, -1, 0, 0}, d / length, corner_clearance, areas_[corner],
            scene_.contact.obstacle_friction);
      }
      const double largest = -*std::min_element(points.weights.begin() + 1, points.weights.end());
      if (largest < 0.9) {
        const auto& w = points.weights;
        add({pair.v[1], pair.v[2], pair.v[3], center}, {-w[1], -w[2], -w[3], -1}, -points.difference / distance,
            clearance, areas_[pair.v[1]], scene_.contact.obstacle_friction);
      }
      continue;
    }
    if (pair.kind == Kind::kEdgeEdge && pair.minimum > 0) repel_from_capsule(pair, x, touched, add);
    if (!points.interior) continue;
    const bool obstacle = pair.v[0] >= cloth_count_ || pair.v[2] >= cloth_count_;
    double area = 1e30;
    for (std::size_t k = 0; k < 4; ++k) {
      if (pair.v[k] < cloth_count_) area = std::min(area, areas_[pair.v[k]]);
    }
    add(pair.v, points.weights, points.difference / distance, clearance, area,
        obstacle ? scene_.contact.obstacle_friction : scene_.contact.friction);
  }
  return forces;
}

// The end positions nearest to the given ones (in the metric of the masses) that respect the impacts: projected
// Gauss-Seidel on the multipliers, which start from those of the last round.
void ContactSystem::project(std::vector<Impact>& impacts, std::span<const double> inverse_masses, Points& end) const {
  for (int sweep = 0; sweep < 64; ++sweep) {
    double worst = 0;
    for (Impact& impact : impacts) {
      double mobility = 0, value = -impact.distance;
      for (std::size_t k = 0; k < 4; ++k) {
        mobility += impact.weights[k] * impact.weights[k] * inverse_mass(inverse_masses, impact.pair.v[k]);
        value += impact.weights[k] * impact.normal.dot(end[impact.pair.v[k]]);
      }
      if (mobility <= 0) continue;
      const double next = std::max(0.0, impact.multiplier - value / mobility);
      const double delta = next - impact.multiplier;
      impact.multiplier = next;
      worst = std::max(worst, std::abs(delta) * mobility);
      for (std::size_t k = 0; k < 4; ++k) {
        const double w = impact.weights[k] * inverse_mass(inverse_masses, impact.pair.v[k]);
        if (w != 0) end[impact.pair.v[k]] += delta * w * impact.normal;
      }
    }
    if (worst < 0.5 * kGap) break;
  }
}

// Lets every zone (what impacts connect) move as its centre of mass does, or as the obstacle in it: inside a zone
// nothing moves relative to anything. Returns false if prescribed particles of one zone move differently.
bool ContactSystem::move_rigidly(const std::vector<Impact>& impacts, std::span<const double> inverse_masses,
                                 const Points& start, Points& end, std::uint64_t& zones) const {
  struct Zone {
    double mass = 0;
    Vector3d motion = Vector3d::Zero();
    bool prescribed = false;
    bool counted = false;
  };
  UnionFind sets(particle_count_);
  std::vector<char> member(particle_count_, 0);
  for (const Impact& impact : impacts) {
    for (const std::uint32_t v : impact.pair.v) {
      sets.join(impact.pair.v[0], v);
      member[v] = 1;
    }
  }
  std::vector<Zone> zone(particle_count_);
  for (std::uint32_t i = 0; i < particle_count_; ++i) {
    if (!member[i]) continue;
    Zone& z = zone[sets.root(i)];
    if (!std::exchange(z.counted, true)) ++zones;
    const Vector3d motion = end[i] - start[i];
    const double inverse = inverse_mass(inverse_masses, i);
    if (inverse <= 0) {
      if (z.prescribed && (motion - z.motion).norm() > 1e-12) return false;
      z.prescribed = true;
      z.motion = motion;
    } else if (!z.prescribed) {
      z.motion = (z.mass * z.motion + motion / inverse) / (z.mass + 1 / inverse);
      z.mass += 1 / inverse;
    }
  }
  for (std::uint32_t i = 0; i < particle_count_; ++i) {
    if (member[i] && inverse_mass(inverse_masses, i) > 0) end[i] = start[i] + zone[sets.root(i)].motion;
  }
  return true;
}

// One attempt: rounds of projections, then of rigid zones, until nothing collides. Returns false if that does not
// happen; `end` is of no use then. impacts: those met.
bool ContactSystem::resolve_rounds(const Points& start, Points& end, std::span<const double> inverse_masses,
                                   ThreadPool& pool, std::vector<Impact>& impacts, Resolution& result) {
  find_pairs(start, end, pool);
  const double most = 0.1 * thickness_;
  impacts.clear();
  std::map<std::pair<Kind, std::array<std::uint32_t, 4>>, std::size_t> impact_of;
  std::vector<char> changed(particle_count_, 1);

  constexpr std::size_t kGrain = 1024;
  std::vector<std::vector<Impact>> found;
  for (int round = 0;; ++round) {
    found.assign((pairs_.size() + kGrain - 1) / kGrain, {});
    pool.parallel_for(pairs_.size(), kGrain, [&](std::size_t begin, std::size_t last) {
      for (std::size_t p = begin; p < last; ++p) {
        const Pair& pair = pairs_[p];
        if (!changed[pair.v[0]] && !changed[pair.v[1]] && !changed[pair.v[2]] && !changed[pair.v[3]]) continue;
        const auto collision = collide(pair, start, end);
        if (!collision) continue;
        const double distance = std::sqrt(collision->closest.squared_distance);
        Impact impact{pair, collision->closest.weights, Vector3d::Zero(), 0, 0};
        if (distance > 0) impact.normal = collision->closest.difference / distance;
        const double before = std::sqrt(closest(pair, start).squared_distance) - static_cast<double>(pair.minimum);
        impact.distance = static_cast<double>(pair.minimum) + std::min(most, std::max(before, 5 * kGap));
        found[begin / kGrain].push_back(impact);
      }
    });
    std::size_t new_impacts = 0;
    for (const auto& list : found) new_impacts += list.size();
    if (new_impacts == 0) return true;
    if (stopped_ && stopped_()) throw Error(ErrorCode::kCancelled, "cancelled");
    result.impacts += new_impacts;
    ++result.rounds;

    // The latest geometry of a pair replaces what earlier rounds knew about it.
    bool solvable = true;
    for (const auto& list : found) {
      for (const Impact& impact : list) {
        const auto [known, inserted] = impact_of.try_emplace({impact.pair.kind, impact.pair.v}, impacts.size());
        if (inserted) {
          impacts.push_back(impact);
        } else {
          // Its push so far stays in `end`; the new constraint starts from there.
          impacts[known->second] = impact;
        }
        // A handle that is led into an obstacle: neither yields.
        solvable = solvable && std::any_of(impact.pair.v.begin(), impact.pair.v.end(),
                                           [&](std::uint32_t v) { return inverse_mass(inverse_masses, v) > 0; });
      }
    }
    if (wanted_.empty()) wanted_ = end;  // nothing has moved it yet
    if (!solvable || round >= kProjectionRounds + kRigidRounds) return false;
    before_ = end;
    if (round < kProjectionRounds) {
      project(impacts, inverse_masses, end);
    } else if (!move_rigidly(impacts, inverse_masses, start, end, result.rigid_zones)) {
      return false;
    }
    bool far = false;
    for (std::size_t i = 0; i < end.size(); ++i) {
      changed[i] = end[i] != before_[i];
      far = far || (end[i] - pairs_end_[i]).squaredNorm() > slack_ * slack_;
    }
    // What collided is looked at again even if nothing could move it.
    for (const auto& list : found) {
      for (const Impact& impact : list) {
        for (const std::uint32_t v : impact.pair.v) changed[v] = 1;
      }
    }
    if (far) find_pairs(start, end, pool);
  }
}

// The last resort, from wanted_, can't fail: what collides makes a part of its motion only, at the third collision none
// of it; an obstacle as a whole. What stands still is as clean as the start was, and in the end everything may stand
// still.
// Returns how many vertices of the cloth were stopped.
std::uint64_t ContactSystem::cut(const Points& start, Points& end, ThreadPool& pool) {
  const auto body = [&](std::uint32_t particle) {
    return particle < cloth_count_ ? particle : first_particle_[obstacle_of(particle)];
  };
  std::vector<double> part(particle_count_, 1.0), next(particle_count_);
  std::vector<std::uint8_t> collisions(particle_count_, 0), hit(particle_count_);
  constexpr std::size_t kGrain = 1024;
  std::vector<double> times;
  for (int round = 0; round < kCutRounds; ++round) {
    find_pairs(start, end, pool);
    times.assign(pairs_.size(), 2);
    pool.parallel_for(pairs_.size(), kGrain, [&](std::size_t begin, std::size_t last) {
      for (std::size_t p = begin; p < last; ++p) {
        // Cut after cut must not wear the clearance down: a pair at the floor may part, but not come closer.
        Pair guarded = pairs_[p];
        const double clearance =
            std::sqrt(closest(guarded, start).squared_distance) - static_cast<double>(guarded.minimum);
        guarded.minimum += static_cast<float>(std::min(kFloor, 0.999 * clearance));
        if (const auto collision = collide(guarded, start, end)) times[p] = collision->time;
      }
    });
    next = part;
    std::fill(hit.begin(), hit.end(), std::uint8_t{0});
    bool clean = true;
    for (std::size_t p = 0; p < pairs_.size(); ++p) {
      if (times[p] > 1) continue;
      clean = false;
      for (const std::uint32_t v : pairs_[p].v) {
        if (v == kNone) continue;
        const std::uint32_t b = body(v);
        hit[b] = 1;
        next[b] = std::min(next[b], collisions[b] < 2 ? 0.8 * times[p] * part[b] : 0.0);
      }
    }
    if (clean) {
      const auto cloth_end = part.begin() + static_cast<std::ptrdiff_t>(cloth_count_);
      return static_cast<std::uint64_t>(std::count_if(part.begin(), cloth_end, [](double made) { return made < 1; }));
    }
    part = next;
    for (std::uint32_t i = 0; i < particle_count_; ++i) {
      collisions[i] = static_cast<std::uint8_t>(collisions[i] + hit[i]);
      end[i] = start[i] + part[body(i)] * (wanted_[i] - start[i]);
    }
  }
  end = start;
  return cloth_count_;
}

Resolution ContactSystem::resolve(const Points& start, Points& end, std::span<const double> inverse_masses,
                                  std::span<const double> yielding, ThreadPool& pool) {
  Resolution result;
  std::vector<Impact> impacts;
  wanted_.clear();
  if (resolve_rounds(start, end, inverse_masses, pool, impacts, result)) return result;
  // What the rounds have made of it may be far out: every further attempt begins anew. Handles that met something give
  // way; then those too that come into it now.
  std::vector<double> masses(inverse_masses.begin(), inverse_masses.end());
  for (int attempt = 0; attempt < 2 && !yielding.empty(); ++attempt) {
    bool gives_way = false;
    for (const Impact& impact : impacts) {
      for (const std::uint32_t v : impact.pair.v) {
        if (v >= cloth_count_ || masses[v] > 0 || yielding[v] <= 0) continue;
        masses[v] = yielding[v];
        gives_way = true;
      }
    }
    if (!gives_way) break;
    result.yielded = true;
    end = wanted_;
    if (resolve_rounds(start, end, masses, pool, impacts, result)) return result;
  }
  end = wanted_;
  result.stopped = cut(start, end, pool);
  result.cut = true;
  return result;
}

}  // namespace pleat::simulation
