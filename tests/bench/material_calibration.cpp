// bench_material_calibration: hangs what a textile laboratory hangs, of each material: a strip over an edge (Peirce
// 1930, the cantilever test), from whose droop comes the bending length, and a disc over a smaller disc (Cusick's drape
// meter). Prints both beside what the material's own figures say.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/simulation/material.hpp"
#include "services/simulation/simulation.hpp"

namespace {

using Eigen::Index;
using pleat::Positions;
using pleat::Topology;
using pleat::simulation::Material;

constexpr double kGravity = 9.81;

/// Square cells in the plane y = 0; material coordinates are x and -z, or turned by 90 degrees.
Topology strip(int length_cells, int width_cells, double cell, bool along_weft) {
  Topology mesh;
  const Index columns = length_cells + 1;
  mesh.rest_positions.resize(columns * (width_cells + 1), 3);
  mesh.uv.resize(mesh.rest_positions.rows(), 2);
  for (Index j = 0; j <= width_cells; ++j) {
    for (Index i = 0; i < columns; ++i) {
      const auto x = static_cast<float>(cell * static_cast<double>(i)),
                 z = static_cast<float>(cell * static_cast<double>(j));
      mesh.rest_positions.row(j * columns + i) << x, 0, z;
      if (along_weft) {
        mesh.uv.row(j * columns + i) << z, x;
      } else {
        mesh.uv.row(j * columns + i) << x, -z;
      }
    }
  }
  mesh.faces.resize(2 * length_cells * width_cells, 3);
  Index face = 0;
  for (Index j = 0; j < width_cells; ++j) {
    for (Index i = 0; i < length_cells; ++i) {
      const auto a = static_cast<std::uint32_t>(j * columns + i), b = a + 1;
      const std::uint32_t c = a + static_cast<std::uint32_t>(columns), d = c + 1;
      // Diagonals alternate, so that the strip has no side.
      if ((i + j) % 2 == 0) {
        mesh.faces.row(face++) << a, c, b;
        mesh.faces.row(face++) << b, c, d;
      } else {
        mesh.faces.row(face++) << a, c, d;
        mesh.faces.row(face++) << a, d, b;
      }
    }
  }
  mesh.uv_faces = mesh.faces;
  return mesh;
}

/// Rings of 6, 12, 18, ... vertices, `edge` apart.
Topology disc(int rings, double edge) {
  Topology mesh;
  const Index count = 1 + 3 * rings * (rings + 1);
  mesh.rest_positions = Positions::Zero(count, 3);
  mesh.uv.resize(count, 2);
  Index vertex = 1;
  for (int ring = 1; ring <= rings; ++ring) {
    for (int k = 0; k < 6 * ring; ++k) {
      const double angle = 2 * std::numbers::pi * k / (6 * ring), radius = edge * ring;
      mesh.rest_positions.row(vertex++) << static_cast<float>(radius * std::cos(angle)), 0,
          static_cast<float>(radius * std::sin(angle));
    }
  }
  for (Index v = 0; v < count; ++v) mesh.uv.row(v) << mesh.rest_positions(v, 0), -mesh.rest_positions(v, 2);
  mesh.faces.resize(6 * rings * rings, 3);
  Index face = 0;
  const auto at = [](int ring, int k) {
    return ring == 0 ? 0u : static_cast<std::uint32_t>(1 + 3 * ring * (ring - 1) + k % (6 * ring));
  };
  for (int ring = 1; ring <= rings; ++ring) {
    for (int side = 0; side < 6; ++side) {
      for (int k = 0; k < ring; ++k) {
        const std::uint32_t outer = at(ring, side * ring + k), next = at(ring, side * ring + k + 1);
        const std::uint32_t inner = at(ring - 1, side * (ring - 1) + k);
        mesh.faces.row(face++) << outer, inner, next;
        if (k + 1 < ring) mesh.faces.row(face++) << next, inner, at(ring - 1, side * (ring - 1) + k + 1);
      }
    }
  }
  mesh.uv_faces = mesh.faces;
  return mesh;
}

/// Where the garment comes to rest with those of its vertices held that `is_held` says.
template <typename Held>
Positions at_rest(Topology garment, const Material& material, double perturbation_m, int frames, Held is_held) {
  pleat::simulation::Scene scene;
  scene.name = "calibration";
  pleat::simulation::Handle handle;
  handle.hard = true;
  for (Index v = 0; v < garment.vertex_count(); ++v) {
    if (is_held(garment.rest_positions.row(v))) handle.vertices.push_back(static_cast<std::uint32_t>(v));
  }
  scene.garment = std::move(garment);
  scene.handles = {std::move(handle)};
  scene.material = material;
  scene.perturbation_m = perturbation_m;
  scene.seed = 1;
  scene.damping_s = 2e-3;
  scene.frames = frames;
  pleat::simulation::Simulation simulation(scene, pleat::simulation::Mode::kCoarse);
  Positions positions;
  for (int k = 0; k < frames; ++k) positions = simulation.next_frame().coarse.positions;
  return positions;
}

/// The droop (rad) of a heavy elastica that sticks out horizontally: of its end, seen from the edge. B t'' = -w (L - s)
/// cos t, t(0) = 0, t'(L) = 0, and load = w L^3 / B.
double elastica_droop(double load) {
  constexpr int kSteps = 2000;
  double x = 0, y = 0;
  const auto end_slope = [&](double curvature) {
    double t = 0, slope = curvature;
    x = y = 0;
    for (int k = 0; k < kSteps; ++k) {
      const double h = 1.0 / kSteps, middle = (k + 0.5) * h, half = t + slope * h / 2;
      x += h * std::cos(half);
      y += h * std::sin(half);
      slope -= h * load * (1 - middle) * std::cos(half);
      t = half + slope * h / 2;
    }
    return slope;
  };
  double low = 0, high = std::min(load, std::sqrt(2 * load));  // from the moment, and from the energy
  for (int k = 0; k < 60; ++k) {
    const double curvature = (low + high) / 2;
    (end_slope(curvature) > 0 ? high : low) = curvature;
  }
  end_slope((low + high) / 2);
  return std::atan2(y, x);
}

/// (B / w)^(1/3), m: w in N/m^2.
double bending_length(double rigidity, const Material& material) {
  return std::cbrt(rigidity / (kGravity * material.density));
}

/// Of a strip along warp or weft, m: hangs it and finds the elastica that droops as much.
double measured_bending_length(const Material& material, bool along_weft) {
  constexpr double kCell = 4e-3;
  const double ke = pleat::simulation::bending_stiffness(material, along_weft ? 1 : 0, along_weft ? 0 : 1, 10);
  const int cells = std::max(6, static_cast<int>(std::lround(2 * bending_length(ke / 4, material) / kCell)));
  const Positions rest = at_rest(strip(cells + 2, 6, kCell, along_weft), material, 0, 120,
                                 [&](const auto& p) { return p.x() < 2.5 * kCell; });
  double x = 0, y = 0;
  int ends = 0;
  for (Index v = cells + 2; v < rest.rows(); v += cells + 3, ++ends) {
    x += double{rest(v, 0)} - 2 * kCell;
    y -= double{rest(v, 1)};
  }
  const double droop = std::atan2(y / ends, x / ends);
  double low = 1e-3, high = 1e3;
  for (int k = 0; k < 60; ++k) {
    const double load = std::sqrt(low * high);
    (elastica_droop(load) > droop ? high : low) = load;
  }
  return cells * kCell / std::cbrt(std::sqrt(low * high));
}

/// Cusick's: a disc of 300 mm on one of 180 mm; the share of the free ring that its shadow covers.
double drape_coefficient(const Material& material) {
  constexpr double kSupport = 0.09, kEdge = 0.01;
  constexpr int kRings = 15;
  const Topology mesh = disc(kRings, kEdge);
  const Positions rest = at_rest(mesh, material, 1e-3, 150, [&](const auto& p) {
    return std::hypot(double{p.x()}, double{p.z()}) < kSupport + kEdge / 2;
  });
  constexpr int kPixels = 800;
  constexpr double kHalf = 0.16, kPixel = 2 * kHalf / kPixels;
  std::vector<char> covered(static_cast<std::size_t>(kPixels) * kPixels, 0);
  for (Index f = 0; f < mesh.face_count(); ++f) {
    Eigen::Vector2d p[3];
    for (int k = 0; k < 3; ++k) p[k] = {double{rest(mesh.faces(f, k), 0)}, double{rest(mesh.faces(f, k), 2)}};
    const auto pixel = [&](double value) {
      return std::clamp(static_cast<int>((value + kHalf) / kPixel), 0, kPixels - 1);
    };
    const auto side = [](const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& q) {
      return (b - a).x() * (q - a).y() - (b - a).y() * (q - a).x();
    };
    for (int i = pixel(std::min({p[0].x(), p[1].x(), p[2].x()})); i <= pixel(std::max({p[0].x(), p[1].x(), p[2].x()}));
         ++i) {
      for (int j = pixel(std::min({p[0].y(), p[1].y(), p[2].y()}));
           j <= pixel(std::max({p[0].y(), p[1].y(), p[2].y()})); ++j) {
        const Eigen::Vector2d q((i + 0.5) * kPixel - kHalf, (j + 0.5) * kPixel - kHalf);
        const double a = side(p[0], p[1], q), b = side(p[1], p[2], q), c = side(p[2], p[0], q);
        if ((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0)) {
          covered[static_cast<std::size_t>(j) * kPixels + static_cast<std::size_t>(i)] = 1;
        }
      }
    }
  }
  const double area = kPixel * kPixel * static_cast<double>(std::count(covered.begin(), covered.end(), 1));
  const double inner = std::numbers::pi * kSupport * kSupport, outer = std::numbers::pi * 0.15 * 0.15;
  return (area - inner) / (outer - inner);
}

void print(const std::string& path) {
  const Material material = pleat::simulation::read_material(path);
  const auto from_figures = [&](bool weft) {  // a strip along u bends about edges along v
    return 1e3 *
           bending_length(pleat::simulation::bending_stiffness(material, weft ? 1 : 0, weft ? 0 : 1, 10) / 4, material);
  };
  const std::string name = path.substr(path.find_last_of('/') + 1);
  std::printf("| `%s` | %.0f | %.1f | %.1f | %.1f | %.1f | %.0f |\n", name.c_str(), 1e3 * material.density,
              from_figures(false), 1e3 * measured_bending_length(material, false), from_figures(true),
              1e3 * measured_bending_length(material, true), 100 * drape_coefficient(material));
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Bending lengths (mm) and drape coefficients (%) of materials, as the hinges' figures say and as simulated.");
  std::vector<std::string> materials;
  app.add_option("materials", materials, "material files")->required()->check(CLI::ExistingFile);
  CLI11_PARSE(app, argc, argv);
  try {
    std::printf(
        "| material | g/m2 | warp: hinges | simulated | weft: hinges | simulated | drape %% "
        "|\n|---|---|---|---|---|---|---|\n");
    for (const std::string& material : materials) print(material);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_material_calibration: %s\n", error.what());
    return 1;
  }
}
