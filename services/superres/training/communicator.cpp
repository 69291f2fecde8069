#include "services/superres/training/communicator.hpp"

#include <chrono>
#include <cstdlib>

#include "common/base/error.hpp"
#include "services/superres/training/rendezvous.hpp"

#ifdef PLEAT_HAVE_GLOO
#ifndef USE_C10D_GLOO
#define USE_C10D_GLOO
#endif
#include <torch/csrc/distributed/c10d/FileStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>
#ifdef USE_C10D_NCCL
#include <torch/csrc/distributed/c10d/ProcessGroupNCCL.hpp>
#endif
#endif

namespace pleat::superres {

#ifdef PLEAT_HAVE_GLOO

namespace {

/// Longer than any validation, which the first process does while the others wait.
constexpr std::chrono::milliseconds kTimeout = std::chrono::hours(1);

c10::intrusive_ptr<c10d::Store> make_store(const std::string& rendezvous, int rank, int size) {
  const auto place = parse_rendezvous(rendezvous);
  if (!place) return c10::make_intrusive<c10d::FileStore>(rendezvous, size);
  c10d::TCPStoreOptions options;
  options.port = place->port;
  options.isServer = rank == 0;
  options.numWorkers = static_cast<std::size_t>(size);
  options.timeout = kTimeout;
  return c10::make_intrusive<c10d::TCPStore>(place->host, options);
}

std::shared_ptr<gloo::transport::Device> make_device(const std::string& rendezvous) {
  const auto place = parse_rendezvous(rendezvous);
  if (!place || is_loopback(*place)) return c10d::ProcessGroupGloo::createDeviceForHostname("127.0.0.1");
  if (const char* interface = std::getenv("GLOO_SOCKET_IFNAME"); interface != nullptr) {
    return c10d::ProcessGroupGloo::createDeviceForInterface(interface);
  }
  return c10d::ProcessGroupGloo::createDefaultDevice();
}

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
    const auto store = make_store(rendezvous, rank, size);
#ifdef USE_C10D_NCCL
    if (device.is_cuda()) {
      group_->nccl = c10::make_intrusive<c10d::ProcessGroupNCCL>(store, rank, size);
      return;
    }
#endif
    static_cast<void>(device);
    const auto options = c10d::ProcessGroupGloo::Options::create(kTimeout);
    options->devices.push_back(make_device(rendezvous));
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
