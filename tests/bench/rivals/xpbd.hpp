// Small-step XPBD (Macklin et al. 2016, 2019): many sub-steps of one iteration each.
#pragma once

#include <vector>

#include "tests/bench/rivals/lanes.hpp"
#include "tests/bench/rivals/rival_cloth.hpp"

namespace pleat::bench {

/// Constraints of a sub-step, Gauss-Seidel in packs of eight without common vertices: per face the three components of
/// Green strain together, with the compliance of the material's table at the strain; per hinge its angle; then handles
/// and contacts, which stay linearised as the contact step began.
class Xpbd : public RivalCloth {
 public:
  /// substeps: per contact step.
  Xpbd(const simulation::Scene& scene, const Topology& garment, const Positions& start, int substeps);

 protected:
  void advance(double step_s, std::span<const simulation::ContactForce> contacts) override;

 private:
  template <std::size_t kCorners>
  struct Mobilities {
    std::array<Float8, kCorners> w;  // inverse masses, 1/kg
  };
  void solve_faces(float h2);
  void solve_hinges(float h2);
  void solve_pins(float h2);
  void solve_contacts(float h, std::span<const simulation::ContactForce> contacts);

  int substeps_;
  std::vector<Face8> face_packs_;
  std::vector<Mobilities<3>> face_mobilities_;
  std::vector<Hinge8> hinge_packs_;
  std::vector<Mobilities<4>> hinge_mobilities_;
  std::vector<Double4> accelerations_, before_, step_start_;
};

}  // namespace pleat::bench
