#include "common/mesh/wrinkles.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "common/base/error.hpp"

namespace pleat {

WrinkleMeter::WrinkleMeter(Eigen::Index vertex_count, const Faces& faces,
                           std::span<const std::uint32_t> feature_vertices)
    : faces_(faces), is_feature_(static_cast<std::size_t>(vertex_count), false) {
  const auto count = static_cast<std::size_t>(vertex_count);
  for (const std::uint32_t v : feature_vertices) {
    if (v >= count)
      throw_invalid_argument("feature vertex " + std::to_string(v) + " of a mesh of " + std::to_string(count));
    is_feature_[v] = true;
  }
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
  pairs.reserve(6 * static_cast<std::size_t>(faces.rows()));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int i = 0; i < 3; ++i) {
      if (faces(f, i) >= count)
        throw_invalid_argument("face " + std::to_string(f) + " has vertex " + std::to_string(faces(f, i)) +
                               " of a mesh of " + std::to_string(count));
      pairs.emplace_back(faces(f, i), faces(f, (i + 1) % 3));
      pairs.emplace_back(faces(f, (i + 1) % 3), faces(f, i));
    }
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  offsets_.assign(count + 1, 0);
  neighbours_.reserve(pairs.size());
  for (const auto& [from, to] : pairs) {
    ++offsets_[from + 1];
    neighbours_.push_back(to);
  }
  for (std::size_t v = 0; v < count; ++v) offsets_[v + 1] += offsets_[v];
}

/// Each vertex with its one-ring, all weighing the same.
void WrinkleMeter::average(const Positions& from, Positions& to) const {
  to.resize(from.rows(), 3);
  for (Eigen::Index v = 0; v < from.rows(); ++v) {
    const auto row = static_cast<std::size_t>(v);
    Eigen::RowVector3f sum = from.row(v);
    for (std::uint32_t k = offsets_[row]; k < offsets_[row + 1]; ++k) sum += from.row(neighbours_[k]);
    to.row(v) = sum / static_cast<float>(offsets_[row + 1] - offsets_[row] + 1);
  }
}

WrinkleFigures WrinkleMeter::measure(const Positions& positions) const {
  if (positions.rows() + 1 != static_cast<Eigen::Index>(offsets_.size()))
    throw_invalid_argument("wrinkles were set up for " + std::to_string(offsets_.size() - 1) +
                           " vertices, the frame has " + std::to_string(positions.rows()));
  WrinkleFigures figures;
  if (positions.rows() == 0) return figures;
  Positions start = vertex_normals(positions, faces_), smooth = start, next;
  for (std::size_t band = 0; band < kWrinkleBands; ++band) {
    for (int round = kBandRounds[band]; round < kBandRounds[band + 1]; ++round) {
      average(smooth, next);
      smooth.swap(next);
    }
    figures.bands[band] = (start - smooth).cast<double>().squaredNorm() / static_cast<double>(positions.rows());
    if (band == 0) {
      double at_feature = 0, elsewhere = 0;
      std::size_t features = 0;
      for (Eigen::Index v = 0; v < start.rows(); ++v) {
        const bool feature = is_feature_[static_cast<std::size_t>(v)];
        (feature ? at_feature : elsewhere) += static_cast<double>((start.row(v) - smooth.row(v)).norm());
        features += feature ? 1 : 0;
      }
      const std::size_t others = is_feature_.size() - features;
      if (features > 0 && others > 0 && elsewhere > 0)
        figures.lattice = at_feature / static_cast<double>(features) / (elsewhere / static_cast<double>(others));
    }
    start = smooth;
  }
  return figures;
}

}  // namespace pleat
