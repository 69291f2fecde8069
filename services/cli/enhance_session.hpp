// A live session with a coordinator: coarse frames in, enhanced frames out, in order.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/rpc/channel.hpp"
#include "common/store/dataset.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"

namespace pleat::cli {

struct EnhanceSessionOptions {
  Topology coarse;
  std::string model;  ///< empty: the service's default
  double frame_time_s = 0.04;
  std::vector<ObstacleShape> obstacles;
  std::uint32_t window = 0;  ///< frames in flight; 0: the coordinator's default
  std::optional<std::uint32_t> subdivision_rounds;
  bool skip_refinement = false;  ///< the fine frames as the network made them
};

/// What goes in.
struct CoarseInput {
  Positions positions;  ///< (V_coarse x 3) metres
  std::vector<ObstacleFrame> obstacles;
};

class EnhanceSession {
 public:
  /// Opens the session. Throws what the coordinator answers, with its address.
  EnhanceSession(const std::shared_ptr<grpc::Channel>& channel, const std::string& address,
                 const EnhanceSessionOptions& options);
  ~EnhanceSession();

  const MeshPair& topology() const { return topology_; }
  const std::string& model() const { return model_; }
  const std::string& device() const { return device_; }
  const std::string& precision() const { return precision_; }

  /// Sends frames 0 to count - 1 as the window allows, and gives every answer with its input to `sink`. Call once.
  /// Throws the first frame's error (its index is named), kCancelled (interrupted()), and what input or sink throw.
  void run(std::uint64_t count, const std::function<CoarseInput(std::uint64_t)>& input,
           const std::function<void(const v1::EnhancedFrame&, const CoarseInput&)>& sink);

 private:
  struct Stream;
  std::unique_ptr<v1::Coordinator::Stub> stub_;
  std::unique_ptr<Stream> stream_;
  MeshPair topology_;
  std::string model_, device_, precision_;
  double frame_time_s_;
};

}  // namespace pleat::cli
