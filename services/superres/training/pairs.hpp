// Pairs of what a network reads and what it should answer, in memory: what training reads.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/features/channel_ranges.hpp"
#include "services/conversion/representation.hpp"
#include "services/superres/training/config.hpp"

namespace pleat::superres {

/// Values as 16-bit fixed point over [low, low + span); those beyond are cut off.
struct FixedPoint {
  float low = 0, span = 0;  ///< span 0: float32 instead
  bool used() const { return span > 0; }
  bool holds(float value) const { return !used() || (value >= low && value < low + span); }
  bool operator==(const FixedPoint&) const = default;
};

/// Of values that are mostly in [0, 1]: a step of 3e-5, an RMS error of 9e-6 (100 dB), where half precision would have
/// 2e-4 near 1.
inline constexpr FixedPoint kUnitRange{-0.5F, 2};
/// Of values that are mostly in [-1, 1]: a step of 6e-5.
inline constexpr FixedPoint kAroundZero{-2, 4};
/// Of values whose deviation is 1: a step of 1e-3.
inline constexpr FixedPoint kUnitDeviation{-32, 64};

/// Images (C, h, w) of equal shape. Either it owns them, or it reads them where somebody else keeps them.
class ImageStore {
 public:
  ImageStore() = default;
  ImageStore(int channels, int height, int width, FixedPoint fixed)
      : channels_(channels), height_(height), width_(width), fixed_point_(fixed) {}

  /// `count` images that lie at `images`.
  ImageStore(int channels, int height, int width, FixedPoint fixed, std::size_t count,
             std::shared_ptr<const char> images)
      : ImageStore(channels, height, width, fixed) {
    count_ = count, mapped_ = std::move(images);
  }

  /// Only if it owns its images.
  void append(std::span<const float> image);
  /// Copies the window of `height` x `width` texels from (row, column) of every channel to target (C, height, width).
  void read(std::size_t index, int row, int column, int height, int width, float* target) const;
  std::size_t size() const { return count_; }
  int channels() const { return channels_; }
  int height() const { return height_; }
  int width() const { return width_; }
  /// Of one image.
  std::size_t image_bytes() const { return image_values() * (fixed_point_.used() ? 2 : 4); }
  const void* data() const;

 private:
  std::size_t image_values() const {
    return static_cast<std::size_t>(channels_) * static_cast<std::size_t>(height_) * static_cast<std::size_t>(width_);
  }
  int channels_ = 0, height_ = 0, width_ = 0;
  FixedPoint fixed_point_;
  std::size_t count_ = 0;
  std::vector<std::uint16_t> fixed_;
  std::vector<float> float_;
  std::shared_ptr<const char> mapped_;
};

/// The fine mesh as a function of an answer: what the conversion reads to make a mesh of it.
struct MeshRead {
  std::vector<std::int64_t> texels;  ///< (K x V): row-major places in the answer; weight 0 where a vertex has fewer
  std::vector<float> weights;        ///< (K x V): the vertex's displacement is the weighted sum of those texels
  std::vector<float> rest;           ///< (3 x V): rest positions, metres
  std::vector<std::int64_t> faces;   ///< (3 x F)
  std::vector<std::int64_t> edges;   ///< (2 x E): those with a length in the rest mesh
  float unit_m = 1;                  ///< metres, of the answer's displacements: the weights hold it

  std::int64_t vertex_count() const { return static_cast<std::int64_t>(rest.size() / 3); }
};

/// A rotation's matrix, row-major.
using RotationRows = std::array<float, 3 * 3>;

/// What belongs to one coarse mesh and its fine one.
struct PairMesh {
  std::string topology_hash;              ///< of the coarse mesh
  std::vector<float> rest_positions;      ///< (V x 3) of the coarse mesh
  std::vector<std::uint8_t> answer_mask;  ///< (H W): 1 where a texel holds a value of its own
  Tensor constants;                       ///< (K, h, w), or without a shape
  MeshRead mesh_read;                     ///< for losses on vertices, else empty
  /// Directions of u and v in the rest mesh if that is flat, else empty. For mirrored copies of vectors in the
  /// alignment's axes.
  std::vector<std::array<float, 3>> sheet_axes;
};

/// One sequence of consecutive frames.
struct PairSequence {
  std::string name;
  bool validation = false;
  std::size_t mesh = 0;                 ///< of PairData::meshes
  ImageStore input, answer;             ///< normalised, one image a frame; inputs are kept exactly
  std::vector<RotationRows> rotations;  ///< of the rigid alignment (world to rest), per frame
};

/// What losses on vertices need of a frame, for representations in which it is not the same for all.
class FrameGeometry {
 public:
  virtual ~FrameGeometry() = default;
  /// The axes of the answer's vectors at each place of the input (3 x 3, h, w).
  virtual void axes(std::size_t sequence, std::size_t frame, Tensor& axes) const = 0;
  /// The fine mesh that an answer of zeros means, in the alignment's axes (V x 3).
  virtual void base(std::size_t sequence, std::size_t frame, Positions& positions) const = 0;
};

/// Data set as images: of one size for each mesh.
struct PairData {
  std::vector<PairSequence> sequences;
  std::vector<PairMesh> meshes = std::vector<PairMesh>(1);
  conversion::RepresentationSpec representation;             ///< with the sizes of the first mesh
  ChannelRanges input_ranges, output_ranges;                 ///< of one frame, and of an answer
  std::vector<std::string> input_channels, answer_channels;  ///< the same: names
  std::shared_ptr<const MeshPorts> mesh;  ///< for networks that convolve on meshes; null: the places are no mesh's
  double frame_time_s = 0;
  std::string description = "{}";           ///< JSON about the data set, for the bundle
  std::shared_ptr<FrameGeometry> geometry;  ///< for losses on vertices; null: the alignment's axes, and rest positions

  const PairMesh& mesh_of(const PairSequence& sequence) const { return meshes[sequence.mesh]; }
  /// Of the first sequence's inputs.
  int height() const { return sequences.front().input.height(); }
  int width() const { return sequences.front().input.width(); }
  int scale() const { return sequences.front().answer.height() / height(); }
  int constant_channels() const {
    const Tensor& constants = meshes.front().constants;
    return constants.shape.empty() ? 0 : static_cast<int>(constants.shape[0]);
  }
  /// An answer of zeros is the upsampled coarse mesh.
  bool detail() const;
  /// Its vectors are in the cloth's own axes.
  bool has_axes() const;
  std::size_t training_frames() const;
  /// Throws kInvalidArgument unless there are training sequences, sizes agree, and every sequence has at least one
  /// frame.
  void check() const;
};

/// Judges answers as meshes.
class MeshJudge {
 public:
  virtual ~MeshJudge() = default;
  /// Mean over the fine vertices of the squared distance to the simulated fine mesh, m^2. answer: normalised.
  virtual double squared_error(std::size_t sequence, std::size_t frame, std::span<const float> answer) = 0;
  /// The same for barycentric upsampling of the coarse mesh.
  virtual double barycentric_squared_error(std::size_t sequence, std::size_t frame) = 0;
  /// The normalised answer that means the barycentrically upsampled coarse mesh.
  virtual std::vector<float> barycentric_answer(std::size_t sequence, std::size_t frame) = 0;
};

struct LoadedPairs {
  PairData data;
  std::unique_ptr<MeshJudge> judge;
};

/// Reads a data set (docs/file-formats.md), converts every frame and normalises it. `report` gets lines about the
/// progress; `stopped` is asked often, and true ends it with kCancelled. Any number of rounds, and either rule.
/// Throws kNotFound, kDataLoss, kInvalidArgument (several meshes for a bundle that serves one, unknown names, a mesh
/// that the representation can't hold), kResourceExhausted if the images would need more than config.cache_limit_mb.
LoadedPairs load_pairs(
    const TrainConfig& config, const std::function<void(const std::string&)>& report,
    const std::function<bool()>& stopped = [] { return false; });

/// What a network is put between.
Ports ports_of(const PairData& data);

}  // namespace pleat::superres
