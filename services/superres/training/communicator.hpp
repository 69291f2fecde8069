// Processes that train one network together. Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/torch.h>

#include <memory>
#include <string>

namespace pleat::superres {

class Communicator {
 public:
  /// Process `rank` of `size`, which meet in the file `rendezvous`, a new one, on one host, or at `rendezvous` =
  /// HOST:PORT (rendezvous.hpp), where the first one listens. Waits for the others. Gloo takes the interface that
  /// GLOO_SOCKET_IFNAME names, else that of the host's name, or loopback where the rendezvous is there. Uses NCCL for a
  /// CUDA device where LibTorch has it, else Gloo. Throws kFailedPrecondition if LibTorch was built without,
  /// kUnavailable if the others don't come. A size of 1 needs nothing.
  Communicator(int rank, int size, const std::string& rendezvous, torch::Device device);
  ~Communicator();

  int rank() const { return rank_; }
  int size() const { return size_; }

  /// Sum over the processes, in place, the same bits on each. Throws kUnavailable if a process is gone.
  void sum(torch::Tensor tensor);

 private:
  struct Group;
  int rank_, size_;
  std::unique_ptr<Group> group_;
};

}  // namespace pleat::superres
