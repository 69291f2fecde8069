// pleat-superres alone, as a child process, for benchmarks.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/process.hpp"
#include "common/rpc/stream.hpp"
#include "pleat/v1/superres.grpc.pb.h"

namespace pleat::evaluation {

class SuperresProcess {
 public:
  using Stream = rpc::FrameStream<v1::UpscaleRequest, v1::UpscaleResponse>;

  /// Starts the service and waits until it is healthy. models: folder of the bundles; empty: default_models_folder().
  /// precision: "auto", "float32" or "bfloat16". log: file for its output. Throws kUnavailable (it ended or is not
  /// healthy in time), kCancelled (interrupted()).
  SuperresProcess(const std::filesystem::path& models, const std::string& precision, const std::filesystem::path& log);
  ~SuperresProcess();

  std::vector<v1::ModelDescription> models();
  /// name: empty for the service's default bundle.
  v1::ModelDescription describe(const std::string& name = "");

  /// A stream that has one frame in flight; the caller opens it.
  std::unique_ptr<Stream> stream();

 private:
  PrivateFolder folder_;
  std::string address_;
  std::optional<ChildProcess> process_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::SuperResolution::Stub> stub_;
};

/// Sends one image and waits for the answer. Throws what the service answers.
v1::ImageFrame upscale(SuperresProcess::Stream& stream, const v1::UpscaleRequest& request);

}  // namespace pleat::evaluation
