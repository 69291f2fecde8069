// What a training begins with: the weights of a check-point, or of a model bundle.
// Inside services/superres only: this header needs LibTorch.
#pragma once

#include <string>
#include <vector>

#include "services/superres/networks/network.hpp"
#include "services/superres/training/config.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// The changes ("KEY=VALUE") that make any configuration one that begins with this bundle: its weights, architecture,
/// representation and what it serves. Throws kInvalidArgument for a bundle that is no network of ours on geometry
/// images, kNotFound; else as read_metadata.
std::vector<std::string> changes_to_begin_with(const std::string& bundle);

/// If config.initial is a bundle in units that mean the same of every mesh ('images.units' = 'coarse_edges'): puts the
/// ranges that its weights were trained with into `data`, and returns true. Other units belong to a mesh, so the ranges
/// have to be measured there.
/// data: representation, channels and constants are known. Throws kInvalidArgument, naming what differs, for a bundle
/// of another architecture or representation (sizes of images and rounds of splitting may differ); kNotFound and
/// kDataLoss for files that can't be read. Does nothing for check-points.
bool take_initial_ranges(const TrainConfig& config, PairData& data);

/// Takes the weights of config.initial: of a bundle, or the averaged ones of a check-point. Throws as
/// take_initial_ranges and load_initial.
void take_initial_weights(const TrainConfig& config, const PairData& data, Network& network);

}  // namespace pleat::superres
