// How far a sequence of enhanced frames is from the simulated one. docs/metrics.md has the definitions and sources.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat {

class ImageMap;

/// Mean over vertices of the squared distance, m^2. a, b: (V x 3). Throws kInvalidArgument for different sizes or V =
/// 0.
double vertex_mean_square_error(const Positions& a, const Positions& b);

/// 10 log10(peak^2 / mse), dB; infinite for mse 0.
double psnr_db(double mse, double peak = 1);

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

/// Root mean square error of second differences in time, metres: shaking that the reference does not have.
class JitterAccumulator {
 public:
  void begin_sequence();
  void add(const Positions& reference, const Positions& candidate);
  double value() const;  ///< 0 before the third frame of a sequence

 private:
  std::array<Positions, 2> errors_;  ///< candidate - reference of the last two frames, the older one first
  std::size_t sequence_frames_ = 0;
  double sum_ = 0;
  std::size_t count_ = 0;
};

/// Range of the displacement channels, for the PSNR.
struct DisplacementRange {
  std::array<float, 3> minimum{};
  std::array<float, 3> maximum{};
};

/// Mean square error of the displacement images of a frame pair, after normalisation to [0, 1], over valid texels and
/// the three channels. Both frames take the alignment of the coarse frame.
class DisplacementImageError {
 public:
  /// coarse_width, coarse_height: texels; 0: the default size. Throws kInvalidArgument (unusable meshes, empty range).
  DisplacementImageError(const Topology& coarse, const Topology& fine, const DisplacementRange& range,
                         int coarse_width = 0, int coarse_height = 0);
  ~DisplacementImageError();

  double mean_square_error(const Positions& coarse, const Positions& reference, const Positions& candidate);

 private:
  std::unique_ptr<ImageMap> map_;
  DisplacementRange range_;
  Tensor reference_, candidate_;
};

/// The figures of one method over all sequences.
struct MetricValues {
  std::size_t frames = 0;
  std::optional<double> psnr_db;  ///< absent without a normalisation, or where nothing differs
  double vmse_m2 = 0;
  double rmse_m = 0;       ///< sqrt(vmse_m2)
  double hausdorff_m = 0;  ///< mean over frames
  StedValues sted;
  double jitter_m = 0;
  std::uint64_t penetrations = 0;        ///< sum over frames
  std::uint64_t self_intersections = 0;  ///< sum over frames
};

/// Collects all metrics of one method.
class MetricsAccumulator {
 public:
  /// range: without it there is no PSNR.
  MetricsAccumulator(const Topology& coarse, const Topology& fine, const std::optional<DisplacementRange>& range,
                     int coarse_width = 0, int coarse_height = 0);
  ~MetricsAccumulator();

  void begin_sequence();
  /// coarse: (V_coarse x 3); reference, candidate: (V_fine x 3), metres. The counts are those of the candidate.
  /// Throws kInvalidArgument for other sizes.
  void add(const Positions& coarse, const Positions& reference, const Positions& candidate,
           std::uint64_t penetrations = 0, std::uint64_t self_intersections = 0);
  MetricValues values() const;

 private:
  Faces faces_;
  Eigen::Index fine_vertices_;
  std::unique_ptr<DisplacementImageError> image_error_;
  StedAccumulator sted_;
  JitterAccumulator jitter_;
  std::size_t frames_ = 0;
  double image_mse_sum_ = 0, vmse_sum_ = 0, hausdorff_sum_ = 0;
  std::uint64_t penetrations_ = 0, self_intersections_ = 0;
};

}  // namespace pleat
