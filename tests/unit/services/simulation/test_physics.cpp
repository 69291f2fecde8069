// The engine against truth that was not made by it: finite differences, closed forms, conservation laws. Everything
// goes through whole meshes and, where it can, through whole simulations.
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "services/simulation/dynamics.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kGravity = 9.81;
constexpr double kPi = std::numbers::pi;

// In the file's terms: an isotropic sheet of membrane stiffness E t (N/m) and Poisson's ratio nu. All rows are equal,
// so that the moduli do not depend on the strain.
Material isotropic_material(double membrane, double poisson, double bending, double density) {
  Material m;
  m.density = density;
  const double c11 = membrane / (2 * (1 - poisson * poisson));
  for (auto& row : m.stretching) row = {c11, poisson * c11, c11, membrane / (2 * (1 + poisson))};
  for (auto& row : m.bending) row.fill(bending);
  return m;
}

// Different along and across, but the same at all strains and curvatures: its energy has an exact gradient.
Material constant_anisotropic_material() {
  Material m;
  m.density = 0.2;
  for (auto& row : m.stretching) row = {20, 6, 50, 11};
  m.bending[0].fill(3e-5);
  m.bending[1].fill(1e-5);
  m.bending[2].fill(6e-5);
  return m;
}

Points to_points(const Positions& positions) {
  Points x;
  for (Eigen::Index v = 0; v < positions.rows(); ++v) x.push_back(positions.row(v).cast<double>().transpose());
  return x;
}

// A sheet with irregular cells and material coordinates that are turned by `turn`.
Topology irregular_sheet(int cells, double size, double turn) {
  Topology t = sheet(cells, cells, size, size);
  std::mt19937 engine(5);
  std::uniform_real_distribution<double> noise(-0.2 * size / cells, 0.2 * size / cells);
  const Eigen::Rotation2Dd rotation(turn);
  for (Eigen::Index v = 0; v < t.vertex_count(); ++v) {
    const Vector2d u = t.uv.row(v).transpose().cast<double>() + Vector2d(noise(engine), noise(engine));
    t.rest_positions.row(v) << static_cast<float>(u.x()), 0, static_cast<float>(-u.y());
    t.uv.row(v) = (rotation * u).transpose().cast<float>();
  }
  return t;
}

// Bent in two directions, stretched here and compressed there, with sharp folds and noise.
Points crumpled(const Topology& t) {
  std::mt19937 engine(9);
  std::uniform_real_distribution<double> noise(-0.004, 0.004);
  Points x = to_points(t.rest_positions);
  for (Vector3d& p : x) {
    const double bump = 0.05 * std::sin(14 * p.x() + 3 * p.z()) + 0.04 * std::cos(11 * p.z());
    p = Vector3d(1.06 * p.x() + 0.1 * p.z() * p.z(), bump, 0.97 * p.z() + 0.15 * p.x() * p.z());
    p += Vector3d(noise(engine), noise(engine), noise(engine));
  }
  return x;
}

// An energy of the whole mesh, written again from the formulas of docs/simulation.md in double: per face from
// G = (F^T F - I) / 2, per interior edge from the angle between the normals. Moduli and bending stiffness are frozen at
// the positions of the constructor, as the force law has it.
class FrozenEnergy {
 public:
  FrozenEnergy(const Topology& mesh, const Material& material, const Points& at) {
    const StretchingTable table(material, 1);
    for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
      Face face;
      Matrix2d edges;
      for (int k = 0; k < 3; ++k) face.v[static_cast<std::size_t>(k)] = mesh.faces(f, k);
      for (int k = 0; k < 2; ++k) {
        edges.col(k) = (mesh.uv.row(mesh.uv_faces(f, k + 1)) - mesh.uv.row(mesh.uv_faces(f, 0))).cast<double>();
      }
      face.inverse = edges.inverse();
      face.area = edges.determinant() / 2;
      const Matrix2d g = strain(face, at);
      face.moduli = table.at(g(0, 0), g(1, 1), g(0, 1));
      faces_.push_back(face);
    }
    // Every interior edge once, from the two faces that hold it in opposite directions.
    for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
      for (Eigen::Index g = f + 1; g < mesh.face_count(); ++g) {
        for (int k = 0; k < 3; ++k) {
          for (int j = 0; j < 3; ++j) {
            const std::uint32_t a = mesh.faces(f, k), b = mesh.faces(f, (k + 1) % 3);
            if (mesh.faces(g, j) != b || mesh.faces(g, (j + 1) % 3) != a) continue;
            Hinge hinge{{a, b, mesh.faces(f, (k + 2) % 3), mesh.faces(g, (j + 2) % 3)}, 0, 0};
            const Vector2d direction = (mesh.uv.row(b) - mesh.uv.row(a)).transpose().cast<double>();
            const double areas = faces_[static_cast<std::size_t>(f)].area + faces_[static_cast<std::size_t>(g)].area;
            hinge.shape = direction.squaredNorm() / (8 * areas);
            const double kappa = angle(hinge, at) * direction.norm() / areas;
            hinge.stiffness = bending_stiffness(material, direction.x(), direction.y(), kappa);
            hinges_.push_back(hinge);
          }
        }
      }
    }
  }

  double at(const Points& x) const {
    double energy = 0;
    for (const Face& face : faces_) {
      const Matrix2d g = strain(face, x);
      const Moduli& k = face.moduli;
      energy += face.area / 2 *
                (double(k.c11) * g(0, 0) * g(0, 0) + double(k.c22) * g(1, 1) * g(1, 1) +
                 2 * double(k.c12) * g(0, 0) * g(1, 1) + 2 * double(k.c33) * g(0, 1) * g(0, 1));
    }
    for (const Hinge& hinge : hinges_) {
      const double theta = angle(hinge, x);
      energy += hinge.stiffness * hinge.shape * theta * theta;
    }
    return energy;
  }

 private:
  struct Face {
    std::array<std::uint32_t, 3> v;
    Matrix2d inverse;
    double area;
    Moduli moduli;
  };
  struct Hinge {
    std::array<std::uint32_t, 4> v;
    double shape, stiffness;
  };
  static Matrix2d strain(const Face& face, const Points& x) {
    Eigen::Matrix<double, 3, 2> edges;
    edges << x[face.v[1]] - x[face.v[0]], x[face.v[2]] - x[face.v[0]];
    const Eigen::Matrix<double, 3, 2> gradient = edges * face.inverse;
    return (gradient.transpose() * gradient - Matrix2d::Identity()) / 2;
  }
  static double angle(const Hinge& hinge, const Points& x) {
    const Vector3d &a = x[hinge.v[0]], &b = x[hinge.v[1]];
    const Vector3d n0 = (b - a).cross(x[hinge.v[2]] - a), n1 = (a - b).cross(x[hinge.v[3]] - b);
    return std::atan2(n0.cross(n1).norm(), n0.dot(n1));
  }

  std::vector<Face> faces_;
  std::vector<Hinge> hinges_;
};

Scene mesh_scene(Topology garment, Material material) {
  Scene scene;
  scene.name = "physics";
  scene.garment = std::move(garment);
  scene.material = material;
  scene.frames = 100'000;
  scene.threads = 1;
  scene.wind.density = 0;
  return scene;
}

// Central differences of `energy` against the engine's forces. Relative to the largest force: the engine's elements are
// float32.
void expect_gradient(const Points& forces, Points x, const std::function<double(const Points&)>& energy,
                     double tolerance) {
  double largest = 0;
  for (const Vector3d& f : forces) largest = std::max(largest, f.norm());
  ASSERT_GT(largest, 0.01);
  constexpr double kStep = 1e-6;
  for (std::size_t v = 0; v < x.size(); ++v) {
    for (int d = 0; d < 3; ++d) {
      const double here = x[v][d];
      x[v][d] = here + kStep;
      const double plus = energy(x);
      x[v][d] = here - kStep;
      const double minus = energy(x);
      x[v][d] = here;
      EXPECT_NEAR(forces[v][d], -(plus - minus) / (2 * kStep), tolerance * largest) << "vertex " << v;
    }
  }
}

TEST(Physics, ForcesAreTheGradientOfTheEnergyOfACrumpledAnisotropicMesh) {
  for (const double turn : {0.0, 0.5}) {
    const Scene scene = mesh_scene(irregular_sheet(5, 0.4, turn), constant_anisotropic_material());
    const Dynamics dynamics(scene.garment, scene);
    const Points x = crumpled(scene.garment);
    const FrozenEnergy energy(scene.garment, scene.material, x);
    EXPECT_NEAR(dynamics.internal_energy(x), energy.at(x), 1e-5 * energy.at(x));
    expect_gradient(
        dynamics.internal_forces(x), x, [&](const Points& p) { return energy.at(p); }, 1e-4);
  }
}

TEST(Physics, MeasuredMaterialPullsAsItsEnergyAtFrozenModuli) {
  const Scene scene = mesh_scene(irregular_sheet(5, 0.4, 0.5), read_material("deploy/materials/gray-interlock.json"));
  const Dynamics dynamics(scene.garment, scene);
  const Points x = crumpled(scene.garment);
  const FrozenEnergy energy(scene.garment, scene.material, x);
  expect_gradient(
      dynamics.internal_forces(x), x, [&](const Points& p) { return energy.at(p); }, 1e-4);
}

// The whole mesh's stiffness as the engine uses it. One linearised step without damping changes the velocities by
// A dv = h F - h^2 K v with A = M + h^2 K, so that v + dv = A^-1 (M v + h F): two steps that differ in v only give
// A^-1 M column by column.
TEST(Physics, AssembledStiffnessIsSymmetricAndPositiveSemiDefinite) {
  for (const bool measured : {false, true}) {
    const Scene scene =
        mesh_scene(irregular_sheet(3, 0.3, 0.3),
                   measured ? read_material("deploy/materials/gray-interlock.json") : constant_anisotropic_material());
    Dynamics dynamics(scene.garment, scene);
    const Points x = crumpled(scene.garment);
    ThreadPool pool(1);
    Dynamics::Step step{};
    step.length_s = 5e-3;
    step.gravity.setZero();
    step.wind.density = 0;
    step.tolerance = 1e-7;
    step.max_iterations = 2000;
    const auto size = static_cast<Eigen::Index>(3 * x.size());
    const auto after = [&](Eigen::Index moved) {
      Points v(x.size(), Vector3d::Zero());
      if (moved >= 0) v[static_cast<std::size_t>(moved / 3)][moved % 3] = 1;
      dynamics.solve(x, v, step, pool);
      return v;
    };
    const Points base = after(-1);
    Eigen::MatrixXd inverse(size, size);  // A^-1
    for (Eigen::Index column = 0; column < size; ++column) {
      const Points moved = after(column);
      for (Eigen::Index row = 0; row < size; ++row) {
        const auto v = static_cast<std::size_t>(row / 3);
        inverse(row, column) =
            (moved[v][row % 3] - base[v][row % 3]) / dynamics.masses()[static_cast<std::size_t>(column / 3)];
      }
    }
    EXPECT_LT((inverse - inverse.transpose()).norm(), 1e-4 * inverse.norm());
    // M^1/2 A^-1 M^1/2 = (1 + h^2 M^-1/2 K M^-1/2)^-1: its eigenvalues are in (0, 1], three translations are at 1.
    Eigen::VectorXd root(size);
    for (Eigen::Index i = 0; i < size; ++i) root[i] = std::sqrt(dynamics.masses()[static_cast<std::size_t>(i / 3)]);
    const Eigen::MatrixXd scaled = root.asDiagonal() * (inverse + inverse.transpose()) / 2 * root.asDiagonal();
    const Eigen::VectorXd values = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(scaled).eigenvalues();
    EXPECT_GT(values.minCoeff(), 0);
    EXPECT_LT(values.maxCoeff(), 1 + 1e-4);
    EXPECT_NEAR(values[size - 3], 1, 1e-4);
    EXPECT_LT(values.minCoeff(), 0.5);  // the stiffness is felt
  }
}

// Pulls a sheet homogeneously by `stretch` along a direction of its material and lets it contract across until nothing
// pulls there. Returns force over rest width, N/m.
double uniaxial_pull(const Material& material, double direction, double stretch) {
  Topology garment = sheet(6, 6, 0.3, 0.3);
  const Eigen::Rotation2Dd rotation(direction);  // material coordinates of the pulling direction
  for (Eigen::Index v = 0; v < garment.vertex_count(); ++v) {
    garment.uv.row(v) = (rotation * garment.uv.row(v).transpose().cast<double>()).transpose().cast<float>();
  }
  const Scene scene = mesh_scene(garment, material);
  const Dynamics dynamics(scene.garment, scene);
  const auto pulls = [&](double across) {
    Points x = to_points(garment.rest_positions);
    for (Vector3d& p : x) p = Vector3d(stretch * p.x(), 0, across * p.z());
    const Points forces = dynamics.internal_forces(x);
    Vector2d pull(0, 0);  // of the edges x = 0.15 and z = 0.15
    for (std::size_t v = 0; v < x.size(); ++v) {
      const auto row = static_cast<Eigen::Index>(v);
      if (garment.rest_positions(row, 0) > 0.149f) pull.x() -= forces[v].x();
      if (garment.rest_positions(row, 2) > 0.149f) pull.y() -= forces[v].z();
    }
    return Vector2d(pull / 0.3);
  };
  double low = 0.6, high = 1.2;  // contracted too far: it pushes outwards
  for (int k = 0; k < 40; ++k) {
    const double middle = (low + high) / 2;
    (pulls(middle).y() > 0 ? high : low) = middle;
  }
  return pulls(high).x();
}

TEST(Physics, IsotropicUniaxialStretchIsYoungsModulusInEveryDirection) {
  // A St. Venant-Kirchhoff sheet under uniaxial stress: S = E t G, whatever Poisson's ratio; force per rest width
  // = stretch times S.
  const double membrane = 150;
  for (const double poisson : {0.0, 0.3}) {
    for (const double direction : {0.0, 0.3, kPi / 4, kPi / 2, 2.0}) {
      for (const double stretch : {1.02, 1.1, 1.25}) {
        const double g = (stretch * stretch - 1) / 2;
        const double expected = membrane * g * stretch;
        EXPECT_NEAR(uniaxial_pull(isotropic_material(membrane, poisson, 1e-6, 0.2), direction, stretch), expected,
                    2e-3 * expected)
            << direction << " " << stretch;
      }
    }
  }
}

TEST(Physics, MeasuredUniaxialStretchIsTheMaterialsTable) {
  // Gray Interlock, its figures by hand. Across stays free: S11 = c12 G00 + c22 G11 = 0, which leaves
  // c11 - c12^2 / c22. Beyond a stretch of 1 + 1/6 the rows 1 (along u) and 5 (along v) hold alone; half way, they
  // blend half with row 0, whose negative c12 counts as 0. All are doubled.
  const Material gray = read_material("deploy/materials/gray-interlock.json");
  const auto expected = [](double along, double coupling, double across, double stretch) {
    const double limited = std::min(coupling, std::sqrt(along * across));
    return 2 * (along - limited * limited / across) * (stretch * stretch - 1) / 2 * stretch;
  };
  const double far = 1.25, half = 1 + 1.0 / 12;
  const double along_u = expected(46.364765, 53.694656, 261.013855, far);
  EXPECT_NEAR(uniaxial_pull(gray, 0, far), along_u, 5e-3 * along_u);
  const double along_v = expected(405.872833, 85.848587, 127.443810, far);
  EXPECT_NEAR(uniaxial_pull(gray, kPi / 2, far), along_v, 5e-3 * along_v);
  const double half_v =
      expected((405.872833 + 34.477123) / 2, (85.848587 - 14.695990) / 2, (127.443810 + 16.593832) / 2, half);
  EXPECT_NEAR(uniaxial_pull(gray, kPi / 2, half), half_v, 1e-2 * half_v);
}

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
