// bench_vertex_features: what features and coordinates cost per frame, beside a plain implementation of the same
// formulas (double, one vertex at a time, Eigen's SVD) and CHOLMOD's own solve, all interleaved in one run. One thread.
#include <CLI/CLI.hpp>
#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "services/conversion/vertex_features/coordinates.hpp"
#include "services/conversion/vertex_features/extraction.hpp"
#include "services/conversion/vertex_features/polar.hpp"
#include "tests/unit/services/conversion/vertex_features/sheets.hpp"

namespace {

using pleat::Positions;
using pleat::conversion::RotationCode;
using Clock = std::chrono::steady_clock;

struct Timer {
  std::vector<std::string> names;
  std::map<std::string, std::vector<double>> ms;

  void run(const std::string& name, const std::function<void()>& body) {
    const auto begin = Clock::now();
    body();
    if (!ms.contains(name)) names.push_back(name);
    ms[name].push_back(std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  void print(std::size_t vertices) {
    for (const std::string& name : names) {
      std::vector<double>& times = ms[name];
      std::sort(times.begin(), times.end());
      std::printf("%9zu %-44s %9.4f %9.4f\n", vertices, name.c_str(), times[times.size() / 2], times.front());
    }
  }
};

// T = R S, one vertex at a time.
void plain_polar(const pleat::conversion::GradientField& field, std::vector<double>& values) {
  values.resize(9 * field.columns.size());
  for (std::size_t v = 0; v < field.columns.size(); ++v) {
    const Eigen::Matrix3d t = field.at(v).cast<double>();
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(t, Eigen::ComputeFullU | Eigen::ComputeFullV);
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(svd.matrixU() * svd.matrixV().transpose()));
    const Eigen::Matrix3d s = svd.matrixV() * svd.singularValues().asDiagonal() * svd.matrixV().transpose();
    Eigen::Map<Eigen::Vector3d>(values.data() + 9 * v) = turn.angle() * turn.axis();
    for (int k = 0; k < 6; ++k) values[9 * v + 3 + static_cast<std::size_t>(k)] = s(k / 3, k % 3);
  }
}

pleat::SparseCholesky laplacian(const pleat::conversion::OneRings& rings) {
  std::vector<Eigen::Triplet<double>> entries = {{0, 0, 1.0}};
  for (const auto& e : rings.edges()) {
    const int a = static_cast<int>(e.a), b = static_cast<int>(e.b);
    const double w = 2 * static_cast<double>(e.weight);
    entries.insert(entries.end(), {{a, a, w}, {b, b, w}, {a, b, -w}, {b, a, -w}});
  }
  const auto count = static_cast<Eigen::Index>(rings.vertex_count());
  Eigen::SparseMatrix<double> matrix(count, count);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return pleat::SparseCholesky(matrix);
}

void measure(int side, int runs) {
  const pleat::Topology topology = pleat::test::sheet(side, side, 1.0f / static_cast<float>(side - 1));
  const auto rings = pleat::test::rings_of(topology);
  const pleat::conversion::FeatureExtractor logarithms(rings, RotationCode::kLogarithm);
  const pleat::conversion::FeatureExtractor quaternions(rings, RotationCode::kQuaternion);
  const pleat::conversion::GradientChannels channels(topology.rest_positions);
  Timer timer;
  std::unique_ptr<pleat::conversion::CoordinateSolver> solver;
  for (int k = 0; k < 5; ++k) {
    timer.run("set-up: one-rings", [&] { pleat::test::rings_of(topology); });
    timer.run("set-up: factor", [&] {
      const auto corner = static_cast<std::uint32_t>(side - 1);
      solver = std::make_unique<pleat::conversion::CoordinateSolver>(
          rings, pleat::conversion::Anchors{{0, corner}, {}, 0.1}, "sheet");
    });
  }
  const pleat::SparseCholesky cholesky = laplacian(*rings);
  const Eigen::MatrixXd right = Eigen::MatrixXd::Random(topology.vertex_count(), 3);

  pleat::conversion::ExtractedFrame by_logarithm, by_quaternion;
  pleat::conversion::CoordinateScratch scratch;
  pleat::conversion::GradientField field, gradients;
  std::vector<float> planes;
  std::vector<double> plain;
  Positions handles(2, 3), result;
  for (int k = 0; k < runs; ++k) {
    const float phase = 0.05f * static_cast<float>(k);
    const Positions p = pleat::test::deform(topology, [&](const Eigen::Vector3f& q) {
      return pleat::test::waves(q + Eigen::Vector3f(phase, 0, 0)) - Eigen::Vector3f(phase, 0, 0);
    });
    handles.row(0) = p.row(0);
    handles.row(1) = p.row(side - 1);
    const std::vector<pleat::Float4> before = by_logarithm.labels, before_q = by_quaternion.labels;
    const std::vector<pleat::Float4> registers = pleat::test::registers(p);
    timer.run("extraction, logarithm (9 channels)", [&] { logarithms.extract(p, 0.1f, before, by_logarithm); });
    timer.run("extraction, quaternion (10 channels)", [&] { quaternions.extract(p, 0.1f, before_q, by_quaternion); });
    timer.run("  of it: gradients", [&] { rings->gradients(registers.data(), field); });
    timer.run("plain: rotation and stretch from gradients", [&] { plain_polar(field, plain); });
    timer.run("gradients from 9 channels", [&] {
      pleat::conversion::gradients_from_features(RotationCode::kLogarithm, by_logarithm.values, gradients);
    });
    channels.to_planes(field, planes);
    timer.run("gradients from 6 channels", [&] { channels.from_planes(planes, gradients); });
    timer.run("clamp", [&] { pleat::conversion::clamp_stretch(gradients); });
    for (const int passes : {0, 1, 2}) {
      timer.run("coordinates, " + std::to_string(passes) + " passes",
                [&] { solver->solve(gradients, handles, Positions(0, 3), passes, scratch, result); });
    }
    timer.run("CHOLMOD: one solve of three", [&] { cholesky.solve(right); });
  }
  timer.print(rings->vertex_count());
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Times of vertex features: extraction and coordinates, one thread");
  int runs = 200;
  std::vector<int> sides = {9, 16, 65, 111};
  app.add_option("--runs", runs, "frames for each mesh")->check(CLI::Range(1, 100000));
  app.add_option("--sides", sides, "vertices along the side of each square sheet")->check(CLI::Range(3, 1000));
  CLI11_PARSE(app, argc, argv);
  std::printf("%9s %-44s %9s %9s\n", "vertices", "", "median ms", "least ms");
  for (const int side : sides) measure(side, runs);
  return 0;
}
