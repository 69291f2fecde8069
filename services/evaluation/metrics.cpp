#include "services/evaluation/metrics.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <string>

#include "common/base/error.hpp"
#include "common/base/statistics.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "services/evaluation/surface_distance.hpp"

namespace pleat::evaluation {
namespace {

void check_pair(const Positions& reference, const Positions& candidate) {
  if (reference.rows() != candidate.rows() || reference.rows() == 0)
    throw_invalid_argument("metrics need two frames of the same size, got " + std::to_string(reference.rows()) +
                           " and " + std::to_string(candidate.rows()) + " vertices");
}

constexpr double kDegrees = 57.29577951308232;

/// 1 for a single point.
double bounding_box_diagonal(const Positions& positions) {
  const double diagonal = (positions.colwise().maxCoeff() - positions.colwise().minCoeff()).cast<double>().norm();
  return diagonal > 0 ? diagonal : 1;
}

double distance(const Positions& positions, std::uint32_t a, std::uint32_t b) {
  return (positions.row(a).cast<double>() - positions.row(b).cast<double>()).norm();
}

/// Standard deviation of values with weights that sum to weight_sum > 0.
struct WeightedDeviation {
  double weight = 0, first = 0, second = 0;
  void add(double w, double value) {
    weight += w;
    first += w * value;
    second += w * value * value;
  }
  double value() const {
    if (weight <= 0) return 0;
    const double mean = first / weight;
    return std::sqrt(std::max(0.0, second / weight - mean * mean));
  }
};

}  // namespace

double vertex_mean_square_error(const Positions& a, const Positions& b) {
  check_pair(a, b);
  return (a.cast<double>() - b.cast<double>()).squaredNorm() / static_cast<double>(a.rows());
}

StedAccumulator::StedAccumulator(Eigen::Index vertex_count, const Faces& faces, const StedOptions& options)
    : options_(options) {
  const Connectivity connectivity = build_connectivity(vertex_count, faces);
  const auto count = static_cast<std::size_t>(vertex_count);
  offsets_.assign(count + 1, 0);
  for (const Edge& edge : connectivity.edges) {
    edges_.push_back({edge.v0, edge.v1});
    ++offsets_[edge.v0 + 1];
    ++offsets_[edge.v1 + 1];
  }
  for (std::size_t v = 0; v < count; ++v) offsets_[v + 1] += offsets_[v];
  vertex_edges_.resize(2 * edges_.size());
  std::vector<std::uint32_t> next(offsets_.begin(), offsets_.end() - 1);
  for (std::uint32_t e = 0; e < edges_.size(); ++e)
    for (const std::uint32_t v : edges_[e]) vertex_edges_[next[v]++] = e;
}

void StedAccumulator::begin_sequence() { sequence_frames_ = 0; }

void StedAccumulator::add(const Positions& reference, const Positions& candidate) {
  check_pair(reference, candidate);
  const std::size_t vertices = offsets_.size() - 1;
  if (static_cast<std::size_t>(reference.rows()) != vertices)
    throw_invalid_argument("STED was set up for " + std::to_string(vertices) + " vertices, the frame has " +
                           std::to_string(reference.rows()));
  std::vector<double> length(edges_.size()), difference(edges_.size());
  for (std::size_t e = 0; e < edges_.size(); ++e) {
    length[e] = distance(reference, edges_[e][0], edges_[e][1]);
    const double other = distance(candidate, edges_[e][0], edges_[e][1]);
    // An edge without length has no relative difference, and weight 0.
    difference[e] = length[e] > 0 ? std::abs(length[e] - other) / length[e] : 0;
  }
  for (std::size_t v = 0; v < vertices; ++v) {
    WeightedDeviation deviation;
    for (std::uint32_t k = offsets_[v]; k < offsets_[v + 1]; ++k)
      deviation.add(length[vertex_edges_[k]], difference[vertex_edges_[k]]);
    spatial_sum_ += deviation.value();
    ++spatial_count_;
  }

  if (sequence_frames_ == 0) {
    diagonal_ = bounding_box_diagonal(reference);
  } else {
    std::vector<double> step_length(vertices), step_difference(vertices);
    for (std::size_t v = 0; v < vertices; ++v) {
      const auto row = static_cast<Eigen::Index>(v);
      const double moved = (reference.row(row) - last_reference_.row(row)).cast<double>().norm() / diagonal_;
      const double other = (candidate.row(row) - last_candidate_.row(row)).cast<double>().norm() / diagonal_;
      step_length[v] = std::hypot(moved, options_.temporal_step);
      step_difference[v] = std::abs(step_length[v] - std::hypot(other, options_.temporal_step)) / step_length[v];
    }
    if (sequence_frames_ >= 2) {
      for (std::size_t v = 0; v < vertices; ++v) {
        WeightedDeviation deviation;
        deviation.add(last_length_[v], last_difference_[v]);
        deviation.add(step_length[v], step_difference[v]);
        temporal_sum_ += deviation.value();
        ++temporal_count_;
      }
    }
    last_length_ = std::move(step_length);
    last_difference_ = std::move(step_difference);
  }
  last_reference_ = reference;
  last_candidate_ = candidate;
  ++sequence_frames_;
}

StedValues StedAccumulator::values() const {
  StedValues values;
  if (spatial_count_ > 0) values.spatial = spatial_sum_ / static_cast<double>(spatial_count_);
  if (temporal_count_ > 0) values.temporal = temporal_sum_ / static_cast<double>(temporal_count_);
  values.combined = std::hypot(values.spatial, options_.temporal_weight * values.temporal);
  return values;
}

void JitterAccumulator::begin_sequence() { sequence_frames_ = 0; }

void JitterAccumulator::add(const Positions& reference, const Positions& candidate) {
  check_pair(reference, candidate);
  if (sequence_frames_ >= 2) {
    const auto second_difference = [](const Positions& now, const std::array<Positions, 2>& last) -> Eigen::MatrixX3d {
      return now.cast<double>() - 2.0 * last[1].cast<double>() + last[0].cast<double>();
    };
    const Eigen::MatrixX3d r = second_difference(reference, references_);
    const Eigen::MatrixX3d c = second_difference(candidate, candidates_);
    error_sum_ += (c - r).squaredNorm();
    reference_sum_ += r.squaredNorm();
    candidate_sum_ += c.squaredNorm();
    count_ += static_cast<std::size_t>(reference.rows());
  }
  references_[0] = std::move(references_[1]);
  references_[1] = reference;
  candidates_[0] = std::move(candidates_[1]);
  candidates_[1] = candidate;
  ++sequence_frames_;
}

double JitterAccumulator::value() const { return count_ > 0 ? std::sqrt(error_sum_ / static_cast<double>(count_)) : 0; }

double JitterAccumulator::ratio() const { return reference_sum_ > 0 ? std::sqrt(candidate_sum_ / reference_sum_) : 1; }

void WrinkleAccumulator::add(const Positions& reference, const Positions& candidate) {
  check_pair(reference, candidate);
  const WrinkleFigures r = meter_.measure(reference), c = meter_.measure(candidate);
  for (std::size_t b = 0; b < kWrinkleBands; ++b) {
    reference_[b] += r.bands[b];
    candidate_[b] += c.bands[b];
  }
  reference_lattice_ += r.lattice;
  candidate_lattice_ += c.lattice;
  ++frames_;
}

std::array<double, kWrinkleBands> WrinkleAccumulator::ratios() const {
  std::array<double, kWrinkleBands> ratios{};
  for (std::size_t b = 0; b < kWrinkleBands; ++b) {
    if (reference_[b] > 0)
      ratios[b] = candidate_[b] / reference_[b];
    else
      ratios[b] = candidate_[b] > 0 ? std::numeric_limits<double>::infinity() : 1;
  }
  return ratios;
}

double mean_normal_angle(const Faces& faces, const Positions& reference, const Positions& candidate) {
  check_pair(reference, candidate);
  const Positions a = vertex_normals(reference, faces), b = vertex_normals(candidate, faces);
  double sum = 0;
  for (Eigen::Index v = 0; v < a.rows(); ++v) {
    const Eigen::Vector3d n = a.row(v).cast<double>(), m = b.row(v).cast<double>();
    // The arc cosine would lose half the digits of a small angle.
    sum += std::atan2(n.cross(m).norm(), n.dot(m));
  }
  return sum / static_cast<double>(a.rows()) * kDegrees;
}

StretchError::StretchError(const Faces& faces, const Positions& rest) {
  for (const Edge& edge : build_connectivity(rest.rows(), faces).edges) {
    const double length = distance(rest, edge.v0, edge.v1);
    if (length <= 0) continue;
    edges_.push_back({edge.v0, edge.v1});
    rest_lengths_.push_back(length);
  }
}

double StretchError::operator()(const Positions& reference, const Positions& candidate) const {
  check_pair(reference, candidate);
  if (edges_.empty()) return 0;
  double sum = 0;
  for (std::size_t e = 0; e < edges_.size(); ++e) {
    const auto [a, b] = edges_[e];
    const double error = (distance(candidate, a, b) - distance(reference, a, b)) / rest_lengths_[e];
    sum += error * error;
  }
  return std::sqrt(sum / static_cast<double>(edges_.size()));
}

DisplacementImageError::DisplacementImageError(const Topology& coarse, const Topology& fine, const ChannelRanges& range,
                                               int coarse_width, int coarse_height)
    : range_(range) {
  check_ranges(range, kFrameChannels, "the range of the features");
  for (std::size_t c = 0; c < 3; ++c) {
    if (range.empty() || !(range.scale[c] > 0)) {
      throw_invalid_argument("the range of displacement channel " + std::to_string(c) + " is empty");
    }
  }
  conversion::ImageSpec spec;
  spec.coarse_width = coarse_width;
  spec.coarse_height = coarse_height;
  // Sampling is the published definition, and adds no regularisation of ours to what is measured.
  spec.method = conversion::FineImageMethod::kSampled;
  map_ = std::make_unique<conversion::ImageMap>(coarse, fine, spec);
}

DisplacementImageError::~DisplacementImageError() = default;

double DisplacementImageError::mean_square_error(const Positions& coarse, const Positions& reference,
                                                 const Positions& candidate) {
  check_pair(reference, candidate);
  const RigidTransform transform = map_->align(coarse);
  Frame frame;
  frame.positions = reference;
  map_->fine_image(frame, transform, reference_);
  frame.positions = candidate;
  map_->fine_image(frame, transform, candidate_);
  const std::vector<std::uint8_t>& mask = map_->fine_mask();
  double sum = 0;
  std::size_t valid = 0;
  for (const std::uint8_t m : mask) valid += m != 0 ? 1 : 0;
  for (std::size_t c = 0; c < 3; ++c) {
    const auto range = static_cast<double>(range_.scale[c]);
    double channel = 0;
    const std::size_t offset = (static_cast<std::size_t>(kDisplacementChannel) + c) * mask.size();
    for (std::size_t t = 0; t < mask.size(); ++t) {
      if (mask[t] == 0) continue;
      const double d =
          static_cast<double>(candidate_.values[offset + t]) - static_cast<double>(reference_.values[offset + t]);
      channel += d * d;
    }
    sum += channel / (range * range);
  }
  return sum / (3.0 * static_cast<double>(valid));
}

MetricsAccumulator::MetricsAccumulator(const Topology& coarse, const Topology& fine,
                                       std::span<const std::uint32_t> feature_vertices,
                                       const std::optional<ChannelRanges>& range, int coarse_width, int coarse_height)
    : faces_(fine.faces),
      fine_vertices_(fine.vertex_count()),
      sted_(fine.vertex_count(), fine.faces),
      wrinkles_(fine.vertex_count(), fine.faces, feature_vertices),
      stretch_(fine.faces, fine.rest_positions),
      diagonal_(bounding_box_diagonal(fine.rest_positions)) {
  if (range) image_error_ = std::make_unique<DisplacementImageError>(coarse, fine, *range, coarse_width, coarse_height);
}

MetricsAccumulator::~MetricsAccumulator() = default;

void MetricsAccumulator::begin_sequence() {
  sted_.begin_sequence();
  jitter_.begin_sequence();
}

void MetricsAccumulator::add(const Positions& coarse, const Positions& reference, const Positions& candidate,
                             const FrameCounts& counts) {
  check_pair(reference, candidate);
  if (reference.rows() != fine_vertices_)
    throw_invalid_argument("metrics were set up for " + std::to_string(fine_vertices_) +
                           " fine vertices, the frame has " + std::to_string(reference.rows()));
  if (image_error_) image_mse_sum_ += image_error_->mean_square_error(coarse, reference, candidate);
  vmse_sum_ += vertex_mean_square_error(reference, candidate);
  hausdorff_sum_ += hausdorff_distance(faces_, reference, candidate);
  sted_.add(reference, candidate);
  jitter_.add(reference, candidate);
  wrinkles_.add(reference, candidate);
  angle_sum_ += mean_normal_angle(faces_, reference, candidate);
  stretch_square_sum_ += std::pow(stretch_(reference, candidate), 2);
  counts_.penetrations_before += counts.penetrations_before;
  counts_.penetrations += counts.penetrations;
  counts_.self_intersections_before += counts.self_intersections_before;
  counts_.self_intersections += counts.self_intersections;
  ++frames_;
}

MetricValues MetricsAccumulator::values() const {
  MetricValues values;
  values.frames = frames_;
  if (frames_ == 0) return values;
  const auto n = static_cast<double>(frames_);
  if (image_error_ && image_mse_sum_ > 0) values.psnr_db = pleat::psnr_db(image_mse_sum_ / n);
  values.vmse_m2 = vmse_sum_ / n;
  values.rmse_m = std::sqrt(values.vmse_m2);
  values.hausdorff_m = hausdorff_sum_ / n;
  values.sted = sted_.values();
  values.jitter_m = jitter_.value();
  values.jitter_ratio = jitter_.ratio();
  values.wrinkles = wrinkles_.ratios();
  values.lattice = wrinkles_.lattice();
  values.reference_lattice = wrinkles_.reference_lattice();
  values.rmse_relative = values.rmse_m / diagonal_;
  values.normal_angle_deg = angle_sum_ / n;
  values.stretch = std::sqrt(stretch_square_sum_ / n);
  values.counts = counts_;
  return values;
}

}  // namespace pleat::evaluation
