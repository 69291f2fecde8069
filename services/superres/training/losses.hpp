// The training losses, [MFSR] eq. 2-6. Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/torch.h>

#include "services/superres/training/config.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// Bands of the loss on wrinkles: scales of up to four fine edges, where the coarse cloth does not tell.
inline constexpr std::size_t kWrinkleLossBands = 3;

/// One batch: B windows of F consecutive frames, flattened to N = B F images, window by window.
struct Batch {
  torch::Tensor input;                 ///< (N, T C + K, h, w) normalised, perhaps mirrored
  torch::Tensor answer;                ///< (N, C, H, W) normalised, never mirrored
  torch::Tensor mask;                  ///< (N, 1, H, W): 1 where a texel is valid
  torch::Tensor rotations;             ///< (N, 3, 3): rigid alignment of each frame, world to rest
  std::vector<std::uint64_t> mirrors;  ///< (N): how each input is mirrored
  /// For losses on vertices, else undefined: (N, 3, V) the fine mesh without the answer's part, and (N, 3 x 3, h, w)
  /// the axes of the answer's vectors, undefined if they are the alignment's.
  torch::Tensor vertex_base, axes;
  /// For networks that remember R frames, else undefined: (B, R, C, H, W) the answers to the frames before each window,
  /// the oldest first, and (B, R) 0 for those that do not exist.
  torch::Tensor before, known;
  /// For windows that go on from the network's own answers, else undefined: (B, L, T C + K, h, w) the inputs of the
  /// frames before each of them, the oldest first, and (B, L) 0 for those that do not exist. `before` is then what was
  /// before these.
  torch::Tensor lead, lead_known;
  int frames = 1;        ///< F
  std::size_t mesh = 0;  ///< of PairData::meshes, which all images are of

  void to(torch::Device device);
};

/// What the losses need to know of the data.
struct LossConstants {
  torch::Tensor offset, scale;     ///< (C): of the answer's ranges
  torch::Tensor deviation;         ///< (C): of what interpolation lacks, normalised; for LossConfig::scaling
  int normal = -1, velocity = -1;  ///< where the answer's normals and velocities begin; -1: it has none
  double frame_time_s = 0;
  torch::Tensor vertex_texels;   ///< (K V) int64
  torch::Tensor vertex_weights;  ///< (K, V)
  torch::Tensor faces, edges;    ///< (3, F) and (2, E) int64
  torch::Tensor edge_lengths;    ///< (E): of the rest mesh, metres
  double unit_m = 1;             ///< metres, of the answer's displacements
  torch::Tensor ring_average;    ///< (V, V) sparse: the mean of a vertex and its neighbours

  /// Sets what the losses on vertices need, which have nothing to read without it.
  void set_vertices(const MeshRead& read, const torch::Device& device);
};

/// Each is the mean over valid texels and channels (0 where the answer has no such channels), or over vertices or
/// edges, unweighted; total is their weighted sum (eq. 6).
struct Losses {
  torch::Tensor displacement, normal, velocity, kinematic, vertices, vertex_normals, edges, wrinkles, total;
};

/// synthesized: (N, C, H, W), the network's answer to batch.input, not mirrored: displacements in the first three
/// channels; what the next three and those after them are counts as normals and velocities.
/// Eq. 2-4 compare normalised values. Eq. 5 needs metres: values are denormalised, and the residual is divided by the
/// mean displacement range (with scaling "deviation" by the mean deviation in metres), so that its scale is that of
/// eq. 2. With backward velocities it reads, for k = 1..n,
///   R_k^-1 d_k - R_0^-1 d_0 - dt sum_{j=1..k} R_j^-1 v_j        (the simulated frames satisfy it)
/// for the errors d = d^s - d^h, v = v^s - v^h ("exact"), or with one shared rotation and the synthesized values
/// themselves ("shared", as published; it ignores that the alignment takes the rigid motion out of d but not out of v).
/// With target "ground_truth" d_k is the simulated one. No kinematic loss for F = 1, weight 0, or
/// an answer without velocities.
///
/// The losses on vertices (0 where their weight is) read both images as the conversion does: x = base + sum_k w_k d_k
/// in metres, in the frame of the alignment. Means over all images and V vertices or E edges, L_c the mean range of the
/// three displacement (c = d, in metres) or normal (c = n) channels, times their deviation with scaling "deviation":
///   vertices        mean |x^s - x^h|^2 / (3 L_d^2)                          (as eq. 2, but what VMSE measures)
///   vertex_normals  mean |n^s - n^h|^2 / (3 L_n^2)                          (area-weighted unit normals of the mesh)
///   edges           mean ((l^s - l^h) / (0.01 l^rest))^2                    (difference in percent of the rest length)
///   wrinkles        mean (log (E_b^s + e) / (E_b^h + e))^2                  (over images and kWrinkleLossBands bands)
/// with E_b the energy of the mesh's normals in a band (common/mesh/wrinkles.hpp) and e = 1e-4, below which a cloth is
/// flat: the amount of wrinkling is right wherever the folds are, of which the mean of all that might be has too
/// little.
Losses compute_losses(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                      const LossConfig& config);

}  // namespace pleat::superres
