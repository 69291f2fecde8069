#include "services/coordinator/pipeline.hpp"

#include <google/protobuf/util/message_differencer.h>

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "common/frame/representation_messages.hpp"
#include "common/mesh/mesh.hpp"
#include "pleat/v1/conversion.grpc.pb.h"
#include "pleat/v1/refinement.grpc.pb.h"
#include "pleat/v1/superres.grpc.pb.h"

namespace pleat::coordinator {
namespace {

enum StageIndex : std::size_t { kToImage, kSuperres, kToMesh, kRefinement };

void add_times(PipelineFrame& frame, StageTimes& times) {
  for (v1::StageTime& time : times) frame.stage_times.Add(std::move(time));
  times.Clear();
}

/// The request of a stage that has answered or was given up: it is sent by nobody, and gives back what it was lent.
template <typename Request>
Request& sent(PipelineFrame& frame) {
  return const_cast<Request&>(static_cast<const Request&>(*frame.work));
}

struct ToImageRpc {
  using Service = v1::Conversion;
  using Request = v1::ToImageRequest;
  using Response = v1::ToImageResponse;
  static void start(Service::Stub& stub, grpc::ClientContext* context,
                    grpc::ClientBidiReactor<Request, Response>* call) {
    stub.async()->ToImage(context, call);
  }
  static void absorb(PipelineFrame& frame, v1::ImageFrame& answer) {
    add_times(frame, *answer.mutable_stage_times());
    frame.image.Swap(&answer);
    frame.alignment = frame.image.alignment();
  }
  static void take_back(PipelineFrame& frame) {
    frame.coarse.Swap(sent<Request>(frame).mutable_frame());
    frame.coarse.set_index(frame.index);
  }
  static void prepare(PipelineFrame& frame) {
    auto work = std::make_shared<Request>();
    work->mutable_frame()->Swap(&frame.coarse);
    work->mutable_frame()->set_index(frame.sequence);
    for (const auto& earlier : frame.earlier) *work->add_earlier() = *earlier;
    frame.earlier.clear();
    frame.work = std::move(work);
  }
};

struct UpscaleRpc {
  using Service = v1::SuperResolution;
  using Request = v1::UpscaleRequest;
  using Response = v1::UpscaleResponse;
  static void start(Service::Stub& stub, grpc::ClientContext* context,
                    grpc::ClientBidiReactor<Request, Response>* call) {
    stub.async()->Upscale(context, call);
  }
  static void absorb(PipelineFrame& frame, v1::ImageFrame& answer) {
    add_times(frame, *answer.mutable_stage_times());
    frame.image.Swap(&answer);
  }
  static void take_back(PipelineFrame&) {}
  static void prepare(PipelineFrame& frame) {
    auto work = std::make_shared<Request>();
    work->mutable_frame()->Swap(&frame.image);
    frame.work = std::move(work);
  }
};

struct ToMeshRpc {
  using Service = v1::Conversion;
  using Request = v1::ToMeshRequest;
  using Response = v1::ToMeshResponse;
  static void start(Service::Stub& stub, grpc::ClientContext* context,
                    grpc::ClientBidiReactor<Request, Response>* call) {
    stub.async()->ToMesh(context, call);
  }
  static void absorb(PipelineFrame& frame, v1::MeshFrame& answer) {
    add_times(frame, *answer.mutable_stage_times());
    frame.fine.Swap(answer.mutable_fine());
  }
  static void take_back(PipelineFrame& frame) {
    frame.coarse.mutable_positions()->Swap(sent<Request>(frame).mutable_frame()->mutable_coarse()->mutable_positions());
  }
  static void prepare(PipelineFrame& frame) {
    auto work = std::make_shared<Request>();
    work->mutable_frame()->Swap(&frame.image);
    // A network knows nothing of the rigid motion: the frame's own goes around it.
    work->mutable_frame()->set_index(frame.sequence);
    work->mutable_frame()->set_time_s(frame.coarse.time_s());
    *work->mutable_frame()->mutable_alignment() = frame.alignment;
    // The answer is added to the coarse mesh.
    work->mutable_frame()->mutable_coarse()->mutable_positions()->Swap(frame.coarse.mutable_positions());
    frame.work = std::move(work);
  }
};

struct RefineRpc {
  using Service = v1::Refinement;
  using Request = v1::RefineRequest;
  using Response = v1::RefineResponse;
  static void start(Service::Stub& stub, grpc::ClientContext* context,
                    grpc::ClientBidiReactor<Request, Response>* call) {
    stub.async()->Refine(context, call);
  }
  static void absorb(PipelineFrame& frame, v1::RefinedFrame& answer) {
    add_times(frame, *answer.mutable_stage_times());
    frame.report.Swap(answer.mutable_report());
    frame.fine.Swap(answer.mutable_fine());
  }
  static void take_back(PipelineFrame& frame) {
    v1::RefineFrame& request = *sent<Request>(frame).mutable_frame();
    frame.coarse.Swap(request.mutable_coarse());
    frame.coarse.set_index(frame.index);
    frame.obstacles.Swap(request.mutable_obstacles());
  }
  static void prepare(PipelineFrame& frame) {
    auto work = std::make_shared<Request>();
    v1::RefineFrame& request = *work->mutable_frame();
    request.mutable_coarse()->Swap(&frame.coarse);
    request.mutable_coarse()->set_index(frame.sequence);
    request.mutable_fine()->Swap(&frame.fine);
    request.mutable_fine()->set_index(frame.sequence);
    request.mutable_fine()->set_time_s(request.coarse().time_s());
    request.mutable_obstacles()->Swap(&frame.obstacles);
    frame.work = std::move(work);
  }
};

v1::ConversionSetup conversion_setup(const PipelineSession& session) {
  v1::ConversionSetup setup;
  *setup.mutable_coarse() = session.coarse;
  *setup.mutable_representation() = session.representation;
  return setup;
}

/// Calls one of the addresses after the other until one answers, or the outage is too long.
template <typename Response, typename Call>
Response ask(const std::string& service, const std::vector<std::string>& addresses, const LinkOptions& link,
             const std::function<bool()>& cancelled, const Call& call) {
  Outage outage(link.give_up);
  Backoff backoff(std::chrono::milliseconds(50), std::chrono::milliseconds(400));
  for (std::size_t attempt = 0;; ++attempt) {
    const std::string& address = addresses[attempt % addresses.size()];
    Response response;
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::min(link.open_timeout, link.give_up));
    const grpc::Status status = call(link.connect(address), &context, &response);
    if (status.ok()) return response;
    const Error error = rpc::to_error(status, service + " at " + address);
    if (!may_pass(error.code())) throw error;
    if (outage.too_long()) throw outage.gave_up(error);
    if (cancelled()) throw Error(ErrorCode::kCancelled, "cancelled");
    std::this_thread::sleep_for(backoff.next());
  }
}

void check_fine_hash(const std::string& hash, const std::string& expected) {
  if (!hash.empty() && hash != expected) {
    throw_internal("subdivides the coarse mesh in another way: " + hash + ", expected " + expected);
  }
}

/// What a bundle has another one of; empty if both make the same frames.
std::string difference(const v1::ModelDescription& before, const v1::ModelDescription& now) {
  using google::protobuf::util::MessageDifferencer;
  const auto image = [](const v1::ModelDescription& model) {
    return std::tuple(model.coarse_width(), model.coarse_height(), model.scale());
  };
  if (!MessageDifferencer::Equals(now.normalization(), before.normalization())) return "normalisation";
  if (!MessageDifferencer::Equals(now.representation(), before.representation())) return "representation";
  if (image(now) != image(before)) return "image size";
  if (!std::equal(now.channels().begin(), now.channels().end(), before.channels().begin(), before.channels().end())) {
    return "list of channels";
  }
  if (now.topology_hash() != before.topology_hash()) return "mesh";
  if (now.architecture() != before.architecture() || now.parameters() != before.parameters()) return "architecture";
  if (now.metadata_json() != before.metadata_json() || now.git_revision() != before.git_revision()) return "training";
  return {};
}

}  // namespace

std::vector<std::string> split_addresses(const std::string& service, const std::string& list) {
  std::vector<std::string> addresses;
  std::size_t begin = 0;
  while (begin <= list.size()) {
    const std::size_t end = std::min(list.find(',', begin), list.size());
    if (end > begin) addresses.push_back(list.substr(begin, end - begin));
    begin = end + 1;
  }
  if (addresses.empty()) throw_invalid_argument("--" + service + ": no address");
  return addresses;
}

void admit(std::int64_t coarse_vertices, int rounds, std::int64_t max_vertices, const std::string& what) {
  if (rounds > kMaxSubdivisionRounds) {
    throw_invalid_argument(what + ": " + std::to_string(rounds) + " subdivisions, at most " +
                           std::to_string(kMaxSubdivisionRounds));
  }
  const double fine = static_cast<double>(coarse_vertices) * std::pow(4.0, rounds);
  if (fine <= static_cast<double>(max_vertices)) return;
  throw Error(ErrorCode::kResourceExhausted,
              what + ": " + std::to_string(coarse_vertices) + " vertices, subdivided " + std::to_string(rounds) +
                  " times about " + std::to_string(static_cast<std::int64_t>(fine)) +
                  ", more than this coordinator's limit of " + std::to_string(max_vertices));
}

v1::ModelDescription describe_model(const ServiceAddresses& addresses, const LinkOptions& link, const std::string& name,
                                    const std::function<bool()>& cancelled) {
  return ask<v1::ModelDescription>(
      "superres", addresses.superres, link, cancelled, [&](const auto& channel, auto* context, auto* response) {
        v1::DescribeModelRequest request;
        request.set_model(name);
        return v1::SuperResolution::NewStub(channel)->DescribeModel(context, request, response);
      });
}

v1::ConversionOpened describe_conversion(const ServiceAddresses& addresses, const LinkOptions& link,
                                         const PipelineSession& session, const std::function<bool()>& cancelled) {
  const v1::ConversionSetup setup = conversion_setup(session);
  return ask<v1::ConversionOpened>("conversion", addresses.conversion, link, cancelled,
                                   [&](const auto& channel, auto* context, auto* response) {
                                     return v1::Conversion::NewStub(channel)->Describe(context, setup, response);
                                   });
}

Subdivision subdivision_of(const PipelineSession& session, const Topology& coarse) {
  Subdivision subdivision = subdivide(coarse, subdivision_from(session.representation));
  check_fine_hash(session.conversion.fine().hash(), topology_hash(subdivision.fine));
  return subdivision;
}

void require_same_bundle(const v1::ModelDescription& before, const v1::ModelDescription& now) {
  const std::string other = difference(before, now);
  if (other.empty()) return;
  throw Error(ErrorCode::kFailedPrecondition,
              "bundle " + before.model() + " was replaced meanwhile by one with another " + other + "; begin anew");
}

EnhancementPipeline::EnhancementPipeline(const ServiceAddresses& addresses, const LinkOptions& link,
                                         const PipelineSession& session, std::size_t fine_vertices,
                                         const std::string& fine_hash, Sink sink, std::function<void()> failed)
    : sink_(std::move(sink)),
      failed_(std::move(failed)),
      fine_vertices_(fine_vertices),
      earlier_(session.representation.window()) {
  const std::size_t count = session.skip_refinement ? kRefinement : kRefinement + 1;
  stage_opened_.assign(count, false);
  const auto stage_is_open = [this](std::size_t stage) {
    const std::lock_guard lock(mutex_);
    if (stage_opened_[stage]) return;
    stage_opened_[stage] = true;
    ++opened_;
    changed_.notify_all();
  };
  const auto make_callbacks = [&](auto rpc, std::size_t stage, auto opened) {
    using Rpc = decltype(rpc);
    prepare_.push_back(Rpc::prepare);
    typename RemoteStage<Rpc>::Callbacks callbacks;
    callbacks.opened = [stage_is_open, stage, opened](const auto& answer) {
      opened(answer);
      stage_is_open(stage);
    };
    callbacks.deliver = [this, stage](std::unique_ptr<PipelineFrame> frame) { hand_on(stage, std::move(frame)); };
    callbacks.drained = [this, stage] { stage_drained(stage); };
    callbacks.failed = [this](const Error& cause) { fail(cause); };
    return callbacks;
  };
  const auto check_fine = [fine_hash](const std::string& hash) { check_fine_hash(hash, fine_hash); };
  for (const v1::Frame& frame : session.earlier) earlier_.fill(frame);
  RemoteStage<ToImageRpc>::Options to_image{
      .stage = "to_image", .service = "conversion", .addresses = addresses.conversion, .open = {}, .link = link};
  *to_image.open.mutable_open()->mutable_setup() = conversion_setup(session);
  to_image.open.mutable_open()->set_window(session.window);
  to_image.open.mutable_open()->set_dtype(session.conversion.dtype());
  to_image.window = session.window;
  to_image.first_sequence = session.first_sequence;
  const auto any = [](const auto&) {};
  auto to_image_callbacks = make_callbacks(ToImageRpc{}, kToImage, any);

  RemoteStage<UpscaleRpc>::Options upscale{
      .stage = "superres", .service = "superres", .addresses = addresses.superres, .open = {}, .link = link};
  upscale.open.mutable_open()->set_model(session.model.model());
  upscale.open.mutable_open()->set_topology_hash(session.coarse.hash());
  upscale.open.mutable_open()->set_window(session.window);
  upscale.open.mutable_open()->set_displacement_only(true);
  upscale.open.mutable_open()->set_dtype(session.conversion.dtype());
  if (session.conversion.has_constants()) {
    *upscale.open.mutable_open()->mutable_constants() = session.conversion.constants();
  }
  upscale.window = session.window;
  upscale.first_sequence = session.first_sequence;
  // Conversion was set up for the bundle that was described: images of another one would be read wrongly.
  auto upscale_callbacks = make_callbacks(
      UpscaleRpc{}, kSuperres, [before = session.model](const auto& opened) { require_same_bundle(before, opened); });

  RemoteStage<ToMeshRpc>::Options to_mesh{
      .stage = "to_mesh", .service = "conversion", .addresses = addresses.conversion, .open = {}, .link = link};
  *to_mesh.open.mutable_open()->mutable_setup() = conversion_setup(session);
  to_mesh.open.mutable_open()->set_window(session.window);
  to_mesh.window = session.window;
  to_mesh.first_sequence = session.first_sequence;
  auto to_mesh_callbacks = make_callbacks(
      ToMeshRpc{}, kToMesh, [check_fine](const v1::ConversionOpened& opened) { check_fine(opened.fine().hash()); });
  stages_.push_back(std::make_unique<RemoteStage<ToImageRpc>>(std::move(to_image), std::move(to_image_callbacks)));
  stages_.push_back(std::make_unique<RemoteStage<UpscaleRpc>>(std::move(upscale), std::move(upscale_callbacks)));
  stages_.push_back(std::make_unique<RemoteStage<ToMeshRpc>>(std::move(to_mesh), std::move(to_mesh_callbacks)));
  if (!session.skip_refinement) {
    RemoteStage<RefineRpc>::Options refine{
        .stage = "refinement", .service = "refinement", .addresses = addresses.refinement, .open = {}, .link = link};
    v1::RefineOpen& open = *refine.open.mutable_open();
    *open.mutable_coarse() = session.coarse;
    if (session.representation.has_subdivision_rounds()) {
      open.set_subdivision_rounds(session.representation.subdivision_rounds());
    }
    open.set_subdivision_rule(session.representation.subdivision_rule());
    *open.mutable_obstacles() = session.obstacles;
    if (session.clearance_m) open.set_clearance_m(*session.clearance_m);
    open.set_window(session.window);
    refine.window = session.window;
    refine.first_sequence = session.first_sequence;
    auto callbacks = make_callbacks(RefineRpc{}, kRefinement,
                                    [check_fine](const v1::RefineOpened& opened) { check_fine(opened.fine_hash()); });
    stages_.push_back(std::make_unique<RemoteStage<RefineRpc>>(std::move(refine), std::move(callbacks)));
  }
  for (const auto& stage : stages_) stage->start();
}

EnhancementPipeline::~EnhancementPipeline() {
  fail(Error(ErrorCode::kCancelled, "the session was given up"));
  // All threads end before any stage is freed: they hand frames from stage to stage.
  for (const auto& stage : stages_) stage->join();
}

void EnhancementPipeline::wait_open() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return failure_ || opened_ == stage_opened_.size(); });
  if (failure_) throw *failure_;
}

bool EnhancementPipeline::push(std::unique_ptr<PipelineFrame> frame) {
  if (failed()) return false;
  if (!frame->error) {
    frame->earlier = earlier_.fill(frame->coarse);
    prepare_.front()(*frame);
  }
  return stages_.front()->push(std::move(frame));
}

void EnhancementPipeline::close() { stages_.front()->close(); }

void EnhancementPipeline::wait() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return failure_ || done_; });
  if (failure_) throw *failure_;
}

void EnhancementPipeline::fail(const Error& cause) {
  {
    const std::lock_guard lock(mutex_);
    if (failure_ || done_) return;
    failure_ = cause;
  }
  changed_.notify_all();
  for (const auto& stage : stages_) stage->stop();
  if (failed_) failed_();
}

bool EnhancementPipeline::failed() const {
  const std::lock_guard lock(mutex_);
  return failure_.has_value();
}

void EnhancementPipeline::hand_on(std::size_t from, std::unique_ptr<PipelineFrame> frame) {
  try {
    const auto size = static_cast<std::size_t>(frame->fine.positions_size());
    if (!frame->error && from >= kToMesh && size != 3 * fine_vertices_) {
      frame->fail(static_cast<int>(grpc::StatusCode::INTERNAL),
                  std::string(from == kToMesh ? "to_mesh" : "refinement") + " answered " + std::to_string(size / 3) +
                      " vertices, expected " + std::to_string(fine_vertices_));
    }
    if (from + 1 < stages_.size()) {
      if (!frame->error) prepare_[from + 1](*frame);
      stages_[from + 1]->push(std::move(frame));
    } else if (!failed()) {
      sink_(std::move(frame));
    }
  } catch (const Error& e) {
    fail(e);
  } catch (const std::exception& e) {
    fail(Error(ErrorCode::kInternal, e.what()));
  }
}

void EnhancementPipeline::stage_drained(std::size_t stage) {
  if (stage + 1 < stages_.size()) {
    stages_[stage + 1]->close();
    return;
  }
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  changed_.notify_all();
}

}  // namespace pleat::coordinator
