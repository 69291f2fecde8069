// What a coordinator can be told.
#pragma once

#include <cstddef>
#include <string>

#include "common/base/runtime_folder.hpp"
#include "common/config/options.hpp"
#include "common/rpc/channel.hpp"
#include "services/coordinator/job_runner.hpp"
#include "services/coordinator/live_session.hpp"

namespace pleat::coordinator {

struct CoordinatorOptions {
  /// Comma-separated addresses: the replicas of each service.
  std::string simulation = default_address("simulation");
  std::string conversion = default_address("conversion");
  std::string superres = default_address("superres");
  std::string fold = default_address("fold");
  std::string refinement = default_address("refinement");
  std::string data = "pleat-data";    ///< folder of the jobs
  rpc::TlsOptions service_tls;        ///< towards the services
  std::string token_file;             ///< who may call without a certificate (rpc::Callers); empty: whoever gets here
  double give_up_s = 30;              ///< a service that is away this long fails its sessions
  double answer_timeout_s = 60;       ///< longest wait for one frame, or for a session to open
  std::size_t max_watchers = 256;     ///< calls of WatchJob at the same time
  std::size_t max_watchers_each = 0;  ///< of one caller; 0: as many as all together
  std::size_t max_uploads = 4;        ///< calls of CreateJobInParts at the same time
  JobSettings jobs;
  LiveSettings live;
};

/// Adds the flags of README.md.
void add_options(config::Options& options, CoordinatorOptions& coordinator);

}  // namespace pleat::coordinator
