// Whole simulations against truth that was not made by them: closed forms and conservation laws.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>

#include "services/simulation/dynamics.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/unit/services/simulation/garments.hpp"
#include "tests/unit/services/simulation/physics.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// A strip of `length` beyond its clamp that bends under its own weight: G theta'' = -w (length - s) cos theta with
// theta = 0 at the clamp and theta' = 0 at the tip, by shooting from the tip. Returns the tip's place.
Vector2d heavy_elastica(double rigidity, double weight, double length, double clamp) {
  constexpr int kSteps = 4000;
  const double h = (length - clamp) / kSteps;
  const auto shoot = [&](double tip_angle, Vector2d& tip) {
    double theta = tip_angle, slope = 0;
    tip.setZero();
    for (int i = 0; i < kSteps; ++i) {
      const double s = length - (i + 0.5) * h;  // midpoint rule
      const double middle = theta - slope * h / 2;
      const double bend = -weight * (length - std::max(s, 0.0)) * std::cos(middle) / rigidity;
      slope -= bend * h;
      theta -= (slope + bend * h / 2) * h;
      if (s > 0) tip += h * Vector2d(std::cos(middle), -std::sin(middle));
    }
    return theta;  // at the clamp
  };
  double low = 0, high = kPi / 2;
  Vector2d tip;
  for (int k = 0; k < 60; ++k) {
    const double middle = (low + high) / 2;
    (shoot(middle, tip) > 0 ? high : low) = middle;
  }
  return tip;
}

// A strip two cells wide whose diagonals mirror each other, so that bending does not twist it.
Topology mirrored_strip(int cells, double piece) {
  Topology t = sheet(cells, 2, cells * piece, 2 * piece);
  const auto row = static_cast<std::uint32_t>(cells) + 1;
  for (int i = 0; i < cells; ++i) {
    const auto a = static_cast<std::uint32_t>(i), b = a + 1, c = a + row, d = c + 1;
    t.faces.row(2 * i) << a, c, d;
    t.faces.row(2 * i + 1) << a, d, b;
  }
  t.uv_faces = t.faces;
  return t;
}

TEST(Physics, CantileverBendsByItsPeirceBendingLength) {
  // On a grid whose lines are across the bend, only those lines fold: theta = kappa d, l = the line's piece, and
  // ke l^2 theta^2 / (8 (a0 + a1)) is ke kappa^2 / 8 per area. The flexural rigidity per width is G = ke / 4.
  constexpr int kOverhang = 24, kHeld = 3;
  const double piece = 0.2 / kOverhang, length = 0.2, density = 0.2, weight = density * kGravity;
  for (const double bending_length : {0.07, 0.1, 0.14}) {
    const double rigidity = weight * std::pow(bending_length, 3);
    Scene scene =
        mesh_scene(mirrored_strip(kOverhang + kHeld, piece), isotropic_material(2000, 0, 4 * rigidity, density));
    scene.frame_time_s = 0.02;
    scene.steps_per_frame = 1;
    scene.damping_s = 0.02;
    Handle clamp;
    for (std::uint32_t j = 0; j <= 2; ++j) {
      for (std::uint32_t i = 0; i <= kHeld; ++i) clamp.vertices.push_back(j * (kOverhang + kHeld + 1) + i);
    }
    clamp.hard = true;
    scene.handles.push_back(clamp);
    Simulation simulation(scene, Mode::kCoarse);
    SimulatedFrame frame;
    while (simulation.next_index() < 250) frame = simulation.next_frame();
    EXPECT_LT(frame.coarse.velocities.rowwise().norm().maxCoeff(), 1e-3f);
    const Vector3d tip =
        (frame.coarse.positions.row(kOverhang + kHeld) - frame.coarse.positions.row(kHeld)).cast<double>().transpose();
    // The first free line carries the curvature of half a piece on either side: the strip is clamped half a piece back.
    const Vector2d theory = heavy_elastica(rigidity, weight, length, -piece / 2);
    EXPECT_LT((tip.head<2>() - theory).norm(), 2e-3 * length) << bending_length;
    // Peirce 1930: c = L (cos(phi/2) / (8 tan phi))^(1/3) from the angle of the chord, an approximation of the same
    // curve: 1 % off up to 45 degrees, 4 % at 67.
    const double angle = std::atan2(-tip.y(), tip.x());
    const double peirce = (length + piece / 2) * std::cbrt(std::cos(angle / 2) / (8 * std::tan(angle)));
    EXPECT_NEAR(peirce, bending_length, (bending_length < 0.1 ? 0.045 : 0.015) * bending_length);
  }
}

// Sum over the vertices of mass, velocity and place.
struct Totals {
  double kinetic = 0, potential = 0, size = 0;  // J, J (gravity), kg m/s
  Vector3d momentum = Vector3d::Zero(), angular = Vector3d::Zero();
};

// Frames of one step: their velocities are the solver's.
Totals totals(const Frame& frame, const std::vector<double>& masses) {
  Totals t;
  for (std::size_t i = 0; i < masses.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    const Vector3d x = frame.positions.row(row).cast<double>(), v = frame.velocities.row(row).cast<double>();
    t.kinetic += masses[i] * v.squaredNorm() / 2;
    t.potential += masses[i] * kGravity * x.y();
    t.momentum += masses[i] * v;
    t.angular += masses[i] * x.cross(v);
    t.size += masses[i] * v.norm();
  }
  return t;
}

TEST(Physics, PendulumNeverGainsEnergyAndLosesLittle) {
  // A strip swings by its upper edge through 30 degrees, stretching and bending as it likes. Backward Euler with steps
  // of h takes 1 - exp(-omega^2 h t) of a mode's energy, 3 % of the slowest one in a second (omega^2 = 1.45 g / L) and
  // more of the faster ones, which carry little.
  Scene scene = mesh_scene(sheet(2, 14, 0.08, 0.5), isotropic_material(400, 0, 2e-4, 0.2));
  scene.transform.rotation = {kPi / 2 - kPi / 6, 0, 0};
  scene.frame_time_s = 1e-3;
  scene.steps_per_frame = 1;
  scene.damping_s = 1e-4;
  scene.handles.push_back(handle_on({0, 1, 2}));
  scene.handles[0].hard = true;
  const Dynamics dynamics(scene.garment, scene);
  Simulation simulation(scene, Mode::kCoarse);
  const auto energy = [&](const SimulatedFrame& frame) {
    const Totals t = totals(frame.coarse, dynamics.masses());
    return t.kinetic + t.potential + dynamics.internal_energy(to_points(frame.coarse.positions));
  };
  SimulatedFrame frame = simulation.next_frame();
  const double first = energy(frame), mass = 0.08 * 0.5 * 0.2;
  const double swing = mass * kGravity * 0.25 * (1 - std::cos(kPi / 6));  // above hanging straight
  double last = first, largest_kinetic = 0, largest_gain = -1e30;
  for (int k = 0; k < 1000; ++k) {
    frame = simulation.next_frame();
    const double now = energy(frame);
    largest_gain = std::max(largest_gain, (now - last) / swing);
    last = now;
    largest_kinetic = std::max(largest_kinetic, totals(frame.coarse, dynamics.masses()).kinetic);
  }
  EXPECT_LT(largest_gain, 1e-5);
  EXPECT_LT(first - last, 0.1 * swing);
  EXPECT_GT(first - last, 0);
  EXPECT_GT(largest_kinetic, 0.8 * swing);
}

TEST(Physics, HangingStripSwingsAsAHeavyChain) {
  // Small swings in the slowest mode: amplitude J0(2.4048 sqrt(s / L)), s from the lower end, omega = 1.2024 sqrt(g /
  // L) (Bernoulli 1732). The strip starts in that shape, at rest, with flat material coordinates.
  constexpr int kRows = 20;
  const double length = 0.5, amplitude = 0.02;
  Topology garment = sheet(1, kRows, 0.025, length);
  double along = 0, down = 0, before = 0;  // material coordinate and place of the row, from the upper end
  for (int j = 0; j <= kRows; ++j) {
    const double s = length * (kRows - j) / kRows;
    const double sideways = amplitude * std::cyl_bessel_j(0, 2.404825557695773 * std::sqrt(s / length));
    if (j > 0) down += std::sqrt(std::pow(length / kRows, 2) - std::pow(sideways - before, 2));
    before = sideways;
    along = length - s;
    for (int i = 0; i <= 1; ++i) {
      const Eigen::Index v = 2 * j + i;
      garment.rest_positions.row(v) << 0.025f * static_cast<float>(i), static_cast<float>(-down),
          static_cast<float>(sideways);
      garment.uv.row(v) << 0.025f * static_cast<float>(i), static_cast<float>(-along);
    }
  }
  Scene scene = mesh_scene(garment, isotropic_material(2000, 0, 1e-9, 0.2));
  scene.frame_time_s = 2e-3;
  scene.steps_per_frame = 1;
  scene.handles.push_back(handle_on({0, 1}));
  scene.handles[0].hard = true;
  Simulation simulation(scene, Mode::kCoarse);
  double tip = 0, crossing = 0;
  for (int k = 0; k < 1000 && crossing == 0; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    const double next = static_cast<double>(frame.coarse.positions(2 * kRows, 2));
    if (k > 0 && tip > 0 && next <= 0) crossing = 2e-3 * (k - 1 + tip / (tip - next));
    tip = next;
  }
  const double quarter = kPi / 2 / (1.2024127788478864 * std::sqrt(kGravity / length));
  EXPECT_NEAR(crossing, quarter, 0.01 * quarter);
}

// Two sheets in one garment; `second` is moved by its offset.
Topology two_sheets(const Topology& one, const Topology& two, const Eigen::RowVector3f& offset) {
  Topology both = one;
  const Eigen::Index n = one.vertex_count(), m = two.vertex_count(), f = one.face_count(), g = two.face_count();
  both.rest_positions.conservativeResize(n + m, 3);
  both.uv.conservativeResize(n + m, 2);
  both.faces.conservativeResize(f + g, 3);
  both.rest_positions.bottomRows(m) = two.rest_positions.rowwise() + offset;
  both.uv.bottomRows(m) = two.uv.rowwise() + Eigen::RowVector2f(5, 0);
  both.faces.bottomRows(g) = (two.faces.array() + static_cast<std::uint32_t>(n)).matrix();
  both.uv_faces = both.faces;
  return both;
}

struct Collision {
  double linear = 0, angular = 0;  // largest change since before the contact, relative to the momentum that there is
  std::uint64_t contacts = 0, impacts = 0;
};

// A small sheet is carried by a handle, released at `speed`, and hits a large one off its centre and obliquely, so that
// friction acts and both tumble. No gravity, no air: nothing outside acts.
// way: of the small sheet in a step.
Collision collide_sheets(double speed, double way) {
  Scene scene = mesh_scene(two_sheets(sheet(8, 8, 0.3, 0.3), sheet(4, 4, 0.13, 0.13), {0.06f, 0.1f, 0.03f}),
                           isotropic_material(100, 0.2, 1e-5, 0.2));
  scene.gravity.setZero();
  scene.frame_time_s = way / speed;
  scene.steps_per_frame = 1;
  Handle carrier;
  for (std::uint32_t v = 81; v < 81 + 25; ++v) carrier.vertices.push_back(v);
  carrier.hard = true;
  carrier.end_s = 0.05 / speed;
  carrier.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.1 / speed, {-0.02, -0.1, 0.01}, {0, 0, 0.2}}};
  scene.handles.push_back(carrier);
  const Dynamics dynamics(scene.garment, scene);
  Simulation simulation(scene, Mode::kCoarse);
  Collision result;
  Totals before;
  const int released = static_cast<int>(std::ceil(0.055 / way)), last = static_cast<int>(0.4 / way);
  for (int k = 0; k < last; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    const Totals now = totals(frame.coarse, dynamics.masses());
    if (k == released) {
      before = now;
      EXPECT_EQ(result.contacts + result.impacts, 0u);
      EXPECT_GT(before.momentum.norm(), 0.9 * before.size);
    }
    result.contacts += frame.report.contacts;
    result.impacts += frame.report.impacts;
    if (k < released) continue;
    result.linear = std::max(result.linear, (now.momentum - before.momentum).norm() / before.size);
    result.angular = std::max(result.angular, (now.angular - before.angular).norm() / (0.15 * before.size));
  }
  return result;
}

TEST(Physics, CollidingSheetsKeepTheirMomentum) {
  // Forces and impacts come in opposite pairs and lose nothing; what the linear solver leaves over has no share in the
  // translation. Backward Euler takes from rotation.
  const Collision slow = collide_sheets(1, 2.5e-3), fast = collide_sheets(4, 0.01);
  EXPECT_GT(slow.contacts, 500u);
  EXPECT_LT(slow.linear, 1e-3);
  EXPECT_LT(slow.angular, 3e-2);
  EXPECT_GT(fast.impacts, 50u);
  EXPECT_LT(fast.linear, 1e-3);
  EXPECT_LT(fast.angular, 3e-2);
}

// How far a stiff patch slides down a plane within 0.5 s.
double slide(double angle, double friction) {
  Scene scene = mesh_scene(sheet(4, 4, 0.12, 0.12), isotropic_material(400, 0.2, 1e-3, 0.3));
  Obstacle plane;
  plane.name = "plane";
  plane.mesh = box_mesh(3);
  plane.mesh.rest_positions.col(1) *= 0.2f / 3;
  plane.motion.keys = {{0, {0, 0, 0}, {0, 0, -angle}}};  // down towards +x
  scene.obstacles.push_back(plane);
  // The patch starts where the repulsion layer of 5 mm carries its weight.
  const Vector3d up(std::sin(angle), std::cos(angle), 0);
  scene.transform.rotation = {0, 0, -angle};
  scene.transform.translation = (0.1 + 4.85e-3) * up;
  scene.contact.obstacle_friction = friction;
  Simulation simulation(scene, Mode::kCoarse);
  const Eigen::RowVector3f start = simulation.next_frame().coarse.positions.colwise().mean();
  SimulatedFrame frame;
  while (simulation.next_index() <= 12) frame = simulation.next_frame();
  const Vector3d moved = (frame.coarse.positions.colwise().mean() - start).cast<double>().transpose();
  EXPECT_NEAR(moved.dot(up), 0, 2e-3) << "it stays on the plane";
  return moved.dot(Vector3d(std::cos(angle), -std::sin(angle), 0));
}

TEST(Physics, FrictionHoldsBelowItsAngleAndLetsSlideAbove) {
  // Friction of 0.4 holds up to 21.8 degrees. It acts as a viscosity that takes the sliding of one step at most, so
  // that a held cloth creeps at h g sin(angle) (h = 5 ms): 2 % of a free slide here.
  const double friction = 0.4, time = 0.48, step = 5e-3;
  for (const double degrees : {5.0, 12.0, 18.0, 20.0}) {
    const double angle = degrees * kPi / 180;
    const double way = slide(angle, friction);
    EXPECT_GT(way, -1e-4) << degrees;
    EXPECT_LT(way, 1.2 * step * kGravity * std::sin(angle) * time) << degrees;
  }
  for (const double degrees : {26.0, 32.0, 40.0}) {
    const double angle = degrees * kPi / 180;
    const double expected = kGravity * (std::sin(angle) - friction * std::cos(angle)) * time * time / 2;
    EXPECT_NEAR(slide(angle, friction), expected, 0.12 * expected) << degrees;
  }
  const double smooth = slide(0.3, 0), expected = kGravity * std::sin(0.3) * time * time / 2;
  EXPECT_NEAR(smooth, expected, 0.03 * expected);
}

// A sheet that hangs by its two upper corners, after three seconds.
struct Hung {
  Positions positions;
  double fastest;  // m/s
};
Hung hang(const Topology& garment, std::uint32_t right_corner, int steps_per_frame) {
  Scene scene = mesh_scene(garment, read_material("deploy/materials/gray-interlock.json"));
  scene.wind.density = 1;
  scene.transform.rotation = {kPi / 2, 0, 0};
  scene.perturbation_m = 1e-3;
  scene.seed = 1;
  scene.damping_s = 0.02;
  scene.steps_per_frame = steps_per_frame;
  scene.handles.push_back(handle_on({0, right_corner}));
  scene.handles[0].hard = true;
  Simulation simulation(scene, Mode::kCoarse);
  SimulatedFrame frame;
  while (simulation.next_index() <= 75) frame = simulation.next_frame();
  return {frame.coarse.positions, static_cast<double>(frame.coarse.velocities.rowwise().norm().maxCoeff())};
}

TEST(Physics, TableclothHungByTwoCornersRestsAsItsWeightAndTheTableSay) {
  const Topology garment = sheet(12, 10, 0.6, 0.5);
  const Hung hung = hang(garment, 12, 8), finer = hang(garment, 12, 16);
  EXPECT_LT(hung.fastest, 0.02);
  EXPECT_LT(finer.fastest, 0.02);
  const double rms = std::sqrt((hung.positions - finer.positions).cast<double>().rowwise().squaredNorm().mean());
  EXPECT_LT(rms, 5e-3);
  // By hand: every level carries what hangs below it, however the corners gather it. Summed over the levels, the
  // vertical tension times area is the weight times the depth of the centre of mass below the corners (the virial of
  // gravity): sum a (F S F^T)_yy = m g (y_corner - y_centre), with S from the strain and the material's table.
  const StretchingTable table(read_material("deploy/materials/gray-interlock.json"), 1);
  const Scene scene = mesh_scene(garment, read_material("deploy/materials/gray-interlock.json"));
  const Dynamics dynamics(garment, scene);
  double tension = 0, moment = 0;
  for (Eigen::Index f = 0; f < garment.face_count(); ++f) {
    Matrix2d rest;
    Eigen::Matrix<double, 3, 2> now;
    for (int k = 0; k < 2; ++k) {
      rest.col(k) = (garment.uv.row(garment.uv_faces(f, k + 1)) - garment.uv.row(garment.uv_faces(f, 0)))
                        .transpose()
                        .cast<double>();
      now.col(k) = (hung.positions.row(garment.faces(f, k + 1)) - hung.positions.row(garment.faces(f, 0)))
                       .transpose()
                       .cast<double>();
    }
    const Eigen::Matrix<double, 3, 2> gradient = now * rest.inverse();
    const Matrix2d g = (gradient.transpose() * gradient - Matrix2d::Identity()) / 2;
    const Moduli k = table.at(g(0, 0), g(1, 1), g(0, 1));
    Matrix2d stress;
    stress << double(k.c11) * g(0, 0) + double(k.c12) * g(1, 1), double(k.c33) * g(0, 1), double(k.c33) * g(0, 1),
        double(k.c12) * g(0, 0) + double(k.c22) * g(1, 1);
    tension += rest.determinant() / 2 * gradient.row(1).dot(stress * gradient.row(1).transpose());
  }
  const double corner = static_cast<double>(hung.positions(0, 1));
  for (std::size_t v = 0; v < dynamics.masses().size(); ++v) {
    moment += dynamics.masses()[v] * kGravity *
              (corner - static_cast<double>(hung.positions(static_cast<Eigen::Index>(v), 1)));
  }
  EXPECT_NEAR(tension, moment, 0.01 * moment);
}

TEST(Physics, RunnerHungByTwoCornersStretchesAsTheTableSays) {
  // So narrow that the corners' pull is even a width below them. By hand, from the lower end: the tension per width at
  // s is rho g s, and k (w^2 - 1) / 2 w = rho g s gives the stretch w there, k being the table's modulus along v (its
  // coupling is 0 at these strains). The lowest point is the integral of w.
  const double length = 0.8;
  const Topology garment = sheet(2, 32, 0.05, length);
  const Hung hung = hang(garment, 2, 8);
  const StretchingTable table(read_material("deploy/materials/gray-interlock.json"), 1);
  constexpr int kPieces = 1000;
  double expected = 0;
  std::vector<double> below(1, 0);  // stretched length of what is below a place
  for (int i = 0; i < kPieces; ++i) {
    const double tension = 0.187 * kGravity * length * (i + 0.5) / kPieces;
    double low = 1, high = 1.1;
    for (int k = 0; k < 50; ++k) {
      const double w = (low + high) / 2, g = (w * w - 1) / 2;
      (static_cast<double>(table.at(0, g, 0).c22) * g * w > tension ? high : low) = w;
    }
    expected += low * length / kPieces;
    below.push_back(expected);
  }
  const double extension = expected - length;
  const double lowest = static_cast<double>(hung.positions(0, 1) - hung.positions.col(1).minCoeff());
  EXPECT_NEAR(lowest - length, extension, 0.1 * extension);
  // Where the pull is even: the lower three quarters, along the side edge.
  const double part = static_cast<double>((hung.positions.row(8 * 3) - hung.positions.row(32 * 3)).norm());
  EXPECT_NEAR(part - 0.75 * length, below[750] - 0.75 * length, 0.03 * (below[750] - 0.75 * length));
}

}  // namespace
}  // namespace pleat::simulation
