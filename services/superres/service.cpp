#include "services/superres/service.hpp"

#include <google/protobuf/util/json_util.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/status.hpp"
#include "common/rpc/stream.hpp"
#include "common/telemetry/log.hpp"
#include "services/superres/bundle/folder.hpp"

namespace pleat::superres {
namespace {

/// Frames of one stream in work at once: one is being answered while the next is read and checked.
constexpr std::size_t kConcurrency = 2;
constexpr int kPositionChannels = 3;  ///< the first ones, which are all that positions need

std::string without_extension(const std::string& name) {
  return name.size() > 3 && name.ends_with(".pt") ? name.substr(0, name.size() - 3) : name;
}

/// Changes when a file is replaced or written again; "" if it is gone.
std::string file_identity(const std::string& path) {
  struct stat s {};
  if (::stat(path.c_str(), &s) != 0) return "";
  return fmt::format("{}:{}:{}:{}.{}", s.st_dev, s.st_ino, s.st_size, s.st_mtim.tv_sec, s.st_mtim.tv_nsec);
}

/// What the network of one stream remembers (ImageFrame.state). One frame after the other.
class StreamMemory {
 public:
  explicit StreamMemory(std::size_t values) : values_(values) {}

  /// The state that came with the frame; else that of the frame before, if this is the next one; else none.
  void begin(const v1::ImageFrame& request, NetworkInput& input) {
    const std::string& state = request.state();
    const bool goes_on = last_ && request.index() == *last_ + 1;
    last_.reset();  // should the frame fail, nothing goes on from it
    if (!state.empty()) {
      if (state.size() != values_ * sizeof(float)) {
        throw_invalid_argument("frame.state: " + std::to_string(state.size()) + " bytes, the bundle remembers " +
                               std::to_string(values_ * sizeof(float)));
      }
      known_.resize(values_);
      std::memcpy(known_.data(), state.data(), state.size());
    } else if (!goes_on) {
      known_.clear();
    }
    input.memory = known_;
    input.left = &left_;
  }

  void end(std::uint64_t index, std::string* state) {
    std::swap(known_, left_);
    last_ = index;
    state->assign(reinterpret_cast<const char*>(known_.data()), known_.size() * sizeof(float));
  }

 private:
  const std::size_t values_;
  std::vector<float> known_, left_;
  std::optional<std::uint64_t> last_;  ///< the frame that left known_
};

}  // namespace

SuperResolutionService::SuperResolutionService(const ServiceOptions& options, telemetry::Metrics& metrics)
    : options_(options), metrics_(metrics) {
  precision_from_string(options.precision);
  if (!options_.model.empty()) batcher("");
}

std::shared_ptr<Batcher> SuperResolutionService::batcher(const std::string& requested) {
  const std::string name = without_extension(requested.empty() ? options_.model : requested);
  if (name.empty()) throw_invalid_argument("no model named, and this service has no default one");
  const std::lock_guard lock(mutex_);
  const auto present = loaded_.find(name);
  if (present == loaded_.end()) {
    if (loaded_.size() >= static_cast<std::size_t>(std::max(1, options_.loaded_models))) {
      const auto unused = std::find_if(loaded_.begin(), loaded_.end(),
                                       [](const auto& entry) { return entry.second.batcher.use_count() == 1; });
      if (unused == loaded_.end()) {
        throw Error(ErrorCode::kUnavailable,
                    "model '" + name + "': " + std::to_string(loaded_.size()) + " other models are in use");
      }
      loaded_.erase(unused);
    }
    std::string file = file_identity(bundle_path(options_.models, name));
    return loaded_.emplace(name, Loaded{load(name), std::move(file)}).first->second.batcher;
  }
  Loaded& loaded = present->second;
  try {
    const std::string file = file_identity(bundle_path(options_.models, name));
    if (file == loaded.file) return loaded.batcher;
    loaded.file = file;
    loaded.batcher = load(name);
  } catch (const Error& error) {
    spdlog::warn("model {}: its file was changed and can't be used, the loaded one stays: {}", name, error.what());
  }
  return loaded.batcher;
}

std::shared_ptr<Batcher> SuperResolutionService::load(const std::string& name) const {
  EngineOptions engine;
  engine.folder = options_.models;
  engine.precision = precision_from_string(options_.precision);
  engine.threads = options_.threads;
  engine.use_cuda = options_.cuda;
  engine.largest_batch = options_.largest_batch;
  BatcherOptions batching;
  batching.largest_batch = options_.largest_batch;
  batching.latency = std::chrono::microseconds(static_cast<std::int64_t>(1000 * options_.batch_latency_ms));
  const telemetry::StageTimer timer;
  auto loaded = std::make_shared<Engine>(engine, name);
  const EngineStatus status = loaded->status();
  spdlog::info("model {}: {} parameters, {} on {} ({}; {}, {} threads), ready after {:.0f} ms", name,
               loaded->describe().parameters, status.precision, status.device, status.processor, status.kernels,
               status.threads, timer.milliseconds());
  return std::make_shared<Batcher>(std::move(loaded), batching);
}

void SuperResolutionService::describe(const std::string& name, const Metadata& metadata,
                                      v1::ModelDescription* message) {
  message->set_model(name);
  message->set_architecture(metadata.architecture.kind);
  message->set_parameters(static_cast<std::uint64_t>(std::max<std::int64_t>(0, metadata.parameters)));
  const auto parsed =
      google::protobuf::util::JsonStringToMessage(representation_json(metadata), message->mutable_representation());
  if (!parsed.ok()) throw_internal("bundle " + name + ": representation: " + parsed.ToString());
  message->set_constant_channels(static_cast<std::uint32_t>(metadata.constants));
  message->set_topology_hash(metadata.topology_hash);
  message->set_state_values(static_cast<std::uint32_t>(memory_values(metadata)));
  message->set_git_revision(metadata.git_revision);
  message->mutable_rest_positions()->Assign(metadata.rest_positions.begin(), metadata.rest_positions.end());
  Metadata text = metadata;
  text.rest_positions.clear();
  message->set_metadata_json(to_json(text));
  const std::lock_guard lock(mutex_);
  if (const auto it = loaded_.find(name); it != loaded_.end()) {
    const EngineStatus status = it->second.batcher->engine().status();
    message->set_device(status.device);
    message->set_precision(status.precision);
  }
}

grpc::Status SuperResolutionService::ListModels(grpc::ServerContext* context, const v1::ListModelsRequest*,
                                                v1::ListModelsResponse* response) {
  return rpc::guard([&] {
    const telemetry::TraceScope trace(rpc::trace_of(*context));
    for (const std::string& name : list_bundles(options_.models)) {
      try {
        describe(name, read_metadata(options_.models, name), response->add_models());
      } catch (const Error& error) {
        // One damaged file must not hide the others.
        response->mutable_models()->RemoveLast();
        spdlog::warn("{}", error.what());
      }
    }
  });
}

grpc::Status SuperResolutionService::DescribeModel(grpc::ServerContext* context,
                                                   const v1::DescribeModelRequest* request,
                                                   v1::ModelDescription* response) {
  return rpc::guard([&] {
    const telemetry::TraceScope trace(rpc::trace_of(*context));
    const auto loaded = batcher(request->model());
    const std::string name = without_extension(request->model().empty() ? options_.model : request->model());
    describe(name, loaded->engine().describe(), response);
  });
}

grpc::Status SuperResolutionService::Upscale(
    grpc::ServerContext* context, grpc::ServerReaderWriter<v1::UpscaleResponse, v1::UpscaleRequest>* stream) {
  rpc::FrameServiceOptions options{"superres", &metrics_, &drain_, kConcurrency};
  return rpc::serve_frames<v1::UpscaleRequest, v1::UpscaleResponse>(
      context, stream, options, [&](const v1::UpscaleOpen& open, v1::ModelDescription* opened) {
        auto loaded = batcher(open.model());
        if (!open.topology_hash().empty()) loaded->engine().require_topology(open.topology_hash());
        describe(without_extension(open.model().empty() ? options_.model : open.model()), loaded->engine().describe(),
                 opened);
        auto session = loaded->open_session();
        const auto constants = loaded->engine().take_constants(
            open.constants().shape_size() > 0 ? from_message(open.constants(), "open.constants") : Tensor{});
        // Corrections by gradients need the whole answer.
        const bool enough = conversion::answer_form(loaded->engine().describe().representation).first_three;
        const int channels = open.displacement_only() && enough ? kPositionChannels : 0;
        const std::size_t remembered = memory_values(loaded->engine().describe());
        spdlog::info("session: model {}, {}", opened->model(), opened->precision());
        // Read behind this: a frame begins when the one before has left what it is to remember.
        if (remembered > 0) options.concurrency = 1;
        const auto recall = remembered > 0 ? std::make_shared<StreamMemory>(remembered) : nullptr;
        return [loaded, session, constants, channels, recall, dtype = open.dtype()](const v1::ImageFrame& request,
                                                                                    v1::ImageFrame* response) {
          // Kept from frame to frame: what is new is filled with zeros first.
          thread_local Tensor frames, answer;
          from_payload(request.image(), "frame.image", &frames);
          NetworkInput input{&frames, constants};
          if (recall != nullptr) recall->begin(request, input);
          loaded->upscale(input, channels, answer);
          if (recall != nullptr) recall->end(request.index(), response->mutable_state());
          response->set_index(request.index());
          response->set_time_s(request.time_s());
          *response->mutable_alignment() = request.alignment();
          *response->mutable_stage_times() = request.stage_times();
          response->set_out_of_range(request.out_of_range());
          to_payload(answer, dtype, response->mutable_image());
        };
      });
}

}  // namespace pleat::superres
