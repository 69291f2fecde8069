// Holds a fine cloth to a surface by averages, in the weak form of Bergou et al. 2007 (TRACKS); docs/simulation.md.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/base/simd.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::simulation {

/// With the hat function N_v of coarse vertex v over the fine vertices (their barycentric weights), its mass
/// m_v = sum_i m_i N_v(i) and the normalised weights phi_v(i) = m_i N_v(i) / m_v, the energy of fine positions x before
/// targets y (fine, the upsampled coarse surface) is
///
///     E = omega^2 / 2 sum_v m_v |phi_v . (x - y)|^2.
///
/// A common offset of all vertices swings with the angular frequency omega exactly, whatever the mesh and the cloth.
/// What has no averages over the hats feels no force.
class Averages {
 public:
  Averages() = default;
  /// masses: kg per fine vertex. place: the solver's index of a fine vertex; what is per vertex below is by place.
  Averages(const Subdivision& subdivision, const Faces& coarse_faces, std::span<const double> masses,
           std::span<const std::uint32_t> place);

  bool empty() const { return masses_.empty(); }
  std::size_t count() const { return masses_.size(); }
  double mass(std::size_t v) const { return masses_[v]; }  ///< m_v, kg
  double total_mass() const { return total_mass_; }        ///< kg

  /// phi_v, ascending in place.
  struct Weight {
    std::uint32_t place;
    float weight;
  };
  std::span<const Weight> weights(std::size_t v) const {
    return std::span(weights_).subspan(begin_[v], begin_[v + 1] - begin_[v]);
  }
  /// sum_v m_v phi_v(i)^2: the diagonal of the energy's Hessian over omega^2.
  float diagonal(std::size_t i) const { return diagonal_[i]; }

  /// Pulls: m_v phi_v . field, to be read by pull_at(). Lanes 0 to 2 of the field count. O(weights).
  void gather(std::span<const Float4> field, ThreadPool& pool);
  /// The same of a field in double precision, whose common part may be much larger than its differences.
  void gather(std::span<const Double4> field, ThreadPool& pool);
  /// sum_v phi_v(i) times the pull of v: row i of H / omega^2 times the field, H being the energy's Hessian.
  Float4 pull_at(std::size_t i) const {
    const Corners& c = corners_[i];
    return c.weight[0] * pulls_[c.coarse[0]] + c.weight[1] * pulls_[c.coarse[1]] + c.weight[2] * pulls_[c.coarse[2]];
  }

 private:
  struct Corners {
    std::uint32_t coarse[3];
    float weight[3];  // phi of each at the vertex
  };
  std::vector<Corners> corners_;
  std::vector<std::uint32_t> begin_;
  std::vector<Weight> weights_;
  std::vector<double> masses_;
  std::vector<float> diagonal_;
  std::vector<Float4> pulls_;
  double total_mass_ = 0;
};

}  // namespace pleat::simulation
