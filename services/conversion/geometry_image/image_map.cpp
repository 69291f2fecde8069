#include "services/conversion/geometry_image/image_map.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/pool.hpp"
#include "common/frame/rigid_alignment.hpp"
#include "services/conversion/geometry_image/chart_raster.hpp"
#include "services/conversion/geometry_image/seams.hpp"
#include "services/conversion/geometry_image/texel_fit.hpp"

namespace pleat::conversion {
namespace {

void check_spec(const ImageSpec& spec) {
  if (spec.scale < 1 || spec.scale > 16) {
    throw_invalid_argument("image spec: scale must be 1 to 16, not " + std::to_string(spec.scale));
  }
  if ((spec.coarse_width == 0) != (spec.coarse_height == 0)) {
    throw_invalid_argument("image spec: give coarse width and height, or neither");
  }
  if (spec.coarse_width < 0 || spec.coarse_height < 0) throw_invalid_argument("image spec: a size is negative");
  if (spec.coarse_width == 0 && !(spec.texels_per_fine_vertex > 0.1 && spec.texels_per_fine_vertex <= 1000)) {
    throw_invalid_argument("image spec: texels per fine vertex must be more than 0.1 and at most 1000");
  }
  if (spec.coarse_width != 0 && (spec.coarse_width * spec.scale < 2 || spec.coarse_height * spec.scale < 2)) {
    throw_invalid_argument("image spec: a fine image needs at least 2 x 2 texels");
  }
  if (spec.seam_reach < 0 || spec.seam_reach > kMostSeamReach) {
    throw_invalid_argument("image spec: seam reach must be 0 to " + std::to_string(kMostSeamReach) + ", not " +
                           std::to_string(spec.seam_reach));
  }
  if (!(spec.lambda > 0 && spec.lambda <= 1e6))
    throw_invalid_argument("image spec: lambda must be positive and at most 1e6");
}

struct Box {
  Eigen::Vector2d low, high;
};

// Around the coordinates that faces use.
Box material_box(const Topology& coarse, const Topology& fine) {
  constexpr double kFar = std::numeric_limits<double>::max();
  Box box{Eigen::Vector2d::Constant(kFar), Eigen::Vector2d::Constant(-kFar)};
  for (const Topology* t : {&coarse, &fine}) {
    for (Eigen::Index f = 0; f < t->face_count(); ++f) {
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector2d p = t->uv.row(t->uv_faces(f, k)).cast<double>();
        box.low = box.low.cwiseMin(p);
        box.high = box.high.cwiseMax(p);
      }
    }
  }
  return box;
}

double material_area(const Topology& t) {
  double area = 0;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const Eigen::Vector2d a = t.uv.row(t.uv_faces(f, 0)).cast<double>();
    const Eigen::Vector2d u = t.uv.row(t.uv_faces(f, 1)).cast<double>().transpose() - a;
    const Eigen::Vector2d v = t.uv.row(t.uv_faces(f, 2)).cast<double>().transpose() - a;
    area += 0.5 * std::abs(u.x() * v.y() - u.y() * v.x());
  }
  return area;
}

constexpr int kSizeStep = 4;  // of sizes that are chosen here: suits vector units

// Sizes are rounded up, which keeps the aspect.
ImageSpec resolve_size(ImageSpec spec, const Box& box, const Topology& fine, const Eigen::Vector2d& scale) {
  if (spec.coarse_width != 0) return spec;
  const double covered = material_area(fine) / (box.high - box.low).prod();
  const Eigen::Vector2d extent = (box.high - box.low).cwiseProduct(scale);
  const double texels = spec.texels_per_fine_vertex * static_cast<double>(fine.vertex_count()) /
                        std::clamp(covered, 0.01, 1.0) / (spec.scale * spec.scale);
  const double aspect = std::clamp(extent.x() / extent.y(), 1e-3, 1e3);
  const auto round_up = [](double x) {
    return kSizeStep * std::max(1, static_cast<int>(std::ceil(std::min(x, 1e6) / kSizeStep - 1e-6)));
  };
  spec.coarse_width = round_up(std::sqrt(texels * aspect));
  spec.coarse_height = round_up(std::sqrt(texels / aspect));
  return spec;
}

// Coarse texels that the image needs beside the bounding box.
struct Margins {
  int left = 0, right = 0, low = 0, high = 0;
};

// So that the places are inside. step: of coarse texels, in material coordinates.
Margins margins_of(const std::vector<Eigen::Vector2d>& places, const Box& box, const Eigen::Vector2d& step) {
  Eigen::Array2d before = Eigen::Array2d::Zero(), after = Eigen::Array2d::Zero();
  for (const Eigen::Vector2d& place : places) {
    before = before.max((box.low - place).cwiseQuotient(step).array());
    after = after.max((place - box.high).cwiseQuotient(step).array());
  }
  const auto whole = [](double texels) { return static_cast<int>(std::ceil(texels - 1e-6)); };
  Margins margins{whole(before.x()), whole(after.x()), whole(before.y()), whole(after.y())};
  const auto missing = [](int texels) { return (kSizeStep - texels % kSizeStep) % kSizeStep; };
  margins.right += missing(margins.left + margins.right);
  margins.high += missing(margins.low + margins.high);
  return margins;
}

std::vector<TexelTaps> make_taps(const Topology& t, const ChartRaster& raster) {
  std::vector<TexelTaps> taps(raster.sources.size());
  for (std::size_t i = 0; i < taps.size(); ++i) {
    const TexelSource& source = raster.sources[raster.padded_by[i]];
    for (int k = 0; k < 3; ++k) taps[i].vertex[static_cast<std::size_t>(k)] = t.faces(source.face, k);
    taps[i].weight = source.weight;
  }
  return taps;
}

std::vector<std::uint8_t> make_mask(const ChartRaster& raster) {
  std::vector<std::uint8_t> mask(raster.sources.size());
  std::transform(raster.sources.begin(), raster.sources.end(), mask.begin(),
                 [](const TexelSource& s) -> std::uint8_t { return s.face != kNone; });
  return mask;
}

// For each vertex the mean of the reads of its material coordinates.
VertexReads make_vertex_reads(const Topology& t, const ChartRaster& raster) {
  std::vector<std::vector<std::uint32_t>> coordinates(static_cast<std::size_t>(t.vertex_count()));
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      auto& list = coordinates[t.faces(f, k)];
      if (std::find(list.begin(), list.end(), t.uv_faces(f, k)) == list.end()) list.push_back(t.uv_faces(f, k));
    }
  }
  VertexReads rows;
  for (const auto& list : coordinates) {
    for (const std::uint32_t u : list) {
      for (std::size_t i = 0; i < 4; ++i) {
        if (raster.reads[u].weight[i] == 0) continue;
        rows.places.push_back(raster.reads[u].texel[i]);
        rows.weights.push_back(raster.reads[u].weight[i] / static_cast<float>(list.size()));
      }
    }
    rows.offsets.push_back(static_cast<std::uint32_t>(rows.places.size()));
  }
  return rows;
}

void check_frame(const Frame& frame, const Topology& t, const char* name) {
  const auto check = [&](const Positions& values, const char* what) {
    if (values.rows() != t.vertex_count()) {
      throw_invalid_argument("frame " + std::to_string(frame.index) + ": " + std::to_string(values.rows()) + " " +
                             name + " " + what + " for a mesh of " + std::to_string(t.vertex_count()) + " vertices");
    }
    if (!all_finite(values)) {
      throw_invalid_argument("frame " + std::to_string(frame.index) + ": " + name + " " + what + " are not finite");
    }
  };
  check(frame.positions, "positions");
  if (frame.velocities.rows() != 0) check(frame.velocities, "velocities");
}

// Memory of one conversion that is under way.
struct Scratch {
  FeatureScratch mesh;
  FrameFeatures features;
};

void shape_image(Tensor& image, int width, int height) {
  image.shape = {kFrameChannels, height, width};
  if (image.channels != frame_channel_names()) image.channels = frame_channel_names();
  image.values.resize(static_cast<std::size_t>(kFrameChannels) * static_cast<std::size_t>(width) *
                      static_cast<std::size_t>(height));
}

/// values: (V x k). planes: (k, texels).
template <typename Values>
void sample(const std::vector<TexelTaps>& taps, const Values& values, float* planes) {
  constexpr int kColumns = Values::ColsAtCompileTime;
  const std::size_t size = taps.size();
  for (std::size_t i = 0; i < size; ++i) {
    const TexelTaps& tap = taps[i];
    const Eigen::Matrix<float, 1, kColumns> value = tap.weight[0] * values.row(tap.vertex[0]) +
                                                    tap.weight[1] * values.row(tap.vertex[1]) +
                                                    tap.weight[2] * values.row(tap.vertex[2]);
    for (std::size_t c = 0; c < kColumns; ++c) planes[c * size + i] = value(static_cast<Eigen::Index>(c));
  }
}

}  // namespace

struct ImageMap::Maps {
  Topology coarse, fine;
  ImageSpec spec;
  TexelGrid coarse_grid, fine_grid;
  std::vector<std::uint8_t> coarse_mask, fine_mask;
  std::vector<std::uint32_t> coarse_charts, coarse_shown;
  std::vector<TexelTaps> coarse_taps, fine_taps;
  std::vector<SeamTexel> fine_beyond_seams;
  std::vector<std::uint8_t> coarse_beyond;
  Eigen::Vector2d coarse_step;
  VertexReads vertex_reads;
  ChartRaster fine_raster;
  mutable Pool<Scratch> scratch;
  mutable std::once_flag fit_once;
  mutable std::unique_ptr<TexelFit> fit_when_needed;

  const TexelFit& fit() const {
    std::call_once(fit_once,
                   [this] { fit_when_needed = std::make_unique<TexelFit>(fine, fine_grid, fine_raster, spec.lambda); });
    return *fit_when_needed;
  }

  /// values: (V_fine x k). planes: (k, H W).
  template <typename Values>
  void spread(const Values& values, float* planes) const;

  // Reads three channels of an image at the fine vertices, rotated back with R^T after adding `add` (V x 3).
  template <typename Add>
  void read(const Tensor& image, int first_channel, const RigidTransform& transform, const Add& add,
            Positions& values) const;
};

template <typename Values>
void ImageMap::Maps::spread(const Values& values, float* planes) const {
  if (spec.method == FineImageMethod::kSampled) {
    sample(fine_taps, values, planes);
    return;
  }
  const Eigen::MatrixXd solution = fit().solve(values.template cast<double>());
  const std::vector<std::uint32_t>& texels = fit().texels();
  const std::size_t size = fine_grid.size();
  for (Eigen::Index c = 0; c < values.cols(); ++c) {
    float* plane = planes + static_cast<std::size_t>(c) * size;
    for (std::size_t i = 0; i < texels.size(); ++i) {
      plane[texels[i]] = static_cast<float>(solution(static_cast<Eigen::Index>(i), c));
    }
    for (std::size_t i = 0; i < size; ++i) plane[i] = plane[fine_raster.padded_by[i]];
  }
}

template <typename Add>
void ImageMap::Maps::read(const Tensor& image, int first_channel, const RigidTransform& transform, const Add& add,
                          Positions& values) const {
  if (image.shape.size() != 3 || image.shape[0] < first_channel + 3 || image.shape[0] > kFrameChannels ||
      image.shape[1] != fine_grid.height || image.shape[2] != fine_grid.width ||
      image.values.size() != static_cast<std::size_t>(image.shape[0]) * fine_grid.size()) {
    throw_invalid_argument("fine image: expected (" + std::to_string(kFrameChannels) + ", " +
                           std::to_string(fine_grid.height) + ", " + std::to_string(fine_grid.width) + ")");
  }
  values.resize(fine.vertex_count(), 3);
  const float* x = image.values.data() + static_cast<std::size_t>(first_channel) * fine_grid.size();
  const float* y = x + fine_grid.size();
  const float* z = y + fine_grid.size();
  for (Eigen::Index v = 0; v < values.rows(); ++v) {
    const auto row = static_cast<std::size_t>(v);
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (std::uint32_t i = vertex_reads.offsets[row]; i < vertex_reads.offsets[row + 1]; ++i) {
      const std::uint32_t texel = vertex_reads.places[i];
      sum += vertex_reads.weights[i] * Eigen::Vector3f(x[texel], y[texel], z[texel]);
    }
    const Eigen::Vector3f aligned = sum + add(v);
    values.row(v) = transform.rotation.transpose() * aligned;
  }
  if (!all_finite(values)) throw_invalid_argument("fine image: values are not finite");
}

ImageMap::ImageMap(const Topology& coarse, const Topology& fine, const ImageSpec& spec)
    : maps_(std::make_unique<Maps>()) {
  check_spec(spec);
  validate_topology(coarse, "coarse mesh");
  validate_topology(fine, "fine mesh");
  check_charts(coarse, "coarse mesh");
  check_charts(fine, "fine mesh");
  Maps& m = *maps_;
  m.coarse = coarse;
  m.fine = fine;
  const Box box = material_box(coarse, fine);
  m.spec = resolve_size(spec, box, fine, recover_material_scale(fine));
  const Eigen::Vector2d metres = recover_material_scale(m.coarse);
  std::optional<SeamWalk> walk;
  if (spec.seam_reach > 0) walk.emplace(m.coarse, metres);
  const Eigen::Vector2d inner(m.spec.coarse_width * m.spec.scale, m.spec.coarse_height * m.spec.scale);
  const Eigen::Vector2d step = (box.high - box.low).cwiseQuotient(inner - Eigen::Vector2d::Ones());
  Margins margins;
  const Eigen::Vector2d coarse_step = m.spec.scale * step;
  if (walk) margins = margins_of(walk->beyond_ends(coarse_step, spec.seam_reach), box, coarse_step);
  const std::int64_t coarse_width = std::int64_t{m.spec.coarse_width} + margins.left + margins.right;
  const std::int64_t coarse_height = std::int64_t{m.spec.coarse_height} + margins.low + margins.high;
  const std::int64_t width = coarse_width * m.spec.scale, height = coarse_height * m.spec.scale;
  if (width > spec.max_fine_texels || height > spec.max_fine_texels || width * height > spec.max_fine_texels) {
    throw Error(ErrorCode::kResourceExhausted, "image spec: a fine image of " + std::to_string(width) + " x " +
                                                   std::to_string(height) + " texels is more than " +
                                                   std::to_string(spec.max_fine_texels));
  }
  TexelGrid& grid = m.fine_grid;
  grid = {static_cast<int>(width),
          static_cast<int>(height),
          box.low.x() - margins.left * m.spec.scale * step.x(),
          box.low.y() - margins.low * m.spec.scale * step.y(),
          step.x(),
          step.y()};
  const double middle = 0.5 * (m.spec.scale - 1);
  m.coarse_grid = {static_cast<int>(coarse_width), static_cast<int>(coarse_height), grid.u0 + middle * grid.du,
                   grid.v0 + middle * grid.dv,     m.spec.scale * grid.du,          m.spec.scale * grid.dv};

  m.fine_raster = rasterise_charts(m.fine, m.fine_grid, true, "fine mesh");
  ChartRaster coarse_raster = rasterise_charts(m.coarse, m.coarse_grid, false, "coarse mesh");
  m.coarse_step = coarse_step.cwiseProduct(metres);
  m.coarse_beyond.assign(coarse_raster.sources.size(), 0);
  if (walk) {
    for (const std::uint32_t texel : continue_over_seams(*walk, m.coarse_grid, spec.seam_reach, coarse_raster)) {
      m.coarse_beyond[texel] = 1;
    }
    ChartRaster corners = rasterise_charts(m.coarse, m.fine_grid, false, "coarse mesh");
    for (const std::uint32_t texel : continue_over_seams(*walk, m.fine_grid, spec.seam_reach * m.spec.scale, corners)) {
      if (m.fine_raster.sources[texel].face != kNone) continue;
      m.fine_beyond_seams.push_back({texel, corners.sources[texel].weight});
    }
  }
  m.coarse_mask = make_mask(coarse_raster);
  m.fine_mask = make_mask(m.fine_raster);
  m.coarse_taps = make_taps(m.coarse, coarse_raster);
  m.fine_taps = make_taps(m.fine, m.fine_raster);
  m.vertex_reads = make_vertex_reads(m.fine, m.fine_raster);
  m.coarse_charts = std::move(coarse_raster.chart);
  m.coarse_shown = std::move(coarse_raster.padded_by);
}

ImageMap::~ImageMap() = default;
ImageMap::ImageMap(ImageMap&&) noexcept = default;
ImageMap& ImageMap::operator=(ImageMap&&) noexcept = default;

const ImageSpec& ImageMap::spec() const { return maps_->spec; }
int ImageMap::coarse_width() const { return maps_->coarse_grid.width; }
int ImageMap::coarse_height() const { return maps_->coarse_grid.height; }
int ImageMap::fine_width() const { return maps_->fine_grid.width; }
int ImageMap::fine_height() const { return maps_->fine_grid.height; }
const std::vector<std::uint8_t>& ImageMap::coarse_mask() const { return maps_->coarse_mask; }
const std::vector<std::uint8_t>& ImageMap::fine_mask() const { return maps_->fine_mask; }

const std::vector<std::uint32_t>& ImageMap::coarse_charts() const { return maps_->coarse_charts; }
const std::vector<std::uint32_t>& ImageMap::coarse_shown() const { return maps_->coarse_shown; }

RigidTransform ImageMap::align(const Positions& coarse_positions) const {
  return kabsch(coarse_positions, maps_->coarse.rest_positions);
}

CoarseImage ImageMap::coarse_image(const Frame& coarse) const {
  check_frame(coarse, maps_->coarse, "coarse");
  CoarseImage result;
  result.transform = align(coarse.positions);
  coarse_image(coarse, result.transform, result.image);
  return result;
}

void ImageMap::coarse_image(const Frame& coarse, const RigidTransform& transform, Tensor& image) const {
  shape_image(image, coarse_width(), coarse_height());
  coarse_image(coarse, transform, image.values.data());
}

void ImageMap::coarse_image(const Frame& coarse, const RigidTransform& transform, float* planes) const {
  check_frame(coarse, maps_->coarse, "coarse");
  const Pool<Scratch>::Lent scratch(maps_->scratch);
  frame_features(coarse, maps_->coarse, transform, scratch->mesh, scratch->features);
  sample(maps_->coarse_taps, scratch->features, planes);
}

Tensor ImageMap::fine_image(const Frame& fine, const RigidTransform& transform) const {
  Tensor image;
  fine_image(fine, transform, image);
  return image;
}

void ImageMap::fine_image(const Frame& fine, const RigidTransform& transform, Tensor& image) const {
  check_frame(fine, maps_->fine, "fine");
  shape_image(image, fine_width(), fine_height());
  const Pool<Scratch>::Lent scratch(maps_->scratch);
  frame_features(fine, maps_->fine, transform, scratch->mesh, scratch->features);
  maps_->spread(scratch->features, image.values.data());
}

void ImageMap::fine_planes(const Positions& values, float* planes) const {
  if (values.rows() != maps_->fine.vertex_count() || !all_finite(values)) {
    throw_invalid_argument("values of " + std::to_string(values.rows()) +
                           " fine vertices: another mesh, or not finite");
  }
  maps_->spread(values, planes);
}

const std::vector<TexelTaps>& ImageMap::coarse_taps() const { return maps_->coarse_taps; }
const std::vector<TexelTaps>& ImageMap::fine_taps() const { return maps_->fine_taps; }

const std::vector<std::uint8_t>& ImageMap::coarse_beyond_seams() const { return maps_->coarse_beyond; }
const Eigen::Vector2d& ImageMap::coarse_step() const { return maps_->coarse_step; }

const std::vector<SeamTexel>& ImageMap::fine_beyond_seams() const { return maps_->fine_beyond_seams; }

Positions ImageMap::to_mesh(const Tensor& image, const RigidTransform& transform) const {
  Positions positions;
  to_mesh(image, transform, positions);
  return positions;
}

void ImageMap::to_mesh(const Tensor& image, const RigidTransform& transform, Positions& positions) const {
  const Positions& rest = maps_->fine.rest_positions;
  maps_->read(
      image, kDisplacementChannel, transform,
      [&](Eigen::Index v) -> Eigen::Vector3f { return rest.row(v).transpose() - transform.translation; }, positions);
}

const VertexReads& ImageMap::vertex_reads() const { return maps_->vertex_reads; }

}  // namespace pleat::conversion
