// The leanest direct simulation of a fine sheet that still gives usable frames: XPBD with isotropic springs and
// particle self-collision. What a pipeline of coarse simulation and super-resolution has to beat.
#pragma once

#include <array>
#include <barrier>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/base/simd.hpp"
#include "common/mesh/mesh.hpp"
#include "services/simulation/scene.hpp"
#include "tests/bench/rivals/lanes.hpp"

namespace pleat::bench {

struct LeanOptions {
  int substeps = 96;        ///< a frame
  int detections = 8;       ///< searches of the grid a frame; divides substeps
  double radius_m = 0;      ///< particles keep this distance; 0: no self-collision
  std::size_t threads = 2;  ///< 1 or 2
};

/// Float32, one iteration a sub-step, in packs of eight springs without common vertices. The sheet is cut in as many
/// parts as there are threads; what crosses the cut is one thread's work while the other waits. No air, no friction, no
/// anisotropy, handles are hard: each of them would only make it slower. The same for every run with as many threads.
class LeanCloth {
 public:
  /// garment: rest shape; start: (V x 3); the scene gives material, gravity, handles (hard and at rest here), frame
  /// time.
  LeanCloth(const simulation::Scene& scene, const Topology& garment, const Positions& start,
            const LeanOptions& options);

  void frame();
  Positions positions() const;

 private:
  struct Spring {
    std::array<std::uint32_t, 2> v;
    float rest, stiffness;
  };
  // Per lane: the rest length, and the share of its error by which each end moves; 0 where there is no spring.
  struct Spring8 {
    std::array<Lanes, 2> v{};
    Float8 rest{}, share0{}, share1{};
  };
  using Pair = std::array<std::uint32_t, 2>;
  // What a thread owns: vertices [first, last) of the order along the cut's normal, springs and close pairs among them.
  struct Part {
    std::uint32_t first, last;
    std::vector<Spring8> springs;
    std::vector<Pair> close, crossing;
    float fastest;  // largest speed, m/s
  };

  std::vector<Spring8> pack(const std::vector<Spring>& springs) const;
  void work(std::size_t part);
  void solve(std::span<const Spring8> springs);
  void separate(std::span<const Pair> pairs);
  void sort_into_cells();
  void find_close_pairs(Part& part);

  LeanOptions options_;
  float h_, radius2_;
  Float4 gravity_;
  std::vector<std::uint32_t> order_;  // vertex of the garment at each place; all below is by place
  std::vector<Float4> rest_, x_, before_, v_;
  std::vector<float> inverse_masses_;
  std::vector<Part> parts_;
  std::vector<Spring8> cut_springs_;
  std::barrier<> barrier_;

  // The grid: cells of the search radius over the bounding box, x fastest, and the particles sorted by cell.
  float search_ = 0;
  std::array<int, 3> cells_{};
  Float4 corner_{};
  std::vector<std::uint32_t> cell_begin_, cell_of_, sorted_;
  std::vector<Float4> sorted_x_;
};

}  // namespace pleat::bench
