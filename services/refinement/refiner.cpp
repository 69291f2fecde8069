#include "services/refinement/refiner.hpp"

#include <chrono>
#include <cmath>
#include <string>

#include "common/base/error.hpp"
#include "services/refinement/impact_zones.hpp"
#include "services/refinement/obstacle_field.hpp"
#include "services/refinement/obstacle_push.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat {
namespace {

// More intersecting pairs than this are no wrinkles gone astray: the whole mesh is one zone then.
constexpr std::size_t kMaxPairs = 50'000;

void check(const RefinementOptions& o) {
  const auto require = [](bool ok, const char* what) {
    if (!ok) throw_invalid_argument(std::string("refinement options: ") + what);
  };
  require(o.clearance_m >= 0 && o.clearance_m <= 0.1, "the clearance must be 0 to 0.1 m");
  require(o.obstacle_rounds >= 0 && o.obstacle_rounds <= 10, "obstacle rounds must be 0 to 10");
  require(o.bisections >= 1 && o.bisections <= 20, "bisections must be 1 to 20");
  require(o.rounds >= 1 && o.rounds <= 20, "rounds must be 1 to 20");
}

void check(const Positions& positions, Eigen::Index count, const char* name) {
  if (positions.rows() != count) {
    throw_invalid_argument("refinement: " + std::to_string(positions.rows()) + " " + name +
                           " positions for a mesh of " + std::to_string(count) + " vertices");
  }
  if (!positions.allFinite()) throw_invalid_argument(std::string("refinement: ") + name + " positions are not finite");
}

// The offences of one state of a mesh.
struct Offences {
  std::vector<FacePair> pairs;
  bool all_pairs = true;  // fewer than the limit
  std::vector<std::uint32_t> penetrations;
  bool none() const { return pairs.empty() && penetrations.empty(); }
  std::size_t count() const { return pairs.size() + penetrations.size(); }
};

Offences find_offences(const Positions& positions, const ObstacleField& field, const SelfIntersectionFinder& finder) {
  Offences offences;
  offences.all_pairs = finder.find(positions, kMaxPairs, offences.pairs);
  offences.penetrations = find_penetrations(positions, field, finder);
  return offences;
}

}  // namespace

struct Refiner::State {
  Faces coarse_faces;
  Subdivision subdivision;
  RefinementOptions options;
  ObstacleField field;
  SelfIntersectionFinder coarse_finder, fine_finder;
  Neighbourhood neighbourhood;
  ObstaclePush push;

  State(const Topology& coarse, const Subdivision& s, std::span<const ObstacleShape> obstacles,
        const RefinementOptions& o)
      : coarse_faces(coarse.faces),
        subdivision(s),
        options(o),
        field(obstacles),
        coarse_finder(coarse.faces, coarse.vertex_count()),
        fine_finder(s.fine.faces, s.fine.vertex_count(), coarse.faces),
        neighbourhood(build_neighbourhood(s.fine.faces, s.fine.vertex_count())),
        push(s.fine.faces, s.fine.vertex_count(), o.obstacle_rounds) {}

  bool coarse_is_clean(const Positions& coarse) {
    coarse_finder.update(coarse);
    std::vector<FacePair> pairs;
    return coarse_finder.find(coarse, 0, pairs) && find_penetrations(coarse, field, coarse_finder).empty();
  }
};

Refiner::Refiner(const Topology& coarse, const Subdivision& subdivision, std::span<const ObstacleShape> obstacles,
                 const RefinementOptions& options) {
  check(options);
  validate_topology(coarse, "coarse mesh");
  validate_topology(subdivision.fine, "fine mesh");
  if (static_cast<Eigen::Index>(subdivision.feature_vertices.size()) != coarse.vertex_count()) {
    throw_invalid_argument("refinement: the fine mesh is not a subdivision of the coarse mesh");
  }
  state_ = std::make_unique<State>(coarse, subdivision, obstacles, options);
}

Refiner::~Refiner() = default;
Refiner::Refiner(Refiner&&) noexcept = default;
Refiner& Refiner::operator=(Refiner&&) noexcept = default;

RefinedMesh Refiner::refine(const Positions& coarse, const Positions& fine, std::span<const ObstacleFrame> obstacles) {
  const auto start = std::chrono::steady_clock::now();
  State& s = *state_;
  check(coarse, static_cast<Eigen::Index>(s.subdivision.feature_vertices.size()), "coarse");
  check(fine, s.subdivision.fine.vertex_count(), "fine");
  s.field.update(obstacles);

  RefinedMesh result{fine, {}};
  RefinementReport& report = result.report;
  const bool coarse_clean = s.coarse_is_clean(coarse);
  report.input_intersects = !coarse_clean;
  s.fine_finder.update(fine);
  const Offences before = find_offences(fine, s.field, s.fine_finder);
  report.pairs_before = before.pairs.size();
  report.penetrations_before = before.penetrations.size();

  Offences now = before;
  if (s.push.apply(result.positions, s.field, s.fine_finder, s.options.clearance_m)) {
    now = find_offences(result.positions, s.field, s.fine_finder);
  }
  if (!now.none()) {
    const Positions wanted = result.positions;
    const Positions safe = upsample(s.subdivision, s.coarse_faces, coarse);
    const BlendProblem problem{&safe, &wanted, &s.field, &s.neighbourhood, s.options.bisections, coarse_clean};
    for (int round = 0; round < s.options.rounds && !now.none(); ++round) {
      const bool all = !now.all_pairs || (coarse_clean && round + 1 == s.options.rounds);
      report.zones += resolve_zones(problem, now.pairs, now.penetrations, all, result.positions, s.fine_finder);
      ++report.rounds;
      const std::size_t earlier = now.count();
      now = find_offences(result.positions, s.field, s.fine_finder);
      if (!coarse_clean && now.count() >= earlier) break;
    }
    if (now.count() > before.count()) {
      result.positions = fine;
      now = before;
    }
  }

  report.pairs_after = now.pairs.size();
  report.penetrations_after = now.penetrations.size();
  for (Eigen::Index v = 0; v < fine.rows(); ++v) {
    const float squared = (result.positions.row(v) - fine.row(v)).squaredNorm();
    if (squared == 0) continue;
    ++report.vertices_moved;
    report.largest_move_m = std::max(report.largest_move_m, std::sqrt(static_cast<double>(squared)));
  }
  report.ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace pleat
