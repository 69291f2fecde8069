#include "services/evaluation/superres_process.hpp"

#include <chrono>
#include <csignal>
#include <thread>

#include "common/base/error.hpp"
#include "common/base/signals.hpp"
#include "common/rpc/channel.hpp"
#include "common/rpc/status.hpp"
#include "services/cli/launcher/launcher.hpp"

namespace pleat::evaluation {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr std::chrono::seconds kStartTimeout{120}, kStopTimeout{10};

constexpr const char* kDefaultModel = "draping";  // the service's

}  // namespace

SuperresProcess::SuperresProcess(const fs::path& models, const std::string& precision, const fs::path& log)
    : address_("unix:" + (folder_.path() / "superres.sock").string()) {
  if (log.has_parent_path()) fs::create_directories(log.parent_path());
  begin_log(log, "pleat-superres");
  const fs::path folder = models.empty() ? cli::default_models_folder() : models;
  std::vector<std::string> arguments{"--listen",    address_, "--die-with-parent", "--models", folder.string(),
                                     "--precision", precision};
  // Other folders need not have the default bundle.
  std::error_code ignored;
  if (!fs::exists(folder / (std::string(kDefaultModel) + ".pt"), ignored)) {
    arguments.insert(arguments.end(), {"--model", ""});
  }
  process_.emplace(executable_folder() / "pleat-superres", arguments, log);
  channel_ = rpc::create_channel(address_);
  const auto deadline = Clock::now() + kStartTimeout;
  while (!rpc::is_healthy(channel_, "pleat.v1.SuperResolution", std::chrono::milliseconds(300))) {
    if (!process_->running())
      throw Error(ErrorCode::kUnavailable, "superres ended (" + process_->end_reason() + "): " + last_lines(log, 1));
    if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
    if (Clock::now() > deadline) throw Error(ErrorCode::kUnavailable, "superres at " + address_ + " is not healthy");
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  stub_ = v1::SuperResolution::NewStub(channel_);
}

SuperresProcess::~SuperresProcess() {
  process_->send(SIGTERM);
  process_->wait_until(Clock::now() + kStopTimeout);
}

std::vector<v1::ModelDescription> SuperresProcess::models() {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + kStartTimeout);
  v1::ListModelsResponse response;
  rpc::throw_if_failed(stub_->ListModels(&context, {}, &response), "superres");
  return {response.models().begin(), response.models().end()};
}

v1::ModelDescription SuperresProcess::describe(const std::string& name) {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + kStartTimeout);
  v1::DescribeModelRequest request;
  request.set_model(name);
  v1::ModelDescription response;
  rpc::throw_if_failed(stub_->DescribeModel(&context, request, &response), "superres");
  return response;
}

std::unique_ptr<SuperresProcess::Stream> SuperresProcess::stream() {
  rpc::FrameStreamOptions options;
  options.peer = "superres at " + address_;
  options.window = 1;
  return std::make_unique<Stream>([this](auto* context, auto* call) { stub_->async()->Upscale(context, call); },
                                  options);
}

v1::ImageFrame upscale(SuperresProcess::Stream& stream, const v1::UpscaleRequest& request) {
  stream.push(request);
  v1::UpscaleResponse response;
  if (!stream.pop(&response)) throw Error(ErrorCode::kUnavailable, "superres ended the stream");
  if (response.has_error()) throw_internal("superres: " + response.error().message());
  return std::move(*response.mutable_frame());
}

}  // namespace pleat::evaluation
