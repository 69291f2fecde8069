// The services as real processes over Unix sockets, to be killed and started again.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/base/process.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"

namespace pleat::testing {

/// Starts pleat-simulation, -conversion, -superres, -fold, -refinement and -coordinator from PLEAT_BINARY_DIR/bin. To
/// be used from the main thread: the kernel ends the children with the thread that started them.
class ServiceProcesses {
 public:
  ServiceProcesses();

  /// "simulation", "conversion", "superres", "fold", "refinement", "coordinator"
  static const std::vector<std::string>& stages();

  void start(const std::string& service);
  void wait_until_healthy(const std::string& service);
  /// SIGKILL; returns when the process is gone.
  void kill(const std::string& service);
  /// Kills the service and starts it again; false if the job had no need of it any more (its process goes on while
  /// its state is asked for). For the coordinator, its own result file tells.
  bool kill_within_job(const std::string& service, const std::string& job);
  /// SIGTERM; returns how it ended.
  std::string terminate(const std::string& service);

  /// One more process of a stage, under a name that begins with it ("fold-2"); started, not yet healthy. It drains for
  /// as long as it takes: ends only by itself.
  void start_replica(const std::string& name);
  /// One more coordinator with other options, under the name; started and healthy.
  void start_coordinator(const std::string& name, const std::map<std::string, std::string>& options);
  std::unique_ptr<v1::Coordinator::Stub> client(const std::string& coordinator = "coordinator") const;

  std::string address(const std::string& service) const;
  /// Open connections to the service's socket; streams and channels hold them.
  int connections(const std::string& service) const;
  /// The end of the service's log, for messages.
  std::string log(const std::string& service) const;
  /// All that it has logged since the first start.
  std::string whole_log(const std::string& service) const;

  const std::filesystem::path& folder() const { return folder_.path(); }

 private:
  PrivateFolder folder_;
  std::filesystem::path executables_;
  std::map<std::string, std::vector<std::string>> arguments_;
  std::map<std::string, ChildProcess> running_;
};

}  // namespace pleat::testing
