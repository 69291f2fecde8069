// The forces of whole meshes against truth that was not made by them: finite differences of an energy that is written
// again here, and closed forms of stretch.
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <functional>
#include <random>

#include "services/simulation/dynamics.hpp"
#include "tests/unit/services/simulation/garments.hpp"
#include "tests/unit/services/simulation/physics.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

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

Dynamics::Step precise_step() {
  Dynamics::Step step{};
  step.length_s = 5e-3;
  step.gravity.setZero();
  step.wind.density = 0;
  step.tolerance = 1e-7;
  step.max_iterations = 2000;
  return step;
}

// A^-1 of a step. One linearised step without damping changes the velocities by A dv = h F - h^2 K v with A = M + h^2
// K, so that v + dv = A^-1 (M v + h F): two steps that differ in v only give A^-1 M column by column.
Eigen::MatrixXd inverse_of_step(Dynamics& dynamics, const Points& x, ThreadPool& pool) {
  const auto size = static_cast<Eigen::Index>(3 * x.size());
  const Dynamics::Step step = precise_step();
  const auto after = [&](Eigen::Index moved) {
    Points v(x.size(), Vector3d::Zero());
    if (moved >= 0) v[static_cast<std::size_t>(moved / 3)][moved % 3] = 1;
    dynamics.solve(x, v, step, pool);
    return v;
  };
  const Points base = after(-1);
  Eigen::MatrixXd inverse(size, size);
  for (Eigen::Index column = 0; column < size; ++column) {
    const Points moved = after(column);
    for (Eigen::Index row = 0; row < size; ++row) {
      const auto v = static_cast<std::size_t>(row / 3);
      inverse(row, column) =
          (moved[v][row % 3] - base[v][row % 3]) / dynamics.masses()[static_cast<std::size_t>(column / 3)];
    }
  }
  return inverse;
}

// The whole mesh's stiffness as the engine uses it.
TEST(Physics, AssembledStiffnessIsSymmetricAndPositiveSemiDefinite) {
  for (const bool measured : {false, true}) {
    const Scene scene =
        mesh_scene(irregular_sheet(3, 0.3, 0.3),
                   measured ? read_material("deploy/materials/gray-interlock.json") : constant_anisotropic_material());
    Dynamics dynamics(scene.garment, scene);
    const Points x = crumpled(scene.garment);
    ThreadPool pool(1);
    const auto size = static_cast<Eigen::Index>(3 * x.size());
    const Eigen::MatrixXd inverse = inverse_of_step(dynamics, x, pool);
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

// Contacts of a vertex, an edge and a face with obstacles, and of cloth with cloth, by both solvers: a mesh alone, and
// one with coarser levels.
TEST(Physics, ContactsActAsTheirDenseMatrices) {
  const Subdivision mesh = subdivide(irregular_sheet(3, 0.3, 0.3), 1);
  const Scene scene = mesh_scene(mesh.fine, constant_anisotropic_material());
  const Points x = crumpled(mesh.fine);
  const auto size = static_cast<Eigen::Index>(3 * x.size());
  const auto faces = [&](Eigen::Index f, int k) { return mesh.fine.faces(f, k); };
  const auto far = static_cast<std::uint32_t>(x.size() - 1);
  const std::vector<ContactForce> contacts = {
      {{faces(0, 0), kNone, kNone, kNone}, {1, 0, 0, 0}, {0, 1, 0}, 0.02f, 300, 0.1f, {0.1f, -0.2f, 0}},
      {{faces(5, 0), faces(5, 1), kNone, kNone},
       {0.6f, 0.4f, -0.3f, -0.7f},
       {0.6f, 0, 0.8f},
       0.01f,
       500,
       0.2f,
       {0, 0, 0.3f}},
      {{kNone, faces(9, 0), faces(9, 1), faces(9, 2)},
       {1, -0.2f, -0.3f, -0.5f},
       {0, -1, 0},
       0.03f,
       200,
       0.05f,
       {0.2f, 0, 0}},
      {{0, far, kNone, kNone}, {1, -1, 0, 0}, {0.8f, 0.6f, 0}, 0.02f, 400, 0.1f, {0, 0, 0}}};
  for (const bool levels : {false, true}) {
    Dynamics dynamics(mesh.fine, scene);
    if (levels) dynamics.use_levels(mesh);
    ThreadPool pool(1);
    Dynamics::Step step = precise_step();
    Points free(x.size(), Vector3d::Zero()), touched = free;
    dynamics.solve(x, free, step, pool);
    Eigen::MatrixXd matrix = inverse_of_step(dynamics, x, pool).inverse();
    const auto flat = [](const Points& v) -> Eigen::VectorXd {
      return Eigen::Map<const Eigen::VectorXd>(v[0].data(), static_cast<Eigen::Index>(3 * v.size()));
    };
    Eigen::VectorXd right = matrix * flat(free);
    const double h = step.length_s;
    for (const ContactForce& c : contacts) {
      const Vector3d n = c.normal.cast<double>();
      const Eigen::Matrix3d nn = n * n.transpose();
      const Eigen::Matrix3d block = h * h * static_cast<double>(c.stiffness) * nn +
                                    h * static_cast<double>(c.friction) * (Eigen::Matrix3d::Identity() - nn);
      const Vector3d impulse = h * static_cast<double>(c.force) * n - block * c.approach.cast<double>();
      for (std::size_t i = 0; i < 4; ++i) {
        if (c.vertices[i] == kNone) continue;
        const auto row = static_cast<Eigen::Index>(3 * c.vertices[i]);
        right.segment<3>(row) += static_cast<double>(c.weights[i]) * impulse;
        for (std::size_t j = 0; j < 4; ++j) {
          if (c.vertices[j] == kNone) continue;
          matrix.block<3, 3>(row, static_cast<Eigen::Index>(3 * c.vertices[j])) +=
              static_cast<double>(c.weights[i]) * static_cast<double>(c.weights[j]) * block;
        }
      }
    }
    step.contacts = contacts;
    dynamics.forget_last_change();
    dynamics.solve(x, touched, step, pool);
    const Eigen::VectorXd expected = matrix.partialPivLu().solve(right);
    EXPECT_LT((flat(touched) - expected).norm(), 2e-3 * (expected - flat(free)).norm()) << levels;
    EXPECT_GT((expected - flat(free)).norm(), 0.1 * expected.norm());
    EXPECT_EQ(expected.size(), size);
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

}  // namespace
}  // namespace pleat::simulation
