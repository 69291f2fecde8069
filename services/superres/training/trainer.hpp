// Training of a model bundle. Free of LibTorch.
#pragma once

#include <atomic>
#include <functional>
#include <string>

#include "services/superres/training/config.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// One row of log.csv.
struct EpochReport {
  int epoch = 0;           ///< from 1
  std::int64_t steps = 0;  ///< optimiser steps so far
  double minutes = 0;      ///< wall clock so far
  double learning_rate = 0;
  double total = 0, displacement = 0, normal = 0, velocity = 0, kinematic = 0;  ///< means over the epoch
  double vertices = 0, vertex_normals = 0, edges = 0, wrinkles = 0;             ///< the same
  bool validated = false;
  double psnr_db = 0;                               ///< of the normalised displacement image over valid texels, peak 1
  double psnr_normal_db = 0, psnr_velocity_db = 0;  ///< the same of the other features
  double vmse_m2 = 0;                               ///< mean squared vertex distance; 0 without a judge
  double gain_db = 0;  ///< of several meshes: how far the VMSE of a validation sequence is below upsampling's, the mean
  bool best = false;
};

/// What nothing learned would score on the same validation frames.
struct BaselineReport {
  double plain_psnr_db = 0;  ///< an answer of zeros where the answer is detail, else bilinear upsampling of the image
  double barycentric_psnr_db = 0, barycentric_vmse_m2 = 0;  ///< barycentric upsampling of the mesh
};

struct TrainHooks {
  std::function<void(const std::string&)> line;                           ///< one line of text about something done
  std::function<void(int epoch, double fraction, double loss)> progress;  ///< after each step; fraction of the epoch
  const std::atomic<bool>* stop = nullptr;                                ///< becomes true: end after this step
  std::string git_revision;                                               ///< for the bundle
  /// Data-parallel training: this process, their number, and the file in which they meet. Only the first one writes.
  int rank = 0, processes = 1;
  std::string rendezvous;
};

enum class StopReason { kEpochs, kMinutes, kStopped };

struct TrainResult {
  StopReason reason = StopReason::kEpochs;
  EpochReport last, best;
  BaselineReport baseline;
  std::string bundle;  ///< path of the best bundle; empty if no epoch was validated
};

/// Trains, or goes on from OUTPUT/checkpoint.pt if that exists: with the same configuration, data and machine the curve
/// is bit for bit the one of an uninterrupted training (except with schedule.progress "minutes"). Writes OUTPUT/NAME.pt
/// (best validated weights), OUTPUT/log.csv, OUTPUT/log.html and OUTPUT/checkpoint.pt. The best is that of the smallest
/// VMSE; of several meshes in their coarse edges, so that each counts alike. judge may be null: then the best is chosen
/// by PSNR. Several processes share the windows of every step and sum their gradients; the curve is that of one process
/// but for rounding. If the device runs out of memory, passes take half as many windows from then on. Throws as
/// Sampler, Communicator and load_checkpoint; kInternal, naming epoch, step and windows, if a loss is not finite;
/// kResourceExhausted if a file can't be written, or one window needs too much memory. The check-point before it stays.
TrainResult train(const TrainConfig& config, const PairData& data, MeshJudge* judge, const TrainHooks& hooks);

}  // namespace pleat::superres
