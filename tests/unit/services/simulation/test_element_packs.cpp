#include "services/simulation/element_packs.hpp"

#include <gtest/gtest.h>

#include <numbers>
#include <random>

#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

std::mt19937 engine{5};
double in(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine); }
float float_in(double low, double high) { return static_cast<float>(in(low, high)); }

// Vertices of eight elements, four each, about a far origin: what the elements see are differences.
struct Cloud {
  Cloud() {
    for (int v = 0; v < 32; ++v) {
      const Vector3d corner = v % 4 == 1   ? Vector3d(1, 0, 0)
                              : v % 4 == 2 ? Vector3d(0, 1, 0)
                              : v % 4 == 3 ? Vector3d(0, -1, 0)
                                           : Vector3d(0, 0, 0);
      points.push_back(Vector3d(100, 200, -300) +
                       0.05 * (corner + 0.4 * Vector3d(in(-1, 1), in(-1, 1), 2 * in(-1, 1))));
    }
    for (const Vector3d& p : points) registers.push_back(Double4{p.x(), p.y(), p.z(), 0});
  }
  Vector3f edge(std::size_t element, std::size_t corner) const {
    return (points[4 * element + corner] - points[4 * element]).cast<float>();
  }
  std::vector<Vector3d> points;
  std::vector<Double4> registers;
};

TriangleRest<float> random_rest() {
  TriangleRest<float> rest;
  rest.du = {0, float_in(18, 22), float_in(-3, 3)};
  rest.dv = {0, float_in(-3, 3), float_in(18, 22)};
  rest.du[0] = -rest.du[1] - rest.du[2];
  rest.dv[0] = -rest.dv[1] - rest.dv[2];
  rest.area = float_in(1e-3, 2e-3);
  return rest;
}

void expect_near(const Vector3f& a, const Vector3f& b, float tolerance) {
  EXPECT_LE((a - b).cwiseAbs().maxCoeff(), tolerance) << a.transpose() << " against " << b.transpose();
}

TEST(ElementPacks, StretchingIsThatOfTheScalarElements) {
  Material material = plain_material(100, 1e-6);
  material.stretching[2] = {80, 10, 60, 30};
  const StretchingTable table(material, 1);
  for (int trial = 0; trial < 200; ++trial) {
    const Cloud cloud;
    FacePack pack;
    std::vector<TriangleRest<float>> rests;
    for (std::uint32_t e = 0; e < kPack; ++e) {
      rests.push_back(random_rest());
      pack.set(e, {4 * e, 4 * e + 1, 4 * e + 2}, rests.back());
    }
    std::vector<float> records(kPack * kFaceRecord);
    stretching_pack(pack, cloud.registers.data(), table, nullptr, records.data());
    for (std::size_t e = 0; e < kPack; ++e) {
      const auto strain = triangle_strain(rests[e], cloud.edge(e, 1), cloud.edge(e, 2));
      const Moduli k = table.at(strain.g00, strain.g11, strain.g01);
      Vector3f f1, f2;
      stretching_forces(rests[e], k, strain, f1, f2);
      std::array<Eigen::Matrix3f, 3> blocks;
      stretching_stiffness(rests[e], k, strain, blocks);
      const float* record = records.data() + e * kFaceRecord;
      const float largest = std::max(f1.norm(), f2.norm()), stiffest = blocks[0].norm() + blocks[1].norm();
      expect_near(Eigen::Map<const Vector3f>(record + kFaceForces), -(f1 + f2), 1e-4f * largest);
      expect_near(Eigen::Map<const Vector3f>(record + kFaceForces + 3), f1, 1e-4f * largest);
      expect_near(Eigen::Map<const Vector3f>(record + kFaceForces + 6), f2, 1e-4f * largest);
      for (std::size_t b = 0; b < 3; ++b) {
        const Eigen::Map<const Eigen::Matrix3f> block(record + 9 * b);
        EXPECT_LE((block - blocks[b]).norm(), 1e-4f * stiffest);
      }
    }
  }
}

TEST(ElementPacks, BendingIsThatOfTheScalarElementsOnTheBranchOfTheLastStep) {
  for (int trial = 0; trial < 200; ++trial) {
    const Cloud cloud;
    HingePack pack;
    std::vector<HingeRest<float>> rests;
    std::array<float, kPack> angles{};
    for (std::uint32_t e = 0; e < kPack; ++e) {
      HingeRest<float> rest{float_in(0.5, 2), float_in(5, 40), {}};
      for (float& k : rest.stiffness) k = float_in(1e-6, 1e-4);
      pack.set(e, {4 * e, 4 * e + 1, 4 * e + 2, 4 * e + 3}, rest);
      rests.push_back(rest);
      angles[e] = e % 2 == 0 ? 0.0f : float_in(-7, 7);
    }
    const auto before = angles;
    std::vector<float> records(kPack * kHingeRecord);
    bending_pack(pack, cloud.registers.data(), angles.data(), records.data());
    for (std::size_t e = 0; e < kPack; ++e) {
      const auto angle = hinge_angle<float>(cloud.edge(e, 1), cloud.edge(e, 2), cloud.edge(e, 3));
      const float turns = (angles[e] - angle.theta) / (2 * std::numbers::pi_v<float>);
      EXPECT_NEAR(turns, std::round(turns), 1e-5f) << "the angle is another one";
      EXPECT_LE(std::abs(angles[e] - before[e]), std::numbers::pi_v<float> + 1e-4f) << "another branch";
      const float ke = hinge_stiffness(rests[e], angles[e]);
      const float* record = records.data() + e * kHingeRecord;
      const float moment = hinge_moment(rests[e], ke, angles[e]), curvature = hinge_curvature(rests[e], ke);
      for (std::size_t k = 0; k < 4; ++k) {
        const Eigen::Map<const Vector3f> scaled(record + 4 * k);
        const float size = angle.gradient[k].norm();
        expect_near(record[3] * scaled, -moment * angle.gradient[k], 2e-4f * std::abs(moment) * size + 1e-12f);
        expect_near(scaled, std::sqrt(curvature) * angle.gradient[k], 2e-4f * std::sqrt(curvature) * size);
      }
    }
  }
}

TEST(ElementPacks, EmptyLanesAndCollapsedElementsStayFinite) {
  const std::vector<Double4> point(4, Double4{1, 2, 3, 0});
  std::vector<float> records(kPack * kFaceRecord, 1e30f);
  stretching_pack(FacePack{}, point.data(), StretchingTable(plain_material(100, 1e-6), 1), nullptr, records.data());
  for (const float value : records) EXPECT_EQ(value, 0);
  HingePack pack;
  pack.set(0, {0, 1, 2, 3}, HingeRest<float>{1, 10, {1e-5f, 1e-5f, 1e-5f, 1e-5f, 1e-5f}});
  std::array<float, kPack> angles{};
  records.assign(kPack * kHingeRecord, 0);
  bending_pack(pack, point.data(), angles.data(), records.data());
  for (const float value : records) EXPECT_TRUE(std::isfinite(value));
}

TEST(ElementPacks, TheAirPushesAlongTheNormalAndNeverReversesTheMotion) {
  const Cloud cloud;
  FacePack pack;
  for (std::uint32_t e = 0; e < kPack; ++e) pack.set(e, {4 * e, 4 * e + 1, 4 * e + 2}, random_rest());
  const StretchingTable table(plain_material(0, 0), 1);
  std::vector<Double4> velocities(32, Double4{0.5, -1, 2, 0});
  const Vector3d relative = Vector3d(3, 0, 1) - Vector3d(0.5, -1, 2);
  for (const float largest : {1e3f, 0.1f}) {
    Air air{velocities.data(), Vector3f(3, 0, 1), 1.2f, 0.3f, largest};
    std::vector<float> records(kPack * kFaceRecord);
    stretching_pack(pack, cloud.registers.data(), table, &air, records.data());
    for (std::size_t e = 0; e < kPack; ++e) {
      const Vector3d n = cloud.edge(e, 1).cross(cloud.edge(e, 2)).cast<double>().normalized();
      const double along = relative.dot(n), area = static_cast<double>(pack.area[static_cast<int>(e)]);
      const double pressure = std::min(1.2 * std::abs(along), static_cast<double>(largest)) * area;
      const double drag = std::min(0.3, static_cast<double>(largest)) * area;
      const Vector3d expected = (pressure * along * n + drag * (relative - along * n)) / 3;
      for (std::size_t k = 0; k < 3; ++k) {
        const Eigen::Map<const Vector3f> force(records.data() + e * kFaceRecord + kFaceForces + 3 * k);
        expect_near(force, expected.cast<float>(), 1e-5f * static_cast<float>(expected.norm()) + 1e-9f);
      }
    }
  }
}

}  // namespace
}  // namespace pleat::simulation
