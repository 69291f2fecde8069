#include "services/conversion/geometry_image/detail_image.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <span>
#include <string>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/simd.hpp"
#include "common/mesh/connectivity.hpp"

namespace pleat::conversion {
namespace {

constexpr double kGravity = 9.81;  ///< m/s^2, of the natural velocity
constexpr float kSmallestWeight = 1e-4F;
constexpr std::size_t kLargestSide = 4;  ///< places in a coarse texel, along one side, that the constants tell of

/// A sum of coarse vertices, gathered entry by entry.
class Combination {
 public:
  void add(std::uint32_t vertex, float weight) {
    if (weight == 0) return;
    for (auto& [v, w] : entries_) {
      if (v != vertex) continue;
      w += weight;
      return;
    }
    entries_.emplace_back(vertex, weight);
  }
  void add(const VertexReads& rows, std::size_t row, float weight) {
    for (std::uint32_t i = rows.offsets[row]; i < rows.offsets[row + 1]; ++i) {
      add(rows.places[i], weight * rows.weights[i]);
    }
  }
  void move_to(VertexReads& rows) {
    for (const auto& [vertex, weight] : entries_) {
      rows.places.push_back(vertex);
      rows.weights.push_back(weight);
    }
    rows.offsets.push_back(static_cast<std::uint32_t>(rows.places.size()));
    entries_.clear();
  }

 private:
  std::vector<std::pair<std::uint32_t, float>> entries_;
};

/// Each fine vertex as a combination of coarse ones.
VertexReads vertex_corners(const Subdivision& s, const Faces& coarse_faces) {
  VertexReads rows;
  Combination combination;
  for (std::size_t v = 0; v < s.parent_face.size(); ++v) {
    if (v < s.feature_vertices.size()) {
      combination.add(static_cast<std::uint32_t>(v), 1);
    } else {
      for (Eigen::Index k = 0; k < 3; ++k) {
        combination.add(coarse_faces(s.parent_face[v], k), s.barycentric(static_cast<Eigen::Index>(v), k));
      }
    }
    combination.move_to(rows);
  }
  return rows;
}

/// Each fine texel of a sampled image as a combination of coarse vertices.
VertexReads texel_corners(const std::vector<TexelTaps>& taps, const VertexReads& vertices) {
  VertexReads rows;
  Combination combination;
  for (const TexelTaps& tap : taps) {
    for (std::size_t k = 0; k < 3; ++k) combination.add(vertices, tap.vertex[k], tap.weight[k]);
    combination.move_to(rows);
  }
  return rows;
}

/// What the fine vertices read of such an image; those that read nothing stay what they are.
VertexReads read_corners(const VertexReads& reads, const VertexReads& texels, const VertexReads& vertices) {
  VertexReads rows;
  Combination combination;
  for (std::size_t v = 0; v + 1 < reads.offsets.size(); ++v) {
    for (std::uint32_t i = reads.offsets[v]; i < reads.offsets[v + 1]; ++i) {
      combination.add(texels, reads.places[i], reads.weights[i]);
    }
    if (reads.offsets[v] == reads.offsets[v + 1]) combination.add(vertices, v, 1);
    combination.move_to(rows);
  }
  return rows;
}

/// Positions in vectors of four, aligned where an alignment is given.
void pad(const Positions& positions, const RigidTransform* alignment, std::vector<float>& padded) {
  padded.resize(4 * static_cast<std::size_t>(positions.rows()));
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    Eigen::Vector3f x = positions.row(v);
    if (alignment != nullptr) x = alignment->rotation * x + alignment->translation;
    store_to(padded.data() + 4 * v, Float4{x.x(), x.y(), x.z(), 0});
  }
}

/// The weighted sum of a row's places in (n, 4).
Float4 read(const VertexReads& rows, std::size_t row, const float* values) {
  Float4 sum{};
  for (std::uint32_t i = rows.offsets[row]; i < rows.offsets[row + 1]; ++i) {
    sum += rows.weights[i] * load_as<Float4>(values + 4 * std::size_t{rows.places[i]});
  }
  return sum;
}

/// Values at the coarse texels: (3, h, w).
std::vector<float> sampled(const std::vector<TexelTaps>& taps, const Positions& values) {
  std::vector<float> planes(3 * taps.size());
  for (std::size_t i = 0; i < taps.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t c = 0; c < 3; ++c) {
        planes[c * taps.size() + i] += taps[i].weight[k] * values(taps[i].vertex[k], static_cast<Eigen::Index>(c));
      }
    }
  }
  return planes;
}

}  // namespace

DetailUnit detail_unit(const Topology& coarse, DetailUnits units) {
  float length = 1, velocity = 1;
  if (units == DetailUnits::kCoarseEdges) {
    const double edge = mean_edge_length(coarse);
    if (!(edge > 0)) throw_invalid_argument("geometry image: the edges of the coarse mesh have no length");
    length = static_cast<float>(edge);
    velocity = static_cast<float>(std::sqrt(kGravity * edge));
  }
  DetailUnit unit{std::vector<float>(kClothChannels, 1.0F), std::vector<float>(3, length)};
  std::fill(unit.inputs.begin() + kCurvatureChannel, unit.inputs.begin() + kClothNormalChannel, length);
  std::fill(unit.inputs.begin() + kClothVelocityChannel, unit.inputs.end(), velocity);
  return unit;
}

DetailImage::DetailImage(const Topology& coarse, Subdivision subdivision, const RepresentationSpec& spec)
    : GeometryImage(coarse, std::move(subdivision), spec),
      enlarged_(map_.coarse_height(), map_.coarse_width(), map_.spec().scale) {
  if (subdivision_.parent_face.empty()) {
    throw_invalid_argument(
        "geometry image: a layout of detail needs a fine mesh that is a subdivision of the coarse one");
  }
  unit_ = detail_unit(coarse_, image_spec().units);
  reads_ = map_.vertex_reads();
  for (float& weight : reads_.weights) weight *= unit_.answers[0];
  rest_ = sampled(map_.coarse_taps(), coarse_.rest_positions);
  TexelCharts charts{map_.coarse_charts(), map_.coarse_shown(), {}, {}};
  if (image_spec().image.seam_reach > 0) {
    charts.beyond_seams = map_.coarse_beyond_seams();
    charts.step = {static_cast<float>(map_.coarse_step().x()), static_cast<float>(map_.coarse_step().y())};
  }
  cloth_axes_ = std::make_unique<ClothAxes>(rest_, map_.coarse_height(), map_.coarse_width(), charts);
  fine_corners_ = vertex_corners(subdivision_, coarse_.faces);
  const VertexReads texels = texel_corners(map_.fine_taps(), fine_corners_);
  make_constants(texels);
  if (image_spec().base == DetailBase::kTexels)
    fine_corners_ = read_corners(map_.vertex_reads(), texels, fine_corners_);
}

std::vector<std::string> DetailImage::answer_channels() const {
  return {"detail_along", "detail_across", "detail_normal"};
}

void DetailImage::make_constants(const VertexReads& texel_corners) {
  const auto scale = static_cast<std::size_t>(map_.spec().scale), side = std::min(scale, kLargestSide);
  const std::size_t block = side * side, texels = coarse_texels();
  const auto w = static_cast<std::size_t>(map_.coarse_width()), fine_width = w * scale;
  constants_.shape = {static_cast<std::int64_t>(2 * block), map_.coarse_height(), map_.coarse_width()};
  for (const char* rank : {"largest_corner_", "second_corner_"}) {
    for (std::size_t i = 0; i < block; ++i) constants_.channels.push_back(rank + std::to_string(i));
  }
  constants_.values.resize(2 * block * texels);
  std::vector<const SeamTexel*> beyond(fine_texels(), nullptr);
  for (const SeamTexel& texel : map_.fine_beyond_seams()) beyond[texel.texel] = &texel;
  std::vector<float> weights;
  for (std::size_t i = 0; i < block; ++i) {
    // The fine texel in the middle of its part of the coarse one.
    const std::size_t row = (2 * (i / side) + 1) * scale / (2 * side),
                      column = (2 * (i % side) + 1) * scale / (2 * side);
    for (std::size_t texel = 0; texel < texels; ++texel) {
      const std::size_t fine = (texel / w * scale + row) * fine_width + texel % w * scale + column;
      if (beyond[fine] != nullptr) {
        weights.assign(beyond[fine]->weight.begin(), beyond[fine]->weight.end());
      } else {
        weights.assign(texel_corners.weights.begin() + texel_corners.offsets[fine],
                       texel_corners.weights.begin() + texel_corners.offsets[fine + 1]);
      }
      std::erase_if(weights, [](float weight) { return weight <= kSmallestWeight; });
      std::sort(weights.begin(), weights.end(), std::greater<>());
      weights.resize(3, 0.0F);
      const float sum = weights[0] + weights[1] + weights[2];
      // The largest is between 1/3 and 1, the second between 0 and 1/2.
      constants_.values[i * texels + texel] = sum > 0 ? 3 * weights[0] / sum - 2 : -2.0F;
      constants_.values[(block + i) * texels + texel] = sum > 0 ? 4 * weights[1] / sum - 1 : -1.0F;
    }
  }
}

void DetailImage::check_coarse(const Positions& coarse) const {
  if (coarse.rows() == coarse_.vertex_count()) return;
  throw_invalid_argument(std::to_string(coarse.rows()) + " coarse positions for a mesh of " +
                         std::to_string(coarse_.vertex_count()) + " vertices");
}

void DetailImage::encode_frame(const Frame& frame, const RigidTransform& alignment, float* planes) const {
  const Pool<Scratch>::Lent scratch(scratch_);
  scratch->image.resize(kFrameChannels * coarse_texels());
  map_.coarse_image(frame, alignment, scratch->image.data());
  cloth_axes_->compute(scratch->image.data(), scratch->positions, planes, nullptr);
  const std::size_t texels = coarse_texels();
  for (std::size_t c = 0; c < unit_.inputs.size(); ++c) {
    const float unit = unit_.inputs[c];
    if (unit == 1) continue;
    for (float& value : std::span(planes + c * texels, texels)) value /= unit;
  }
}

void DetailImage::axes_of(const Positions& coarse, const RigidTransform& alignment, Scratch& scratch,
                          float* axes) const {
  const std::vector<TexelTaps>& taps = map_.coarse_taps();
  const std::size_t texels = taps.size();
  // Displacements are all that the axes need.
  pad(coarse, &alignment, scratch.coarse);
  scratch.image.resize(kFrameChannels * texels);
  float* planes = scratch.image.data();
  for (std::size_t i = 0; i < texels; ++i) {
    const TexelTaps& tap = taps[i];
    const Float4 sum = tap.weight[0] * load_as<Float4>(scratch.coarse.data() + 4 * tap.vertex[0]) +
                       tap.weight[1] * load_as<Float4>(scratch.coarse.data() + 4 * tap.vertex[1]) +
                       tap.weight[2] * load_as<Float4>(scratch.coarse.data() + 4 * tap.vertex[2]);
    for (std::size_t c = 0; c < 3; ++c) planes[c * texels + i] = sum[static_cast<int>(c)] - rest_[c * texels + i];
  }
  cloth_axes_->compute(planes, scratch.positions, nullptr, axes);
}

void DetailImage::base_positions(const Positions& coarse, Scratch& scratch, Positions& fine) const {
  pad(coarse, nullptr, scratch.coarse);
  fine.resize(subdivision_.fine.vertex_count(), 3);
  for (Eigen::Index v = 0; v < fine.rows(); ++v) {
    const Float4 sum = read(fine_corners_, static_cast<std::size_t>(v), scratch.coarse.data());
    fine.row(v) << sum[0], sum[1], sum[2];
  }
}

void DetailImage::target(const Frame& coarse, const Frame& fine, const RigidTransform& alignment,
                         Tensor& answer) const {
  check_coarse(coarse.positions);
  if (fine.positions.rows() != subdivision_.fine.vertex_count()) {
    throw_invalid_argument(std::to_string(fine.positions.rows()) + " fine positions for a mesh of " +
                           std::to_string(subdivision_.fine.vertex_count()) + " vertices");
  }
  const Pool<Scratch>::Lent scratch(scratch_);
  Positions missing;
  base_positions(coarse.positions, *scratch, missing);
  missing = ((fine.positions - missing) * (alignment.rotation.transpose() / unit_.answers[0])).eval();
  shape_answer(answer);
  map_.fine_planes(missing, answer.values.data());
  scratch->axes.resize(9 * coarse_texels());
  axes_of(coarse.positions, alignment, *scratch, scratch->axes.data());
  enlarged_.turn_back(scratch->axes.data(), answer.values.data());
}

void DetailImage::decode(const Tensor& answer, const Positions& coarse, const RigidTransform& alignment,
                         Positions& fine) const {
  check_answer(answer, 3);
  check_coarse(coarse);
  const Pool<Scratch>::Lent scratch(scratch_);
  scratch->axes.resize(9 * coarse_texels());
  axes_of(coarse, alignment, *scratch, scratch->axes.data());
  scratch->turned.resize(4 * fine_texels());
  enlarged_.turn(scratch->axes.data(), answer.values.data(), scratch->row, scratch->turned.data());
  pad(coarse, nullptr, scratch->coarse);
  const Eigen::Matrix3f& r = alignment.rotation;
  // Rows of R are columns of its inverse.
  const Float4 back[3] = {to_float4(r.row(0).transpose()), to_float4(r.row(1).transpose()),
                          to_float4(r.row(2).transpose())};
  fine.resize(subdivision_.fine.vertex_count(), 3);
  for (Eigen::Index v = 0; v < fine.rows(); ++v) {
    const auto row = static_cast<std::size_t>(v);
    const Float4 detail = read(reads_, row, scratch->turned.data());
    const Float4 x = read(fine_corners_, row, scratch->coarse.data()) + detail[0] * back[0] + detail[1] * back[1] +
                     detail[2] * back[2];
    fine.row(v) << x[0], x[1], x[2];
  }
  if (!all_finite(fine)) throw_invalid_argument("answer: values are not finite");
}

void DetailImage::answer_axes(const Positions& coarse, const RigidTransform& alignment, Tensor& axes) const {
  check_coarse(coarse);
  axes.shape = {9, map_.coarse_height(), map_.coarse_width()};
  axes.channels.clear();
  axes.values.resize(9 * coarse_texels());
  const Pool<Scratch>::Lent scratch(scratch_);
  axes_of(coarse, alignment, *scratch, axes.values.data());
}

void DetailImage::base(const Positions& coarse, const RigidTransform& alignment, Positions& fine) const {
  check_coarse(coarse);
  const Pool<Scratch>::Lent scratch(scratch_);
  base_positions(coarse, *scratch, fine);
  fine = ((fine * alignment.rotation.transpose()).rowwise() + alignment.translation.transpose()).eval();
}

}  // namespace pleat::conversion
