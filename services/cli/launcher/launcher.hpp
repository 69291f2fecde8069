// Runs the services on this host, as children that end with us.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "common/base/process.hpp"
#include "services/cli/launcher/liveness.hpp"

namespace pleat::cli {

/// Name of the scratch folder that the services of one run keep their files in: inside the run's output folder, so that
/// a result moves out of it without being copied.
inline constexpr const char* kWorkPrefix = ".pleat-work";

struct LauncherOptions {
  std::filesystem::path executables = executable_folder();  ///< where pleat-simulation and the others lie
  std::filesystem::path models;                             ///< bundles; empty: default_models_folder()
  std::string model;           ///< the default bundle; empty: draping, else the first in `models`, else none
  std::filesystem::path data;  ///< the coordinator's job files; made if need be
  std::filesystem::path logs;  ///< one file a service; made if need be
  bool network = true;         ///< start conversion and superres
  bool fold = true;            ///< start the fold service
  std::string listen;          ///< of the coordinator; empty: a Unix socket
  std::string metrics_listen;  ///< of the coordinator; empty: none
  bool shared = false;         ///< others use them too: jobs leave processors to live sessions
  std::string token_file;      ///< of the coordinator: who may call it; empty: whoever gets there
  std::chrono::seconds start_timeout{300};     ///< until all are healthy
  std::chrono::seconds stop_grace{10};         ///< between SIGTERM and SIGKILL
  std::chrono::milliseconds patience{20'000};  ///< a service that does not answer this long is replaced
};

/// deploy/models below the folders above the executable, else ../share/pleat/models; $PLEAT_MODELS goes first.
std::filesystem::path default_models_folder();

/// The services, from construction to destruction. Not thread-safe; to be used from the main thread, because the
/// kernel ends the children with the thread that started them.
class Launcher {
 public:
  /// One of the services.
  struct Service {
    std::string name;         ///< "simulation"
    std::string health_name;  ///< "pleat.v1.Simulation"
    std::string address;      ///< for clients
    pid_t pid = -1;
  };

  /// Starts all and waits until they are healthy. Throws kNotFound (an executable is missing), kUnavailable (a service
  /// ended at start: its last log line is in the message; or none answered in time), kCancelled (interrupted()).
  explicit Launcher(LauncherOptions options);
  /// stop().
  ~Launcher();

  const std::vector<Service>& services() const { return services_; }
  const std::string& coordinator() const;

  /// Ends services that hang (they do not answer health checks for `patience`), and starts those again that have ended:
  /// the first time at once, then after a pause that doubles with each end in the last minute, up to 30 s. To be called
  /// often. Returns a line for each.
  std::vector<std::string> supervise();

  /// SIGTERM to all, the coordinator first; SIGKILL after the grace. Idempotent.
  void stop();

 private:
  struct Running;
  void start_service(std::size_t index);
  void wait_until_healthy();
  std::string cause_of_end(std::size_t index) const;

  LauncherOptions options_;
  PrivateFolder sockets_;
  std::vector<Service> services_;
  Liveness liveness_;
  std::vector<Running> running_;
};

}  // namespace pleat::cli
