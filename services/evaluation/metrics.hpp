// How far a sequence of enhanced frames is from the simulated one. docs/metrics.md has the definitions and sources.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/features/channel_ranges.hpp"
#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "common/mesh/wrinkles.hpp"

namespace pleat::conversion {
class ImageMap;
}  // namespace pleat::conversion

namespace pleat::evaluation {

/// Mean over vertices of the squared distance, m^2. a, b: (V x 3). Throws kInvalidArgument for different sizes or V =
/// 0.
double vertex_mean_square_error(const Positions& a, const Positions& b);

/// Parameters of STED as its authors recommend them.
struct StedOptions {
  double temporal_step = 0.002;   ///< length of a frame's step in units of the bounding box diagonal
  double temporal_weight = 0.13;  ///< c
};

struct StedValues {
  double spatial = 0;
  double temporal = 0;
  double combined = 0;  ///< sqrt(spatial^2 + c^2 temporal^2)
};

/// Spatio-temporal edge difference (Vasa and Skala 2011). Frames are added one by one; a sequence is one shot.
class StedAccumulator {
 public:
  /// Needs manifold faces of vertex_count vertices.
  StedAccumulator(Eigen::Index vertex_count, const Faces& faces, const StedOptions& options = {});

  /// The next frame belongs to another sequence: no temporal edge joins it to the last one.
  void begin_sequence();
  /// reference, candidate: (V x 3). O(E).
  void add(const Positions& reference, const Positions& candidate);
  /// Over everything added; 0 where nothing was.
  StedValues values() const;

 private:
  StedOptions options_;
  std::vector<std::array<std::uint32_t, 2>> edges_;
  std::vector<std::uint32_t> offsets_;       ///< (V+1) rows into vertex_edges_
  std::vector<std::uint32_t> vertex_edges_;  ///< edges at a vertex
  Positions last_reference_, last_candidate_;
  std::vector<double> last_length_, last_difference_;  ///< of the temporal edge that ended in the last frame
  double diagonal_ = 0;
  std::size_t sequence_frames_ = 0;
  double spatial_sum_ = 0, temporal_sum_ = 0;
  std::size_t spatial_count_ = 0, temporal_count_ = 0;
};

/// Second differences in time: shaking.
class JitterAccumulator {
 public:
  void begin_sequence();
  void add(const Positions& reference, const Positions& candidate);
  double value() const;  ///< root mean square of the error of second differences, m; 0 before the third frame
  double ratio() const;  ///< root mean square of the candidate's over the reference's; 1 where the latter is 0

 private:
  std::array<Positions, 2> references_, candidates_;  ///< the last two frames, the older one first
  std::size_t sequence_frames_ = 0;
  double error_sum_ = 0, reference_sum_ = 0, candidate_sum_ = 0;
  std::size_t count_ = 0;
};

/// Amounts of wrinkling, pooled over frames.
class WrinkleAccumulator {
 public:
  /// As WrinkleMeter.
  WrinkleAccumulator(Eigen::Index vertex_count, const Faces& faces, std::span<const std::uint32_t> feature_vertices)
      : meter_(vertex_count, faces, feature_vertices) {}

  void add(const Positions& reference, const Positions& candidate);
  /// Per band the candidate's energy over the reference's, both summed over the frames: below 1 the cloth is smoother
  /// at that scale than it should be, above 1 rougher. 1 where both are 0, infinite where only the reference's is.
  std::array<double, kWrinkleBands> ratios() const;
  /// Means over the frames; 1 before the first.
  double lattice() const { return frames_ > 0 ? candidate_lattice_ / static_cast<double>(frames_) : 1; }
  double reference_lattice() const { return frames_ > 0 ? reference_lattice_ / static_cast<double>(frames_) : 1; }

 private:
  WrinkleMeter meter_;
  std::array<double, kWrinkleBands> reference_{}, candidate_{};
  double reference_lattice_ = 0, candidate_lattice_ = 0;
  std::size_t frames_ = 0;
};

/// Mean over the vertices of the angle between area-weighted vertex normals, degrees.
double mean_normal_angle(const Faces& faces, const Positions& reference, const Positions& candidate);

/// Errors of edge lengths relative to the rest lengths.
class StretchError {
 public:
  /// Needs manifold faces. An edge without rest length does not count.
  StretchError(const Faces& faces, const Positions& rest);
  /// Root mean square over the edges of (candidate's length - reference's length) / rest length.
  double operator()(const Positions& reference, const Positions& candidate) const;

 private:
  std::vector<std::array<std::uint32_t, 2>> edges_;
  std::vector<double> rest_lengths_;
};

/// Mean square error of the displacement images of a frame pair, after normalisation to [0, 1], over valid texels and
/// the three channels. Both frames take the alignment of the coarse frame.
class DisplacementImageError {
 public:
  /// range: of the nine features; the displacements' scales count. coarse_width, coarse_height: texels; 0: the default
  /// size. Throws kInvalidArgument (unusable meshes, empty range).
  DisplacementImageError(const Topology& coarse, const Topology& fine, const ChannelRanges& range, int coarse_width = 0,
                         int coarse_height = 0);
  ~DisplacementImageError();

  double mean_square_error(const Positions& coarse, const Positions& reference, const Positions& candidate);

 private:
  std::unique_ptr<conversion::ImageMap> map_;
  ChannelRanges range_;
  Tensor reference_, candidate_;
};

/// What the judge found in one frame, before refinement and in the final mesh. A method that refines nothing has the
/// same counts twice.
struct FrameCounts {
  std::uint64_t penetrations_before = 0, penetrations = 0;
  std::uint64_t self_intersections_before = 0, self_intersections = 0;
};

/// The figures of one method over all sequences.
struct MetricValues {
  std::size_t frames = 0;
  std::optional<double> psnr_db;  ///< absent without a normalisation, or where nothing differs
  double vmse_m2 = 0;
  double rmse_m = 0;            ///< sqrt(vmse_m2)
  double rmse_relative = 0;     ///< over the bounding box diagonal of the fine rest mesh
  double normal_angle_deg = 0;  ///< mean over frames
  double stretch = 0;           ///< root mean square over edges and frames
  double hausdorff_m = 0;       ///< mean over frames
  StedValues sted;
  double jitter_m = 0;
  double jitter_ratio = 1;
  std::array<double, kWrinkleBands> wrinkles{};  ///< energy per band over the reference's
  double lattice = 1, reference_lattice = 1;
  FrameCounts counts;  ///< sums over frames
};

/// Collects all metrics of one method.
class MetricsAccumulator {
 public:
  /// feature_vertices: indices of the coarse vertices in the fine mesh. range: without it there is no PSNR.
  MetricsAccumulator(const Topology& coarse, const Topology& fine, std::span<const std::uint32_t> feature_vertices,
                     const std::optional<ChannelRanges>& range, int coarse_width = 0, int coarse_height = 0);
  ~MetricsAccumulator();

  void begin_sequence();
  /// coarse: (V_coarse x 3); reference, candidate: (V_fine x 3), metres. Throws kInvalidArgument for other sizes.
  void add(const Positions& coarse, const Positions& reference, const Positions& candidate,
           const FrameCounts& counts = {});
  MetricValues values() const;

 private:
  Faces faces_;
  Eigen::Index fine_vertices_;
  std::unique_ptr<DisplacementImageError> image_error_;
  StedAccumulator sted_;
  JitterAccumulator jitter_;
  WrinkleAccumulator wrinkles_;
  StretchError stretch_;
  double diagonal_;
  std::size_t frames_ = 0;
  double image_mse_sum_ = 0, vmse_sum_ = 0, hausdorff_sum_ = 0, angle_sum_ = 0, stretch_square_sum_ = 0;
  FrameCounts counts_;
};

}  // namespace pleat::evaluation
