// What a whole job costs: frames a second, and the memory of every service.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "pleat/v1/coordinator.pb.h"

namespace pleat::evaluation {

struct JobCostOptions {
  std::filesystem::path models;             ///< empty: default_models_folder()
  std::filesystem::path out = "out/bench";  ///< logs and the files of the job
  std::string model;                        ///< the bundle; empty: the default
  v1::Detail detail = v1::DETAIL_NETWORK;
  std::size_t frames = 40;
};

struct JobCost {
  double frames_per_s = 0;  ///< between the third frame and the last: what is made once a session is left out
  std::size_t runs = 0;     ///< frames that this is the mean of
  std::size_t fine_vertices = 0;
  /// Of each service by its name, MiB: the most that was resident at once, libraries included.
  std::vector<std::pair<std::string, double>> peak_mib;
};

/// A job of the scene, coarse simulation and result file included, by services of its own on this host. Throws what
/// ended the job, kCancelled if interrupted().
JobCost job_cost(const v1::Scene& scene, const JobCostOptions& options);

}  // namespace pleat::evaluation
