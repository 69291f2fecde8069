// Check-points of a training. Inside services/superres only: this header needs LibTorch.
#pragma once

#include <string>

#include "services/superres/networks/network.hpp"
#include "services/superres/training/adam.hpp"

namespace pleat::superres {

inline constexpr int kLossParts = 9;

/// Everything beside tensors that a training needs to go on exactly.
struct TrainState {
  int epoch = 0;       ///< in progress
  int step = 0;        ///< next step of that epoch
  double minutes = 0;  ///< wall clock of all runs so far
  /// Of total, displacement, normal, velocity, kinematic, vertices, vertex normals and edges over the epoch's steps.
  double sums[kLossParts] = {};
  double best_score = 0;  ///< VMSE, or MSE of the displacement image without a judge; 0: none yet
  int best_epoch = -1;
  std::string best_report;  ///< JSON: the epoch report of the best bundle
};

/// Writes to PATH.partial, flushes, renames: a kill at any moment leaves the old or the new check-point.
/// Throws kResourceExhausted naming the file.
void save_checkpoint(const std::string& path, const std::string& config_json, const Network& network, const Adam& adam,
                     const TrainState& state);

/// config_json: the configuration, and in "data" what tells the data apart.
/// Restores all. kDataLoss if the file can't be read or lacks something; kFailedPrecondition, naming the key, if it was
/// made with a configuration that computes something else.
void load_checkpoint(const std::string& path, const std::string& config_json, Network& network, Adam& adam,
                     TrainState& state);

/// Takes the averaged weights of a check-point only; the architecture has to be the same.
void load_initial(const std::string& path, Network& network);

}  // namespace pleat::superres
