#include "services/superres/training/communicator.hpp"

#include <chrono>

#include "common/base/error.hpp"

#ifdef PLEAT_HAVE_GLOO
#ifndef USE_C10D_GLOO
#define USE_C10D_GLOO
#endif
#include <torch/csrc/distributed/c10d/FileStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#ifdef USE_C10D_NCCL
#include <torch/csrc/distributed/c10d/ProcessGroupNCCL.hpp>
#endif
#endif

namespace pleat::superres {

#ifdef PLEAT_HAVE_GLOO

namespace {

/// Longer than any validation, which the first process does while the others wait.
constexpr std::chrono::milliseconds kTimeout = std::chrono::hours(1);

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

}  // namespace

struct Communicator::Group {
  c10::intrusive_ptr<c10d::ProcessGroupGloo> gloo;
#ifdef USE_C10D_NCCL
  c10::intrusive_ptr<c10d::ProcessGroupNCCL> nccl;
#endif
};

Communicator::Communicator(int rank, int size, const std::string& rendezvous, torch::Device device)
    : rank_(rank), size_(size) {
  if (size <= 1) return;
  group_ = std::make_unique<Group>();
  try {
    const auto store = c10::make_intrusive<c10d::FileStore>(rendezvous, size);
#ifdef USE_C10D_NCCL
    if (device.is_cuda()) {
      group_->nccl = c10::make_intrusive<c10d::ProcessGroupNCCL>(store, rank, size);
      return;
    }
#endif
    static_cast<void>(device);
    const auto options = c10d::ProcessGroupGloo::Options::create(kTimeout);
    options->devices.push_back(c10d::ProcessGroupGloo::createDeviceForHostname("127.0.0.1"));
    group_->gloo = c10::make_intrusive<c10d::ProcessGroupGloo>(store, rank, size, options);
  } catch (const std::exception& error) {
    throw Error(ErrorCode::kUnavailable, "training processes can't meet: " + first_line(error.what()));
  }
}

void Communicator::sum(torch::Tensor tensor) {
  if (!group_) return;
  std::vector<torch::Tensor> tensors{std::move(tensor)};
  try {
#ifdef USE_C10D_NCCL
    if (group_->nccl) {
      group_->nccl->allreduce(tensors)->wait();
      return;
    }
#endif
    group_->gloo->allreduce(tensors)->wait();
  } catch (const std::exception& error) {
    throw Error(ErrorCode::kUnavailable, "a training process is gone: " + first_line(error.what()));
  }
}

#else

struct Communicator::Group {};

Communicator::Communicator(int rank, int size, const std::string&, torch::Device) : rank_(rank), size_(size) {
  if (size > 1) {
    throw Error(ErrorCode::kFailedPrecondition, "training by several processes needs Gloo (Debian: libgloo-dev)");
  }
}

void Communicator::sum(torch::Tensor) {}

#endif

Communicator::~Communicator() = default;

}  // namespace pleat::superres
