#include "services/simulation/averages.hpp"

#include <algorithm>
#include <numeric>

namespace pleat::simulation {
namespace {

constexpr std::size_t kCoarseGrain = 512;

}  // namespace

Averages::Averages(const Subdivision& subdivision, const Faces& coarse_faces, std::span<const double> masses,
                   std::span<const std::uint32_t> place) {
  const std::size_t fine = masses.size(), coarse = subdivision.feature_vertices.size();
  corners_.resize(fine);
  masses_.assign(coarse, 0);
  const auto corner = [&](std::size_t i, int k) { return coarse_faces(subdivision.parent_face[i], k); };
  const auto hat = [&](std::size_t i, int k) {
    return static_cast<double>(subdivision.barycentric(static_cast<Eigen::Index>(i), k));
  };
  for (std::size_t i = 0; i < fine; ++i) {
    for (int k = 0; k < 3; ++k) masses_[corner(i, k)] += masses[i] * hat(i, k);
  }
  total_mass_ = std::accumulate(masses_.begin(), masses_.end(), 0.0);
  diagonal_.assign(fine, 0);
  begin_.assign(coarse + 1, 0);
  for (std::size_t i = 0; i < fine; ++i) {
    Corners& c = corners_[place[i]];
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t v = corner(i, k);
      const double mass = masses_[v], weight = mass > 0 ? masses[i] * hat(i, k) / mass : 0;
      c.coarse[k] = v;
      c.weight[k] = static_cast<float>(weight);
      diagonal_[place[i]] += static_cast<float>(mass * weight * weight);
      if (weight > 0) ++begin_[v + 1];
    }
  }
  std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
  weights_.resize(begin_.back());
  std::vector<std::uint32_t> next(begin_.begin(), begin_.end() - 1);
  for (std::uint32_t i = 0; i < fine; ++i) {
    for (int k = 0; k < 3; ++k) {
      if (corners_[i].weight[k] > 0) weights_[next[corners_[i].coarse[k]]++] = {i, corners_[i].weight[k]};
    }
  }
  pulls_.assign(coarse, Float4{});
}

void Averages::gather(std::span<const Float4> field, ThreadPool& pool) {
  pool.parallel_for(count(), kCoarseGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      Float4 sum{};
      for (const Weight& w : weights(v)) sum += w.weight * field[w.place];
      sum *= static_cast<float>(masses_[v]);
      sum[3] = 0;
      pulls_[v] = sum;
    }
  });
}

void Averages::gather(std::span<const Double4> field, ThreadPool& pool) {
  pool.parallel_for(count(), kCoarseGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      Double4 sum{};
      for (const Weight& w : weights(v)) sum += static_cast<double>(w.weight) * field[w.place];
      sum *= masses_[v];
      pulls_[v] = Float4{static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2]), 0};
    }
  });
}

}  // namespace pleat::simulation
