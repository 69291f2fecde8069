#include "services/superres/training/make_mesh_base.hpp"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/superres/metadata.hpp"

namespace pleat::superres {
namespace {

constexpr double kInverseError = 1e-6;  ///< of weights that give back a vertex
constexpr double kInverseWeight = 30;   ///< larger ones would magnify rounding
constexpr int kLargestRing = 6;         ///< edges between a vertex and the texels that determine it
constexpr int kRounds = 2;              ///< of subdivision, from the coarse to the fine mesh

/// Weights of texels that give back vertex v: those of smallest norm, over texels all of whose vertices are in `ring`.
/// Empty if they don't exist.
std::vector<std::pair<float, std::int64_t>> local_inverse(const Eigen::MatrixXd& sampling,
                                                          const std::vector<std::vector<Eigen::Index>>& rows,
                                                          const std::vector<Eigen::Index>& ring, Eigen::Index vertex) {
  std::vector<bool> inside(static_cast<std::size_t>(sampling.cols()), false);
  for (const Eigen::Index v : ring) inside[static_cast<std::size_t>(v)] = true;
  std::vector<Eigen::Index> texels;
  for (const Eigen::Index v : ring) {
    for (const Eigen::Index t : rows[static_cast<std::size_t>(v)]) {
      bool whole = true;
      for (Eigen::Index u = 0; whole && u < sampling.cols(); ++u)
        whole = sampling(t, u) == 0 || inside[static_cast<std::size_t>(u)];
      if (whole) texels.push_back(t);
    }
  }
  std::sort(texels.begin(), texels.end());
  texels.erase(std::unique(texels.begin(), texels.end()), texels.end());
  Eigen::MatrixXd part(static_cast<Eigen::Index>(ring.size()), static_cast<Eigen::Index>(texels.size()));
  Eigen::VectorXd wanted = Eigen::VectorXd::Zero(part.rows());
  for (Eigen::Index i = 0; i < part.rows(); ++i) {
    const Eigen::Index u = ring[static_cast<std::size_t>(i)];
    if (u == vertex) wanted[i] = 1;
    for (Eigen::Index j = 0; j < part.cols(); ++j) part(i, j) = sampling(texels[static_cast<std::size_t>(j)], u);
  }
  if (texels.empty()) return {};
  const Eigen::VectorXd weights = part.completeOrthogonalDecomposition().solve(wanted);
  if ((part * weights - wanted).cwiseAbs().maxCoeff() > kInverseError || weights.cwiseAbs().maxCoeff() > kInverseWeight)
    return {};
  std::vector<std::pair<float, std::int64_t>> result;
  for (Eigen::Index j = 0; j < part.cols(); ++j) {
    if (std::abs(weights[j]) > kInverseError) {
      result.emplace_back(static_cast<float>(weights[j]), texels[static_cast<std::size_t>(j)]);
    }
  }
  return result;
}

/// The sampled image determines the vertices (more texels than unknowns), each by the texels around it alone.
void invert_sampling(const Eigen::MatrixXd& sampling, const Faces& faces, MeshBase& base) {
  const Eigen::Index vertices = sampling.cols();
  std::vector<std::vector<Eigen::Index>> rows(static_cast<std::size_t>(vertices));
  for (Eigen::Index t = 0; t < sampling.rows(); ++t) {
    for (Eigen::Index v = 0; v < vertices; ++v) {
      if (sampling(t, v) != 0) rows[static_cast<std::size_t>(v)].push_back(t);
    }
  }
  std::vector<std::vector<Eigen::Index>> neighbours(static_cast<std::size_t>(vertices));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) neighbours[faces(f, i)].push_back(faces(f, j));
    }
  }
  std::vector<std::vector<std::pair<float, std::int64_t>>> inverse(static_cast<std::size_t>(vertices));
  std::size_t most = 1;
  for (Eigen::Index v = 0; v < vertices; ++v) {
    std::vector<Eigen::Index> ring{v};
    auto& weights = inverse[static_cast<std::size_t>(v)];
    for (int round = 0; round < kLargestRing && weights.empty(); ++round) {
      std::vector<Eigen::Index> wider = ring;
      for (const Eigen::Index u : ring) {
        const auto& near = neighbours[static_cast<std::size_t>(u)];
        wider.insert(wider.end(), near.begin(), near.end());
      }
      std::sort(wider.begin(), wider.end());
      wider.erase(std::unique(wider.begin(), wider.end()), wider.end());
      ring = std::move(wider);
      if (round > 0) weights = local_inverse(sampling, rows, ring, v);
    }
    if (weights.empty()) {
      throw_invalid_argument("data set: the coarse image is too small to hold vertex " + std::to_string(v) +
                             " of the coarse mesh, which residual 'mesh' needs; choose a larger 'images.coarse_width'");
    }
    most = std::max(most, weights.size());
  }
  for (auto& weights : inverse) {
    weights.resize(most, {0.0F, weights.front().second});
    for (const auto& [weight, texel] : weights) {
      base.vertex_weights.push_back(weight);
      base.vertex_texels.push_back(texel);
    }
  }
}

}  // namespace

/// The maps are linear in the vertices, so unit vectors show their columns: three at
/// a time, one in each displacement channel.
MeshBase make_mesh_base(const MeshPair& pair, ImageSpec spec) {
  spec.method = FineImageMethod::kSampled;
  const Subdivision subdivision = subdivide(pair.coarse, kRounds);
  const ImageMap map(pair.coarse, pair.fine, spec);
  const Eigen::Index vertices = pair.coarse.vertex_count();
  const Eigen::Index texels = Eigen::Index{map.coarse_width()} * map.coarse_height();
  const auto fine_texels = static_cast<std::size_t>(texels) * kScale * kScale;
  Eigen::MatrixXd sampling = Eigen::MatrixXd::Zero(texels, vertices);
  std::vector<std::vector<std::pair<float, std::int64_t>>> corners(fine_texels);
  Tensor coarse_image, fine_image;
  for (Eigen::Index first = 0; first < vertices; first += 3) {
    Positions units = Positions::Zero(vertices, 3);
    for (Eigen::Index k = 0; k < std::min<Eigen::Index>(3, vertices - first); ++k) units(first + k, k) = 1;
    Frame coarse, fine;
    coarse.positions = pair.coarse.rest_positions + units;
    fine.positions = pair.fine.rest_positions + upsample(subdivision, pair.coarse.faces, units);
    map.coarse_image(coarse, RigidTransform{}, coarse_image);
    map.fine_image(fine, RigidTransform{}, fine_image);
    for (Eigen::Index k = 0; k < std::min<Eigen::Index>(3, vertices - first); ++k) {
      const float* c = coarse_image.values.data() + k * texels;
      for (Eigen::Index t = 0; t < texels; ++t) sampling(t, first + k) = c[t];
      const float* f = fine_image.values.data() + static_cast<std::size_t>(k) * fine_texels;
      for (std::size_t t = 0; t < fine_texels; ++t) {
        if (f[t] > 1e-4F) corners[t].emplace_back(f[t], first + k);
      }
    }
  }
  MeshBase base;
  base.vertices = vertices;
  invert_sampling(sampling, pair.coarse.faces, base);
  const Eigen::MatrixXd rest = sampling * pair.coarse.rest_positions.cast<double>();
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    for (Eigen::Index t = 0; t < texels; ++t) base.rest.push_back(static_cast<float>(rest(t, axis)));
  }
  base.corners.assign(3 * fine_texels, 0);
  base.weights.assign(3 * fine_texels, 0);
  base.structure.assign(kStructureChannels * static_cast<std::size_t>(texels), 0);
  const auto width = static_cast<std::size_t>(map.fine_width());
  for (std::size_t t = 0; t < fine_texels; ++t) {
    auto& list = corners[t];
    std::sort(list.rbegin(), list.rend());
    list.resize(3);
    const float sum = list[0].first + list[1].first + list[2].first;
    for (std::size_t k = 0; k < 3; ++k) {
      const float weight = sum > 0 ? list[k].first / sum : 0.0F;
      base.corners[k * fine_texels + t] = list[k].second;
      base.weights[k * fine_texels + t] = weight;
      if (k == 2) continue;
      // Between 1/3 and 1, and 0 and 1/2: brought to about -1 to 1.
      const std::size_t row = t / width, column = t % width;
      const std::size_t channel = kScale * kScale * k + kScale * (row % kScale) + column % kScale;
      base.structure[(channel * static_cast<std::size_t>(map.coarse_height()) + row / kScale) * (width / kScale) +
                     column / kScale] = k == 0 ? 3 * weight - 2 : 4 * weight - 1;
    }
  }
  return base;
}

}  // namespace pleat::superres
