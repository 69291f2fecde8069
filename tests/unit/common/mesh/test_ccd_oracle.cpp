// Continuous collision detection against brute force: millions of pairs, most of them built around a contact that is
// known, so that the truth costs nothing; degenerate ones in every combination.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <string>

#include "common/mesh/ccd.hpp"

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3d;
using Quad = std::array<Vec3, 4>;

// splitmix64: the cases must not cost more than what they test.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  std::uint64_t bits() {
    std::uint64_t z = state_ += 0x9e3779b97f4a7c15ull;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ z >> 27) * 0x94d049bb133111ebull;
    return z ^ z >> 31;
  }
  int below(int n) { return static_cast<int>(bits() % static_cast<std::uint64_t>(n)); }
  bool one_in(int n) { return below(n) == 0; }
  double in(double low, double high) { return low + (high - low) * static_cast<double>(bits() >> 11) * 0x1p-53; }
  Vec3 point() { return {in(-1, 1), in(-1, 1), in(-1, 1)}; }
  // On a lattice of eighths: sums and products with simple weights are exact.
  Vec3 lattice() {
    return {0.125 * static_cast<double>(below(17) - 8), 0.125 * static_cast<double>(below(17) - 8),
            0.125 * static_cast<double>(below(17) - 8)};
  }

 private:
  std::uint64_t state_;
};

Quad at(const Quad& start, const Quad& end, double t) {
  Quad x;
  for (std::size_t i = 0; i < 4; ++i) x[i] = start[i] + t * (end[i] - start[i]);
  return x;
}

double size_of(const Quad& start, const Quad& end) {
  double size = 0;
  for (std::size_t i = 0; i < 4; ++i)
    size = std::max({size, start[i].cwiseAbs().maxCoeff(), end[i].cwiseAbs().maxCoeff()});
  return size;
}

double to_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 d = b - a;
  const double length2 = d.squaredNorm();
  if (length2 == 0) return (p - a).norm();
  return (p - a - std::clamp((p - a).dot(d) / length2, 0.0, 1.0) * d).norm();
}

// Distances by other formulas than the library's: normals and side tests instead of Gram determinants. Where a
// primitive has no area or two edges are parallel, the boundary decides.
double vertex_face_distance(const Quad& x) {
  double best = std::min({to_segment(x[0], x[1], x[2]), to_segment(x[0], x[2], x[3]), to_segment(x[0], x[3], x[1])});
  const Vec3 normal = (x[2] - x[1]).cross(x[3] - x[1]);
  const double size = normal.norm();
  if (size == 0) return best;
  bool inside = true;
  for (std::size_t k = 0; k < 3; ++k) {
    const Vec3 &a = x[1 + k], &b = x[1 + (k + 1) % 3];
    inside = inside && normal.dot((b - a).cross(x[0] - a)) >= 0;
  }
  return inside ? std::min(best, std::abs(normal.dot(x[0] - x[1])) / size) : best;
}

double edge_edge_distance(const Quad& x) {
  double best = std::min({to_segment(x[0], x[2], x[3]), to_segment(x[1], x[2], x[3]), to_segment(x[2], x[0], x[1]),
                          to_segment(x[3], x[0], x[1])});
  const Vec3 d1 = x[1] - x[0], d2 = x[3] - x[2], normal = d1.cross(d2), r = x[2] - x[0];
  const double size2 = normal.squaredNorm();
  if (size2 == 0) return best;
  const double s = r.cross(d2).dot(normal) / size2, t = r.cross(d1).dot(normal) / size2;
  if (s < 0 || s > 1 || t < 0 || t > 1) return best;
  return std::min(best, std::abs(r.dot(normal)) / std::sqrt(size2));
}

struct VertexFace {
  static std::optional<Collision> detect(const Quad& start, const Quad& end, const CcdOptions& options) {
    return vertex_face_ccd(start, end, options);
  }
  static double distance(const Quad& x) { return vertex_face_distance(x); }

  // Four points in contact: the vertex is on the face, its edge or its corner; the face may have no area.
  static Quad contact(Random& random, bool exact) {
    const auto point = [&] { return exact ? random.lattice() : random.point(); };
    Quad x{Vec3::Zero(), point(), point(), point()};
    switch (random.below(6)) {
      case 0:  // collinear corners
        x[3] = x[1] + (exact ? 0.5 : random.in(-1, 2)) * (x[2] - x[1]);
        break;
      case 1:  // two corners in one place
        x[3] = x[2];
        break;
      case 2:  // all three
        x[3] = x[2] = x[1];
        break;
      default:
        break;
    }
    double b1 = exact ? 0.25 : random.in(0, 1), b2 = exact ? 0.5 : random.in(0, 1 - b1);
    if (random.one_in(4)) b2 = 0;
    if (random.one_in(4)) b1 = b1 < 0.5 ? 0 : 1, b2 = 0;
    x[0] = (1 - b1 - b2) * x[1] + b1 * x[2] + b2 * x[3];
    return x;
  }
  // A unit vector along which the two may be moved apart by r, to a distance of exactly r; zero if there is none.
  static Vec3 apart(const Quad& x) {
    const Vec3 normal = (x[2] - x[1]).cross(x[3] - x[1]);
    return normal.norm() > 1e-3 ? Vec3(normal.normalized()) : Vec3(Vec3::Zero());
  }
  static constexpr std::size_t kFirst = 1;
};

struct EdgeEdge {
  static std::optional<Collision> detect(const Quad& start, const Quad& end, const CcdOptions& options) {
    return edge_edge_ccd(start, end, options);
  }
  static double distance(const Quad& x) { return edge_edge_distance(x); }

  // Two edges that meet inside or at an end; they may be parallel (overlapping then) or have no length.
  static Quad contact(Random& random, bool exact) {
    const auto point = [&] { return exact ? random.lattice() : random.point(); };
    const Vec3 meeting = point(), d1 = point();
    Vec3 d2 = point();
    switch (random.below(6)) {
      case 0:
        d2 = (exact ? -0.5 : random.in(-2, 2)) * d1;
        break;
      case 1:
        d2.setZero();
        break;
      case 2:  // nearly parallel
        if (!exact) d2 = random.in(-2, 2) * d1 + std::pow(10, random.in(-12, -3)) * d2;
        break;
      default:
        break;
    }
    double s = exact ? 0.25 : random.in(0, 1), t = exact ? 0.5 : random.in(0, 1);
    if (random.one_in(4)) s = s < 0.5 ? 0 : 1;
    if (random.one_in(4)) t = t < 0.5 ? 0 : 1;
    return {meeting - s * d1, meeting + (1 - s) * d1, meeting - t * d2, meeting + (1 - t) * d2};
  }
  static Vec3 apart(const Quad& x) {
    const Vec3 normal = (x[1] - x[0]).cross(x[3] - x[2]);
    return normal.norm() > 1e-3 ? Vec3(normal.normalized()) : Vec3(Vec3::Zero());
  }
  static constexpr std::size_t kFirst = 2;
};

// Motions of the four points: all free; in one plane; some at rest; first or second primitive at rest; common to all
// but one; head-on along an axis.
Quad random_motion(Random& random, std::size_t first, bool planar) {
  Quad m{random.point(), random.point(), random.point(), random.point()};
  switch (random.below(7)) {
    case 0:
      for (std::size_t i = 0; i < first; ++i) m[i].setZero();
      break;
    case 1:
      for (std::size_t i = first; i < 4; ++i) m[i].setZero();
      break;
    case 2:
      for (std::size_t i = 0; i < 3; ++i) m[i] = m[3];
      m[0] += random.point();
      break;
    case 3:
      m[1] = m[2] = m[3] = Vec3::Zero();
      break;
    case 4: {  // rigid approach along an axis
      const Vec3 axis = Vec3::Unit(random.below(planar ? 2 : 3));
      for (std::size_t i = 0; i < 4; ++i) m[i] = (i < first ? 1.0 : -1.0) * axis;
      break;
    }
    default:
      break;
  }
  if (planar) {
    for (Vec3& v : m) v.z() = 0;
  }
  return m;
}

struct Tally {
  std::int64_t cases = 0, known_contacts = 0, reports = 0, limited = 0;
  std::int64_t missed = 0, late = 0, false_alarms = 0, unsafe = 0;
  std::string first;
};

std::string describe(const Quad& start, const Quad& end) {
  std::string text;
  char line[200];
  for (std::size_t i = 0; i < 4; ++i) {
    std::snprintf(line, sizeof(line), "(%.17g, %.17g, %.17g) -> (%.17g, %.17g, %.17g); ", start[i].x(), start[i].y(),
                  start[i].z(), end[i].x(), end[i].y(), end[i].z());
    text += line;
  }
  return text;
}

// What must hold of every report: the pair is really as near as the gap allows, unless the iterations ran out, and it
// never was nearer than the minimum before.
template <typename Kind>
void check_report(const Quad& start, const Quad& end, const CcdOptions& options, const Collision& collision,
                  Tally& tally) {
  ++tally.reports;
  const double rounding = 1e-13 * size_of(start, end);
  const double at_start = Kind::distance(start) - options.minimum_distance;
  const double distance = Kind::distance(at(start, end, collision.time)) - options.minimum_distance;
  const auto complain = [&](std::int64_t& count, const char* what) {
    ++count;
    if (tally.first.empty()) tally.first = what + describe(start, end);
  };
  // Of needles and of almost parallel edges either distance knows 8 digits.
  if (distance > std::min(options.gap, std::max(0.1 * at_start, 0.0)) + 1e-8 * size_of(start, end)) {
    CcdOptions patient = options;
    patient.max_iterations *= 2;
    const auto again = Kind::detect(start, end, patient);
    if (again && again->time == collision.time) complain(tally.false_alarms, "reported beyond the gap: ");
    ++tally.limited;
  }
  if (at_start <= rounding) return;
  for (int s = 1; s <= 4; ++s) {
    if (Kind::distance(at(start, end, collision.time * s / 4)) - options.minimum_distance < -rounding)
      complain(tally.unsafe, "too close before the report: ");
  }
}

// Pairs around a contact at a known time.
template <typename Kind>
Tally known_contacts(std::uint64_t seed, int cases) {
  Random random(seed);
  Tally tally;
  for (int i = 0; i < cases; ++i) {
    const bool planar = random.one_in(5);
    Quad touch = Kind::contact(random, false);
    if (planar) {
      for (Vec3& x : touch) x.z() = 0;
    }
    CcdOptions options;
    if (!planar && random.one_in(6)) {
      options.minimum_distance = random.in(0, 0.3);
      const Vec3 apart = Kind::apart(touch);
      if (apart.isZero()) options.minimum_distance = 0;
      for (std::size_t k = 0; k < Kind::kFirst; ++k) touch[k] += options.minimum_distance * apart;
    }
    const Quad motion = random_motion(random, Kind::kFirst, planar);
    const double speed = random.one_in(2) ? 1 : std::pow(10, random.in(-3, 1));
    const double time = random.one_in(8) ? 1 : random.in(0, 1);
    const double scale = random.one_in(3) ? std::pow(10, random.in(-6, 6)) : 1;
    // A motion that all share must not matter, nor where the origin is.
    const Vec3 carried = random.one_in(5) ? Vec3(50 * random.point()) : Vec3(Vec3::Zero());
    const Vec3 origin = random.one_in(5) ? Vec3(10 * random.point()) : Vec3(Vec3::Zero());
    Quad start, end;
    for (std::size_t k = 0; k < 4; ++k) {
      start[k] = scale * (touch[k] - time * speed * motion[k] + origin);
      end[k] = scale * (touch[k] + (1 - time) * speed * motion[k] + origin + carried);
    }
    options.minimum_distance *= scale;
    options.gap *= std::max(1.0, scale);  // no gap is wide enough for doubles at a million metres

    ++tally.cases;
    const auto collision = Kind::detect(start, end, options);
    // Rounding of the ends decides whether pairs that start within it of each other touch at all.
    const double clearance = Kind::distance(start) - options.minimum_distance;
    const double rounding = 1e-13 * size_of(start, end);
    if (clearance > 1e3 * rounding) {
      ++tally.known_contacts;
      if (!collision) {
        ++tally.missed;
        if (tally.first.empty()) tally.first = "missed: " + describe(start, end);
      } else if (collision->time > time + 1e-9) {
        ++tally.late;
        if (tally.first.empty()) tally.first = "late: " + describe(start, end);
      }
    }
    if (collision) check_report<Kind>(start, end, options, *collision, tally);
  }
  return tally;
}

// Volume of the four points: it changes sign where a vertex passes the plane of a face, or a line another.
double volume(const Quad& x) { return (x[1] - x[0]).dot((x[2] - x[0]).cross(x[3] - x[0])); }

// Brute force: bisects every sign change between samples and looks whether the primitives touch there.
template <typename Kind>
bool meets(const Quad& start, const Quad& end) {
  constexpr int kSamples = 24;
  double before = volume(start);
  for (int i = 1; i <= kSamples; ++i) {
    const double t1 = static_cast<double>(i) / kSamples;
    const double after = volume(at(start, end, t1));
    if (before * after <= 0) {
      double low = static_cast<double>(i - 1) / kSamples, high = t1;
      for (int k = 0; k < 45; ++k) {
        const double middle = (low + high) / 2;
        (volume(at(start, end, middle)) * before > 0 ? low : high) = middle;
      }
      if (Kind::distance(at(start, end, high)) < 1e-11) return true;
    }
    before = after;
  }
  return false;
}

// Pairs of which nothing is known: brute force looks for what was not reported.
template <typename Kind>
Tally unknown_pairs(std::uint64_t seed, int cases) {
  Random random(seed);
  Tally tally;
  for (int i = 0; i < cases; ++i) {
    Quad start{random.point(), random.point(), random.point(), random.point()}, end;
    const double speed = i % 3 == 0 ? 0.2 : 2;
    for (std::size_t k = 0; k < 4; ++k) end[k] = start[k] + speed * random.point();
    if (i % 5 == 0) {
      const Vec3 shift = 50 * random.point();
      for (Vec3& x : end) x += shift;
    }
    ++tally.cases;
    const CcdOptions options;
    const auto collision = Kind::detect(start, end, options);
    if (collision) {
      check_report<Kind>(start, end, options, *collision, tally);
      continue;
    }
    bool missed = meets<Kind>(start, end);
    for (int s = 1; s <= 4; ++s) missed = missed || Kind::distance(at(start, end, s / 4.0)) <= 0;
    if (!missed) continue;
    ++tally.missed;
    if (tally.first.empty()) tally.first = "missed: " + describe(start, end);
  }
  return tally;
}

void expect_right(const Tally& tally, double most_limited) {
  EXPECT_EQ(tally.missed, 0) << tally.first;
  EXPECT_EQ(tally.late, 0) << tally.first;
  EXPECT_EQ(tally.false_alarms, 0) << tally.first;
  EXPECT_EQ(tally.unsafe, 0) << tally.first;
  EXPECT_GT(tally.reports, tally.cases / 50);
  EXPECT_LE(static_cast<double>(tally.limited), most_limited * static_cast<double>(tally.cases));
}

TEST(CcdOracle, VertexFaceFindsEveryKnownContact) {
  const Tally tally = known_contacts<VertexFace>(1, 700'000);
  EXPECT_GT(tally.known_contacts, 600'000);
  expect_right(tally, 0.02);
}

TEST(CcdOracle, EdgeEdgeFindsEveryKnownContact) {
  const Tally tally = known_contacts<EdgeEdge>(2, 500'000);
  EXPECT_GT(tally.known_contacts, 400'000);
  expect_right(tally, 0.05);
}

TEST(CcdOracle, VertexFaceMissesNothingThatBruteForceFinds) {
  expect_right(unknown_pairs<VertexFace>(3, 400'000), 1e-3);
}

TEST(CcdOracle, EdgeEdgeMissesNothingThatBruteForceFinds) { expect_right(unknown_pairs<EdgeEdge>(4, 400'000), 1e-3); }

// Contact at the very start, exact on a lattice: reported at time 0 if anything moves relative to anything, and never
// if nothing does.
template <typename Kind>
void touching_at_the_start() {
  Random random(5);
  int moving = 0;
  for (int i = 0; i < 100'000; ++i) {
    const Quad start = Kind::contact(random, true);
    if (Kind::distance(start) != 0) continue;
    const Quad motion = random_motion(random, Kind::kFirst, false);
    Quad end;
    for (std::size_t k = 0; k < 4; ++k) end[k] = start[k] + motion[k];
    const auto collision = Kind::detect(start, end, {});
    ASSERT_TRUE(collision) << describe(start, end);
    ASSERT_EQ(collision->time, 0) << describe(start, end);
    ++moving;
    const Vec3 shift = random.lattice();
    for (std::size_t k = 0; k < 4; ++k) end[k] = start[k] + shift;
    ASSERT_FALSE(Kind::detect(start, start, {})) << describe(start, start);
    ASSERT_FALSE(Kind::detect(start, end, {})) << describe(start, end);
  }
  EXPECT_GT(moving, 50'000);
}

TEST(CcdOracle, TouchingAtTheStartIsTimeZero) {
  touching_at_the_start<VertexFace>();
  touching_at_the_start<EdgeEdge>();
}

// Pairs that end a little above or below the gap: no report is right above it however long they slide, as long as the
// iterations suffice; below it a report must come, because what is accepted is rounded to float32 later.
TEST(CcdOracle, TheGapDividesReportsFromSilence) {
  Random random(6);
  CcdOptions options;
  options.max_iterations = 1'000'000;
  for (int i = 0; i < 2000; ++i) {
    const double above = options.gap * random.in(1.01, 3), below = options.gap * random.in(0, 0.99);
    // A vertex comes down on a face, straight or while it slides.
    Quad start{Vec3(random.in(-0.3, 0.3), random.in(-0.3, 0.3), 0.01), Vec3(-2, -2, 0), Vec3(2, -2, 0), Vec3(0, 3, 0)};
    Quad end = start;
    if (i % 2 == 0) end[0] += Vec3(random.in(-0.3, 0.3), random.in(-0.3, 0.3), 0);
    end[0].z() = above;
    EXPECT_FALSE(vertex_face_ccd(start, end, options)) << describe(start, end);
    end[0].z() = below;
    EXPECT_TRUE(vertex_face_ccd(start, end, options)) << describe(start, end);
    // An edge comes down on another one that it crosses, or to which it is parallel.
    const double turn = i % 4 == 0 ? 0 : random.in(0, 3);
    start = {Vec3(-1, 0, 0), Vec3(1, 0, 0), Vec3(-std::cos(turn), -std::sin(turn), 0.01),
             Vec3(std::cos(turn), std::sin(turn), 0.01)};
    end = start;
    end[2].z() = end[3].z() = above;
    EXPECT_FALSE(edge_edge_ccd(start, end, options)) << describe(start, end);
    end[2].z() = end[3].z() = below;
    EXPECT_TRUE(edge_edge_ccd(start, end, options)) << describe(start, end);
  }
}

}  // namespace
}  // namespace pleat
