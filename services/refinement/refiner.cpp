#include "services/refinement/refiner.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/frame/obstacle_field.hpp"
#include "services/refinement/cloth_contacts.hpp"
#include "services/refinement/impact_zones.hpp"
#include "services/refinement/obstacle_push.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat::refinement {
namespace {

// Pairs are counted up to here.
constexpr std::size_t kMaxPairs = 50'000;
// More than one intersecting pair for so many faces are no wrinkles gone astray: the whole mesh gets one weight then.
constexpr std::size_t kFacesPerPair = 2;
// Searches while weights are lowered. Every one of them lowers something, so that this is not endless anyway.
constexpr std::size_t kMaxSearches = 200;
// After so many the steps are twice as large, this many times at most: a zone must not jump from frame to frame.
constexpr std::size_t kSearchesPerStep = 8, kLargestStep = 1;

void check(const RefinementOptions& o) {
  const auto require = [](bool ok, const char* what) {
    if (!ok) throw_invalid_argument(std::string("refinement options: ") + what);
  };
  require(o.clearance_m >= 0 && o.clearance_m <= 0.1, "the clearance must be 0 to 0.1 m");
  require(o.obstacle_rounds >= 0 && o.obstacle_rounds <= 10, "obstacle rounds must be 0 to 10");
  require(o.bisections >= 1 && o.bisections <= 10, "bisections must be 1 to 10");
  require(o.threads >= 0 && o.threads <= 1024, "threads must be 0 to 1024");
}

void check(const Positions& positions, Eigen::Index count, const char* name) {
  if (positions.rows() != count) {
    throw_invalid_argument("refinement: " + std::to_string(positions.rows()) + " " + name +
                           " positions for a mesh of " + std::to_string(count) + " vertices");
  }
  if (!all_finite(positions)) throw_invalid_argument(std::string("refinement: ") + name + " positions are not finite");
}

// The offences of one state of a mesh.
struct Offences {
  std::vector<FacePair> pairs;
  bool all_pairs = true;  // fewer than the limit
  std::vector<std::uint32_t> penetrations;
  bool none() const { return pairs.empty() && penetrations.empty(); }
  std::size_t count() const { return pairs.size() + penetrations.size(); }
};

}  // namespace

struct Refiner::State {
  Faces coarse_faces;
  Subdivision subdivision;
  RefinementOptions options;
  ThreadPool pool;
  ObstacleField field;
  SelfIntersectionFinder coarse_finder, fine_finder;
  ClothContacts coarse_contacts, fine_contacts;
  ImpactZones zones;
  ObstaclePush push;
  Offences offences;
  Positions wanted, safe;
  std::vector<std::uint32_t> faces, moved;
  std::vector<std::uint8_t> is_moved;
  std::size_t searches = 0;  // for weights, in this frame

  State(const Topology& coarse, const Subdivision& s, std::span<const ObstacleShape> obstacles,
        const RefinementOptions& o)
      : coarse_faces(coarse.faces),
        subdivision(s),
        options(o),
        pool(static_cast<std::size_t>(o.threads)),
        field(obstacles),
        coarse_finder(coarse.faces, coarse.vertex_count(), coarse.faces, &pool),
        fine_finder(s.fine.faces, s.fine.vertex_count(), coarse.faces, &pool),
        coarse_contacts(coarse.faces, coarse.vertex_count(), &pool),
        fine_contacts(s.fine.faces, s.fine.vertex_count(), &pool),
        zones(s.fine.faces, s.fine.vertex_count()),
        push(s.fine.faces, s.fine.vertex_count(), o.obstacle_rounds) {
    // Trees of the rest shape: no frame depends on which one came first.
    coarse_finder.update(coarse.rest_positions);
    fine_finder.update(s.fine.rest_positions);
    if (!obstacles.empty() && o.obstacle_rounds > 0) push.prepare();
  }

  bool coarse_is_clean(const Positions& coarse) {
    coarse_finder.update(coarse);
    coarse_contacts.update(coarse, field, coarse_finder);
    coarse_contacts.find_penetrations(coarse, field, coarse_finder, offences.penetrations);
    if (!offences.penetrations.empty()) return false;
    return coarse_finder.find(coarse, 0, offences.pairs);
  }

  // All offences of fine positions, but pairs only up to a limit.
  void find(const Positions& positions, std::size_t limit = kMaxPairs) {
    fine_finder.update(positions);
    fine_contacts.update(positions, field, fine_finder);
    fine_contacts.find_penetrations(positions, field, fine_finder, offences.penetrations);
    offences.all_pairs = fine_finder.find(positions, limit, offences.pairs);
  }
  // The same after the vertices of these patches moved.
  void find_again(const Positions& positions, std::span<const std::uint32_t> patches) {
    if (!offences.all_pairs) {
      find(positions);
      return;
    }
    offences.all_pairs = fine_finder.find_again(positions, patches, kMaxPairs, offences.pairs);
    fine_contacts.find_penetrations_again(positions, field, fine_finder, patches, offences.penetrations);
  }

  void lower_weights(Positions& positions);
  void blend_all(Positions& positions);
  std::span<const std::uint32_t> difference(const Positions& a, const Positions& b);
};

// Lowers the weights of what offends until nothing does, nothing can be lowered, or it takes too long.
void Refiner::State::lower_weights(Positions& positions) {
  const float step = std::ldexp(1.f, -options.bisections);
  const std::size_t hopeless = static_cast<std::size_t>(subdivision.fine.face_count()) / kFacesPerPair;
  for (searches = 0; !offences.none() && offences.pairs.size() <= hopeless && searches < kMaxSearches; ++searches) {
    faces.assign(offences.penetrations.begin(), offences.penetrations.end());
    for (const FacePair& pair : offences.pairs) faces.insert(faces.end(), pair.begin(), pair.end());
    // What a few small steps did not undo needs more: larger ones get there in half the searches.
    const float larger = static_cast<float>(std::size_t{1} << std::min(searches / kSearchesPerStep, kLargestStep));
    if (!zones.lower(faces, larger * step, positions)) break;
    find_again(positions, zones.moved_patches());
  }
}

// One weight for the whole mesh; at 0 it is the coarse surface.
void Refiner::State::blend_all(Positions& positions) {
  float clean = 0, unclean = 1;
  for (int i = 0; i < options.bisections; ++i) {
    const float middle = 0.5f * (clean + unclean);
    zones.set_all(middle, positions);
    ++searches;
    find(positions, 0);
    (offences.none() && offences.all_pairs ? clean : unclean) = middle;
  }
  zones.set_all(clean, positions);
  find(positions);
}

// The patches in which two states of the fine mesh differ.
std::span<const std::uint32_t> Refiner::State::difference(const Positions& a, const Positions& b) {
  moved.clear();
  is_moved.assign(fine_finder.patch_count(), 0);
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(a.rows()); ++v) {
    if (a(v, 0) == b(v, 0) && a(v, 1) == b(v, 1) && a(v, 2) == b(v, 2)) continue;
    for (const std::uint32_t p : fine_finder.patches_at(v)) {
      if (is_moved[p] == 0) moved.push_back(p);
      is_moved[p] = 1;
    }
  }
  return moved;
}

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
  RefinedMesh result;
  refine(coarse, fine, obstacles, result);
  return result;
}

void Refiner::refine(const Positions& coarse, const Positions& fine, std::span<const ObstacleFrame> obstacles,
                     RefinedMesh& result) {
  const auto start = std::chrono::steady_clock::now();
  State& s = *state_;
  check(coarse, static_cast<Eigen::Index>(s.subdivision.feature_vertices.size()), "coarse");
  check(fine, s.subdivision.fine.vertex_count(), "fine");
  s.field.update(obstacles);

  RefinementReport& report = result.report;
  report = {};
  result.positions = fine;
  const bool coarse_clean = s.coarse_is_clean(coarse);
  report.input_intersects = !coarse_clean;
  Offences& now = s.offences;
  s.find(fine);
  report.pairs_before = now.pairs.size();
  report.penetrations_before = now.penetrations.size();
  const std::size_t before = now.count();

  if (s.push.apply(result.positions, s.field, s.fine_finder, s.fine_contacts, s.options.clearance_m)) {
    s.find_again(result.positions, s.difference(fine, result.positions));
  }
  if (!now.none()) {
    s.wanted = result.positions;
    upsample(s.subdivision, s.coarse_faces, coarse, s.safe);
    s.zones.begin(s.safe, s.wanted, s.fine_finder);
    s.lower_weights(result.positions);
    if (!now.none() && coarse_clean) s.blend_all(result.positions);
    report.zones = s.zones.count();
    report.rounds = s.searches;
  }
  report.pairs_after = now.pairs.size();
  report.penetrations_after = now.penetrations.size();
  if (now.count() > before) {
    result.positions = fine;
    report.pairs_after = report.pairs_before;
    report.penetrations_after = report.penetrations_before;
  }

  double sum = 0;
  for (Eigen::Index v = 0; v < fine.rows(); ++v) {
    const float squared = (result.positions.row(v) - fine.row(v)).squaredNorm();
    if (squared == 0) continue;
    const double move = std::sqrt(static_cast<double>(squared));
    ++report.vertices_moved;
    sum += move;
    report.largest_move_m = std::max(report.largest_move_m, move);
  }
  report.mean_move_m = sum / static_cast<double>(fine.rows());
  report.ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace pleat::refinement
