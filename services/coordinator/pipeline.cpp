#include "services/coordinator/pipeline.hpp"

#include <algorithm>
#include <utility>

#include "common/frame/representation_messages.hpp"
#include "common/mesh/mesh.hpp"
#include "common/telemetry/stage_timer.hpp"
#include "pleat/v1/conversion.grpc.pb.h"
#include "pleat/v1/refinement.grpc.pb.h"
#include "pleat/v1/superres.grpc.pb.h"
#include "services/coordinator/fold_stage.hpp"

namespace pleat::coordinator {
namespace {

struct ToImageRpc {
  using Service = v1::Conversion;
  using Request = v1::ToImageRequest;
  using Response = v1::ToImageResponse;
  static constexpr bool kFineMesh = false;
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
  static std::shared_ptr<Request> request_of(PipelineFrame& frame) {
    auto work = std::make_shared<Request>();
    work->mutable_frame()->Swap(&frame.coarse);
    work->mutable_frame()->set_index(frame.sequence);
    for (const auto& earlier : frame.earlier) *work->add_earlier() = *earlier;
    frame.earlier.clear();
    return work;
  }
  static void prepare(PipelineFrame& frame) { frame.work = request_of(frame); }
};

/// Of a network that reads where obstacles are; the stages to come want them, too.
struct ToImageAmongObstaclesRpc : ToImageRpc {
  static void prepare(PipelineFrame& frame) {
    auto work = request_of(frame);
    *work->mutable_obstacles() = frame.obstacles;
    frame.work = std::move(work);
  }
};

struct UpscaleRpc {
  using Service = v1::SuperResolution;
  using Request = v1::UpscaleRequest;
  using Response = v1::UpscaleResponse;
  static constexpr bool kFineMesh = false;
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

/// Of a network that remembers: frames one after the other.
struct RememberingUpscaleRpc : UpscaleRpc {
  using Memory = NetworkMemory;
  static void absorb(PipelineFrame& frame, v1::ImageFrame& answer) {
    auto memory = std::make_shared<Memory>();
    memory->sequence = frame.sequence;
    memory->state.swap(*answer.mutable_state());
    answer.clear_state();
    frame.network_memory = std::move(memory);
    UpscaleRpc::absorb(frame, answer);
  }
  static std::shared_ptr<const Memory> memory_of(const PipelineFrame& frame) { return frame.network_memory; }
  /// As FoldRpc's. The request's index is the frame's place in the session.
  static std::shared_ptr<const google::protobuf::Message> resumed(
      std::shared_ptr<const google::protobuf::Message> request, const Memory& memory) {
    const auto& first = static_cast<const Request&>(*request);
    if (memory.sequence + 1 != first.frame().index()) return request;
    auto with_state = std::make_shared<Request>(first);
    with_state->mutable_frame()->set_state(memory.state);
    return with_state;
  }
};

struct ToMeshRpc {
  using Service = v1::Conversion;
  using Request = v1::ToMeshRequest;
  using Response = v1::ToMeshResponse;
  static constexpr bool kFineMesh = true;
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
  static constexpr bool kFineMesh = true;
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

bool reads_obstacles(const PipelineSession& session) { return session.representation.vertex_features().obstacles(); }

template <typename Rpc>
typename RemoteStage<Rpc>::Options to_image_options(const ServiceAddresses& addresses, const LinkOptions& link,
                                                    const PipelineSession& session) {
  typename RemoteStage<Rpc>::Options options{
      .stage = "to_image", .service = "conversion", .addresses = addresses.conversion, .open = {}, .link = link};
  *options.open.mutable_open()->mutable_setup() = conversion_setup(session);
  options.open.mutable_open()->set_dtype(session.conversion.dtype());
  if (reads_obstacles(session)) *options.open.mutable_open()->mutable_obstacles() = session.obstacles;
  return options;
}

template <typename Rpc>
typename RemoteStage<Rpc>::Options upscale_options(const ServiceAddresses& addresses, const LinkOptions& link,
                                                   const PipelineSession& session) {
  typename RemoteStage<Rpc>::Options options{
      .stage = "superres", .service = "superres", .addresses = addresses.superres, .open = {}, .link = link};
  v1::UpscaleOpen& open = *options.open.mutable_open();
  open.set_model(session.model.model());
  open.set_topology_hash(session.network_coarse.value_or(session.coarse).hash());
  open.set_displacement_only(true);
  open.set_dtype(session.conversion.dtype());
  if (session.conversion.has_constants()) *open.mutable_constants() = session.conversion.constants();
  return options;
}

RemoteStage<ToMeshRpc>::Options to_mesh_options(const ServiceAddresses& addresses, const LinkOptions& link,
                                                const PipelineSession& session) {
  RemoteStage<ToMeshRpc>::Options options{
      .stage = "to_mesh", .service = "conversion", .addresses = addresses.conversion, .open = {}, .link = link};
  *options.open.mutable_open()->mutable_setup() = conversion_setup(session);
  return options;
}

/// Mesh and obstacles, as the services have them that know both meshes.
template <typename Open>
void set_meshes(const PipelineSession& session, Open* open) {
  *open->mutable_coarse() = session.coarse;
  if (session.representation.has_subdivision_rounds()) {
    open->set_subdivision_rounds(session.representation.subdivision_rounds());
  }
  open->set_subdivision_rule(session.representation.subdivision_rule());
  *open->mutable_obstacles() = session.obstacles;
  if (session.clearance_m) open->set_clearance_m(*session.clearance_m);
}

RemoteStage<FoldRpc>::Options fold_options(const ServiceAddresses& addresses, const LinkOptions& link,
                                           const PipelineSession& session) {
  RemoteStage<FoldRpc>::Options options{
      .stage = "fold", .service = "fold", .addresses = addresses.fold, .open = {}, .link = link};
  options.turn = session.fold_turn;
  *options.open.mutable_open() = session.fold;
  set_meshes(session, options.open.mutable_open());
  options.memory = session.fold_memory;
  return options;
}

RemoteStage<RefineRpc>::Options refine_options(const ServiceAddresses& addresses, const LinkOptions& link,
                                               const PipelineSession& session) {
  RemoteStage<RefineRpc>::Options options{
      .stage = "refinement", .service = "refinement", .addresses = addresses.refinement, .open = {}, .link = link};
  set_meshes(session, options.open.mutable_open());
  options.open.mutable_open()->set_judge_only(is_simulated(session.detail));
  return options;
}

/// The fine mesh of a frame that has no other detail, and the time that it took.
void upsample_smoothly(const SmoothUpsampling& upsampling, PipelineFrame& frame) {
  const telemetry::StageTimer timer;
  const auto& coarse = frame.coarse.positions();
  const Positions fine = upsampling(Eigen::Map<const Positions>(coarse.data(), coarse.size() / 3, 3));
  frame.fine.mutable_positions()->Assign(fine.data(), fine.data() + fine.size());
  v1::StageTime& time = *frame.stage_times.Add();
  time.set_stage("upsampling");
  time.set_ms(timer.milliseconds());
}

}  // namespace

EnhancementPipeline::EnhancementPipeline(const ServiceAddresses& addresses, const LinkOptions& link,
                                         const PipelineSession& session, std::size_t fine_vertices,
                                         const std::string& fine_hash, Sink sink, std::function<void()> failed)
    : sink_(std::move(sink)),
      failed_(std::move(failed)),
      fine_vertices_(fine_vertices),
      earlier_(session.representation.window(), session.representation.window_stride()),
      upsampling_(session.upsampling) {
  for (const v1::Frame& frame : session.earlier) earlier_.fill(frame);
  const auto check_fine = [fine_hash](const std::string& hash) { check_fine_hash(hash, fine_hash); };
  if (uses_network(session.detail)) {
    const auto opened = [](const auto&) {};
    if (reads_obstacles(session)) {
      add_stage<ToImageAmongObstaclesRpc>(to_image_options<ToImageAmongObstaclesRpc>(addresses, link, session), session,
                                          opened);
    } else {
      add_stage<ToImageRpc>(to_image_options<ToImageRpc>(addresses, link, session), session, opened);
    }
    // Conversion was set up for the bundle that was described: images of another one would be read wrongly.
    const auto same_bundle = [before = session.model](const auto& opened) { require_same_bundle(before, opened); };
    if (network_remembers(session)) {
      auto options = upscale_options<RememberingUpscaleRpc>(addresses, link, session);
      options.memory = session.network_memory;
      add_stage<RememberingUpscaleRpc>(std::move(options), session, same_bundle);
    } else {
      add_stage<UpscaleRpc>(upscale_options<UpscaleRpc>(addresses, link, session), session, same_bundle);
    }
    // It knows the mesh in the bundle's place where the session has it elsewhere.
    const std::string known = session.network_coarse ? session.conversion.fine().hash() : fine_hash;
    add_stage<ToMeshRpc>(to_mesh_options(addresses, link, session), session,
                         [known](const auto& opened) { check_fine_hash(opened.fine().hash(), known); });
  }
  if (uses_fold(session.detail)) {
    add_stage<FoldRpc>(fold_options(addresses, link, session), session,
                       [check_fine](const auto& opened) { check_fine(opened.fine_hash()); });
  }
  if (!session.skip_refinement) {
    add_stage<RefineRpc>(refine_options(addresses, link, session), session,
                         [check_fine](const auto& opened) { check_fine(opened.fine_hash()); });
  }
  if (stages_.empty()) throw_invalid_argument("skip_refinement: goes with what makes detail");
  stage_opened_.assign(stages_.size(), false);
  for (const auto& stage : stages_) stage->start();
}

template <typename Rpc, typename Opened>
void EnhancementPipeline::add_stage(typename RemoteStage<Rpc>::Options options, const PipelineSession& session,
                                    Opened opened) {
  const std::size_t stage = stages_.size();
  options.open.mutable_open()->set_window(session.window);
  options.window = session.window;
  options.first_sequence = session.first_sequence;
  kinds_.push_back({options.stage, Rpc::kFineMesh, Rpc::prepare});
  typename RemoteStage<Rpc>::Callbacks callbacks;
  callbacks.opened = [this, stage, opened = std::move(opened)](const auto& answer) {
    opened(answer);
    stage_is_open(stage);
  };
  callbacks.deliver = [this, stage](std::unique_ptr<PipelineFrame> frame) { hand_on(stage, std::move(frame)); };
  callbacks.drained = [this, stage] { stage_drained(stage); };
  callbacks.failed = [this](const Error& cause) { fail(cause); };
  stages_.push_back(std::make_unique<RemoteStage<Rpc>>(std::move(options), std::move(callbacks)));
}

void EnhancementPipeline::stage_is_open(std::size_t stage) {
  const std::lock_guard lock(mutex_);
  if (stage_opened_[stage]) return;
  stage_opened_[stage] = true;
  ++opened_;
  changed_.notify_all();
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
    if (upsampling_ != nullptr) upsample_smoothly(*upsampling_, *frame);
    kinds_.front().prepare(*frame);
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
    if (!frame->error && kinds_[from].makes_fine_mesh && size != 3 * fine_vertices_) {
      frame->fail(static_cast<int>(grpc::StatusCode::INTERNAL), kinds_[from].name + " answered " +
                                                                    std::to_string(size / 3) + " vertices, expected " +
                                                                    std::to_string(fine_vertices_));
    }
    if (from + 1 < stages_.size()) {
      if (!frame->error) kinds_[from + 1].prepare(*frame);
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
