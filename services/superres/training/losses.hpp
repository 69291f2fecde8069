// The training losses, [MFSR] eq. 2-6. Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/torch.h>

#include "services/superres/training/config.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// One batch: B windows of F consecutive frames, flattened to N = B F images, window by window.
struct Batch {
  torch::Tensor coarse;           ///< (N, 9, h, w) normalised
  torch::Tensor fine;             ///< (N, 9, 4h, 4w) normalised
  torch::Tensor mask;             ///< (N, 1, 4h, 4w): 1 where a texel is valid
  torch::Tensor base, structure;  ///< residual "mesh": (N, 9, 4h, 4w) and (N, 32, h, w), else undefined
  torch::Tensor rotations;        ///< (N, 3, 3): rigid alignment of each frame, world to rest
  /// For losses on vertices, else undefined: (N, K V) int64, the texels that are read in each, perhaps mirrored, image,
  /// and (N, 3, V) the rest positions, mirrored as its vectors are.
  torch::Tensor vertex_texels, vertex_rest;
  int frames = 1;  ///< F
};

/// What the losses need to know of the data.
struct LossConstants {
  torch::Tensor minimum;    ///< (9): of the normalisation
  torch::Tensor range;      ///< (9): its maximum - minimum
  torch::Tensor deviation;  ///< (9): of fine minus upsampled coarse, normalised; for LossConfig::scaling
  double frame_time_s = 0;
  torch::Tensor vertex_weights;  ///< (K, V)
  torch::Tensor faces, edges;    ///< (3, F) and (2, E) int64
  torch::Tensor edge_lengths;    ///< (E): of the rest mesh, metres

  /// Sets what the losses on vertices need, which have nothing to read without it.
  void set_vertices(const MeshRead& read, const torch::Device& device);
};

/// Each is the mean over valid texels and channels, or over vertices or edges, unweighted; total is their weighted sum
/// (eq. 6).
struct Losses {
  torch::Tensor displacement, normal, velocity, kinematic, vertices, vertex_normals, edges, total;
};

/// synthesized: (N, 9, 4h, 4w), the network's answer to batch.coarse.
/// Eq. 2-4 compare normalised values. Eq. 5 needs metres: values are denormalised, and the residual is divided by the
/// mean displacement range (with scaling "deviation" by the mean deviation in metres), so that its scale is that of
/// eq. 2. With backward velocities it reads, for k = 1..n,
///   R_k^-1 d_k - R_0^-1 d_0 - dt sum_{j=1..k} R_j^-1 v_j        (the simulated frames satisfy it)
/// for the errors d = d^s - d^h, v = v^s - v^h ("exact"), or with one shared rotation and the synthesized values
/// themselves ("shared", as published; it ignores that the alignment takes the rigid motion out of d but not out of v).
/// With target "ground_truth" d_k is the simulated one. No kinematic loss for F = 1 or weight 0.
///
/// The losses on vertices (0 where their weight is) read both images as the conversion does: x = rest + sum_k w_k d_k
/// in metres, in the frame of the alignment. Means over all images and V vertices or E edges, L_c the mean range of the
/// three displacement (c = d) or normal (c = n) channels, times their deviation with scaling "deviation":
///   vertices        mean |x^s - x^h|^2 / (3 L_d^2)                          (as eq. 2, but what VMSE measures)
///   vertex_normals  mean |n^s - n^h|^2 / (3 L_n^2)                          (area-weighted unit normals of the mesh)
///   edges           mean ((l^s - l^h) / (0.01 l^rest))^2                    (difference in percent of the rest length)
Losses compute_losses(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                      const LossConfig& config);

}  // namespace pleat::superres
