// What `pleat eval` measures, for other commands too.
#pragma once

#include <string>
#include <vector>

#include "common/rpc/channel.hpp"
#include "services/evaluation/evaluation.hpp"

namespace pleat::cli {

struct EvalOptions {
  std::string dataset, logs, coordinator;
  std::vector<std::string> models;   ///< files in one folder, or names; may be empty
  std::vector<std::string> details;  ///< "network", "fold", "both"; empty: the network where there are models
  evaluation::EvaluationOptions evaluation;
  bool baselines = false, skip_refinement = false;
  double timeout_s = 30;
  rpc::TlsOptions tls;
};

/// Barycentric upsampling, then what the options ask for, with services of its own unless a coordinator is named, and
/// with progress. From the main thread. Throws what launcher, client and evaluation throw, kInvalidArgument for options
/// that contradict each other.
std::vector<evaluation::GarmentFigures> evaluate(const EvalOptions& options);

}  // namespace pleat::cli
