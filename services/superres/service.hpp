// pleat.v1.SuperResolution over Engine and Batcher.
#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "common/rpc/drain.hpp"
#include "common/telemetry/metrics.hpp"
#include "pleat/v1/superres.grpc.pb.h"
#include "services/superres/batcher.hpp"

namespace pleat::superres {

struct ServiceOptions {
  std::string models = "deploy/models";  ///< the only folder that bundles are loaded from
  std::string model = "draping";         ///< loaded and warmed up before the service is healthy; "" for none
  std::string precision = "auto";        ///< auto, float32 or bfloat16
  int threads = 0;                       ///< of one inference; 0: the processors this process may use
  int largest_batch = 4;                 ///< frames of several sessions in one inference
  double batch_latency_ms = 1;           ///< how long a frame waits for those of other sessions
  int loaded_models = 4;                 ///< bundles in memory at most
  bool cuda = true;                      ///< use a CUDA device where there is one
};

class SuperResolutionService final : public v1::SuperResolution::Service {
 public:
  /// Loads and warms up the default bundle. Errors as Engine.
  SuperResolutionService(const ServiceOptions& options, telemetry::Metrics& metrics);

  grpc::Status ListModels(grpc::ServerContext* context, const v1::ListModelsRequest* request,
                          v1::ListModelsResponse* response) override;
  grpc::Status DescribeModel(grpc::ServerContext* context, const v1::DescribeModelRequest* request,
                             v1::ModelDescription* response) override;
  grpc::Status Upscale(grpc::ServerContext* context,
                       grpc::ServerReaderWriter<v1::UpscaleResponse, v1::UpscaleRequest>* stream) override;

  /// Streams end when what they have read is answered; new ones are refused. A client goes on in another replica.
  void drain() { drain_.begin(); }

 private:
  /// A bundle in memory and the file that it came from.
  struct Loaded {
    std::shared_ptr<Batcher> batcher;
    std::string file;  ///< file_identity() when it was last looked at, whether that could be loaded or not
  };

  /// The running bundle, loaded at its first use and again when its file was replaced. Sessions keep the one that they
  /// were opened with, because their images are normalised for it. A new file that can't be loaded leaves the old
  /// bundle in use, with a warning. "" is the default one.
  std::shared_ptr<Batcher> batcher(const std::string& name);
  std::shared_ptr<Batcher> load(const std::string& name) const;
  void describe(const std::string& name, const Metadata& metadata, v1::ModelDescription* message);

  ServiceOptions options_;
  telemetry::Metrics& metrics_;
  rpc::Drain drain_;
  std::mutex mutex_;
  std::map<std::string, Loaded> loaded_;
};

}  // namespace pleat::superres
