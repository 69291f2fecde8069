// Pairs of coarse and fine images in memory: what training reads.
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

#include "services/superres/mesh_base.hpp"
#include "services/superres/metadata.hpp"
#include "services/superres/training/config.hpp"

namespace pleat::superres {

/// Images (9, h, w) of equal size, kept as float32 or as 16-bit fixed point over [-0.5, 1.5): a step of 3e-5, an RMS
/// error of 9e-6 (100 dB), where half precision would have 2e-4 near 1. Values beyond are clamped. Either it owns them,
/// or it reads them where somebody else keeps them.
class ImageStore {
 public:
  ImageStore() = default;
  ImageStore(int height, int width, bool fixed_point) : height_(height), width_(width), fixed_point_(fixed_point) {}

  /// `count` images that lie at `images`.
  ImageStore(int height, int width, bool fixed_point, std::size_t count, std::shared_ptr<const char> images)
      : height_(height), width_(width), fixed_point_(fixed_point), count_(count), mapped_(std::move(images)) {}

  /// Only if it owns its images.
  void append(std::span<const float> image);
  /// Copies the window of `height` x `width` texels from (row, column) of every channel to target (9, height, width).
  void read(std::size_t index, int row, int column, int height, int width, float* target) const;
  std::size_t size() const { return count_; }
  int height() const { return height_; }
  int width() const { return width_; }
  std::size_t bytes() const { return count_ * image_values() * (fixed_point_ ? 2 : 4); }
  const void* data() const;
  void reserve(std::size_t images);

 private:
  int height_ = 0, width_ = 0;
  bool fixed_point_ = false;
  std::size_t count_ = 0;
  std::size_t image_values() const {
    return kChannels * static_cast<std::size_t>(height_) * static_cast<std::size_t>(width_);
  }
  std::vector<std::uint16_t> fixed_;
  std::vector<float> float_;
  std::shared_ptr<const char> mapped_;
};

/// The fine mesh as a function of the fine image: what the conversion reads to make a mesh of it.
struct MeshRead {
  std::vector<std::int64_t> texels;  ///< (K x V): row-major places in the image; weight 0 where a vertex has fewer
  std::vector<float> weights;        ///< (K x V): the vertex's displacement is the weighted sum of those texels
  std::vector<float> rest;           ///< (3 x V): rest positions, metres
  std::vector<std::int64_t> faces;   ///< (3 x F)
  std::vector<std::int64_t> edges;   ///< (2 x E): those with a length in the rest mesh

  std::int64_t vertex_count() const { return static_cast<std::int64_t>(rest.size() / 3); }
};

/// One sequence of consecutive frames.
struct PairSequence {
  std::string name;
  bool validation = false;
  ImageStore coarse, fine;                      ///< normalised, one image a frame; coarse ones are kept exactly
  std::vector<std::array<float, 9>> rotations;  ///< of the rigid alignment (world to rest), row-major, per frame
};

/// Data set as images.
struct PairData {
  std::vector<PairSequence> sequences;
  std::vector<std::uint8_t> fine_mask;  ///< (H W): 1 where a texel holds a value of its own
  Normalization normalization;
  double frame_time_s = 0;
  std::string topology_hash;  ///< of the coarse mesh
  std::string image_spec = "{}";
  std::string description = "{}";  ///< JSON about the data set, for the bundle
  MeshBase mesh_base;              ///< for networks that need the mesh, else empty
  MeshRead mesh_read;              ///< for losses on vertices, else empty
  /// Directions of u and v in the rest mesh if that is flat, else empty. Needed for mirrored copies.
  std::vector<std::array<float, 3>> sheet_axes;

  int coarse_height() const { return sequences.front().coarse.height(); }
  int coarse_width() const { return sequences.front().coarse.width(); }
  std::size_t training_frames() const;
  /// Throws kInvalidArgument unless there are training sequences, sizes agree (fine = 4 x coarse), and every sequence
  /// has at least one frame.
  void check() const;
};

/// Judges fine images as meshes.
class MeshJudge {
 public:
  virtual ~MeshJudge() = default;
  /// Mean over the fine vertices of the squared distance to the simulated fine mesh, m^2.
  /// fine_image: (9, H, W) normalised.
  virtual double squared_error(std::size_t sequence, std::size_t frame, std::span<const float> fine_image) = 0;
  /// The same for barycentric upsampling of the coarse mesh.
  virtual double barycentric_squared_error(std::size_t sequence, std::size_t frame) = 0;
  /// The normalised fine image (9, H, W) of the barycentrically upsampled coarse mesh.
  virtual std::vector<float> barycentric_image(std::size_t sequence, std::size_t frame) = 0;
};

struct LoadedPairs {
  PairData data;
  std::unique_ptr<MeshJudge> judge;
};

/// Reads a data set (docs/file-formats.md), converts every frame and normalises it. `report` gets lines about the
/// progress. Throws kNotFound, kDataLoss, kInvalidArgument (no normalisation, sequences of other meshes, unknown
/// names), kResourceExhausted if the images would need more than config.cache_limit_mb, kCancelled soon after `*stop`
/// became true; whole sequences that were converted stay for the next training.
LoadedPairs load_pairs(const TrainConfig& config, const std::function<void(const std::string&)>& report,
                       const std::atomic<bool>* stop = nullptr);

}  // namespace pleat::superres
