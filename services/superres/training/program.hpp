// pleat-train behind its command line: a configuration trained to a bundle, with progress on stdout.
#pragma once

#include <atomic>
#include <string>
#include <vector>

namespace pleat::superres {

struct TrainArguments {
  std::string re_export, out;  ///< a bundle of an earlier version, and where to write it anew, instead of training
  std::string any_mesh;        ///< a bundle of one mesh, written to `out` so that it serves any
  std::string garment;         ///< with these: the file of its coarse mesh
  std::string config;
  std::string initial;  ///< a bundle that the training begins with, whatever `config` says about the network
  std::vector<std::string> changes;  ///< KEY=VALUE
  int processes = 1;
  int rank = 0;                       ///< of a process that the first one started, or that the caller places
  std::string rendezvous;             ///< the same: a file, or HOST:PORT (rendezvous.hpp)
  std::string git_revision;           ///< for the bundle
  std::vector<std::string> words;     ///< the whole command line, for the other processes
  std::atomic<bool>* stop = nullptr;  ///< set to end after the step at hand, with a check-point
};

/// Whether the caller places the processes, on any machines that share a disk, instead of the first one on its own.
bool is_distributed(const TrainArguments& arguments);

/// From now on SIGINT and SIGTERM ask this process to stop, if it is the first one, by the flag that is returned. The
/// others stop when that one says so; those that it started end with it.
std::atomic<bool>* stop_on_signals(const TrainArguments& arguments);

/// Trains, or goes on from the check-point; or rewrites a bundle. Returns an exit code: kExitRunAgain if a distributed
/// training was stopped, or lost a process, before its end. Throws what read_train_config, load_pairs, train,
/// re_export and serve_any_mesh throw; kInvalidArgument without a configuration.
int run_training(const TrainArguments& arguments);

}  // namespace pleat::superres
