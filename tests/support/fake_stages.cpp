#include "tests/support/fake_stages.hpp"

#include <cmath>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <thread>
#include <type_traits>
#include <utility>

#include "common/rpc/channel.hpp"
#include "common/rpc/stream.hpp"
#include "common/scene/animation_parts.hpp"
#include "pleat/v1/conversion.grpc.pb.h"
#include "pleat/v1/fold.grpc.pb.h"
#include "pleat/v1/refinement.grpc.pb.h"
#include "pleat/v1/simulation.grpc.pb.h"
#include "pleat/v1/superres.grpc.pb.h"

namespace pleat::testing {
namespace {

constexpr float kVelocityFactor = 0.01F;
constexpr float kMemoryFactor = 0.001F;
constexpr float kEarlierFactor = 0.125F;
constexpr float kRefinementOffset = 0.001F;
constexpr float kFoldOffset = 0.0625F;

Topology from_wire(const v1::Topology& message) {
  Topology topology;
  topology.rest_positions =
      Eigen::Map<const Positions>(message.rest_positions().data(), message.rest_positions_size() / 3, 3);
  topology.faces = Eigen::Map<const Faces>(message.faces().data(), message.faces_size() / 3, 3);
  topology.uv = Eigen::Map<const Uv>(message.uv().data(), message.uv_size() / 2, 2);
  topology.uv_faces = Eigen::Map<const Faces>(message.uv_faces().data(), message.uv_faces_size() / 3, 3);
  return topology;
}

template <typename Matrix>
void set(google::protobuf::RepeatedField<float>* field, const Matrix& values) {
  field->Assign(values.data(), values.data() + values.size());
}

void add_time(google::protobuf::RepeatedPtrField<v1::StageTime>* times, const char* stage, double ms) {
  v1::StageTime& time = *times->Add();
  time.set_stage(stage);
  time.set_ms(ms);
}

/// What earlier frames add to the newest, each with a weight of its own.
template <typename Frames>
void add_earlier(const Frames& earlier, google::protobuf::RepeatedField<float>* positions) {
  float weight = 0;
  for (const v1::Frame& frame : earlier) {
    weight += kEarlierFactor;
    for (int i = 0; i < positions->size(); ++i) *positions->Mutable(i) += weight * frame.positions(i);
  }
}

/// The stream of a stage: one answer per frame, with the faults in between.
template <typename Response, typename Request, typename Open, typename Process>
grpc::Status serve(FakeService& fake, grpc::ServerContext* context, grpc::ServerReaderWriter<Response, Request>* stream,
                   Open open, Process process) {
  struct Count {
    explicit Count(std::atomic<int>& count) : count_(count) { ++count_; }
    ~Count() { --count_; }
    std::atomic<int>& count_;
  } const count(fake.sessions);
  Request request;
  if (!stream->Read(&request)) return grpc::Status::OK;
  if (const grpc::Status refusal = fake.faults.next_open(); !refusal.ok()) return refusal;
  ++fake.opened;
  Response response;
  open(request.open(), *response.mutable_opened());
  stream->Write(response);
  while (stream->Read(&request)) {
    const std::uint64_t index = rpc::frame_index(request.frame());
    std::this_thread::sleep_for(fake.faults.delay());
    response.Clear();
    const auto answer = [&](std::uint64_t as) {
      if constexpr (std::is_invocable_v<Process, const Request&, std::uint64_t, decltype(*response.mutable_frame())>) {
        process(request, as, *response.mutable_frame());
      } else {
        process(request.frame(), as, *response.mutable_frame());
      }
    };
    switch (fake.faults.next(index)) {
      case Faults::Kind::kBreak:
        return grpc::Status(grpc::StatusCode::UNAVAILABLE, "a fault, on purpose");
      case Faults::Kind::kHang:
        while (!context->IsCancelled()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
        return grpc::Status(grpc::StatusCode::CANCELLED, "hung");
      case Faults::Kind::kFrameError:
        response.mutable_error()->set_index(index);
        response.mutable_error()->set_code(3);
        response.mutable_error()->set_message("a bad frame, on purpose");
        break;
      case Faults::Kind::kWrongIndex:
        answer(index + 1000);
        break;
      case Faults::Kind::kWrongSize:
        answer(index);
        if constexpr (requires { response.mutable_frame()->mutable_fine(); }) {
          response.mutable_frame()->mutable_fine()->mutable_positions()->Truncate(3);
        } else if constexpr (requires { response.mutable_frame()->mutable_state()->mutable_positions(); }) {
          response.mutable_frame()->mutable_state()->mutable_positions()->Truncate(3);
        }
        break;
      case Faults::Kind::kNone:
        answer(index);
        break;
    }
    if (!stream->Write(response)) break;
    ++fake.frames;
  }
  return grpc::Status::OK;
}

class FakeSimulation final : public FakeService, public v1::Simulation::Service {
 public:
  explicit FakeSimulation(std::string address) : FakeService(std::move(address)) {}

  grpc::Status Simulate(grpc::ServerContext* context,
                        grpc::ServerReaderWriter<v1::SimulateResponse, v1::SimulateRequest>* stream) override {
    ++sessions;
    const grpc::Status status = simulate(context, stream);
    --sessions;
    return status;
  }

 private:
  grpc::Status simulate(grpc::ServerContext* context,
                        grpc::ServerReaderWriter<v1::SimulateResponse, v1::SimulateRequest>* stream) {
    v1::SimulateRequest request;
    if (!stream->Read(&request)) return grpc::Status::OK;
    if (const grpc::Status refusal = faults.next_open(); !refusal.ok()) return refusal;
    v1::SimulateOpen open = request.open();
    AnimationAssembly assembly(*open.mutable_scene(), "scene");
    for (; !assembly.complete(); ++parts) {
      if (!stream->Read(&request)) return {grpc::StatusCode::INVALID_ARGUMENT, assembly.describe_missing()};
      assembly.add(request.animation());
    }
    if (open.scene().gravity_size() == 1) return {grpc::StatusCode::INVALID_ARGUMENT, "scene.gravity: 1 value, not 3"};
    ++opened;
    const Topology coarse = from_wire(open.scene().garment_mesh());
    const Subdivision subdivision = subdivide(coarse, 2);
    bool warned = false;
    std::uint64_t index = 0;
    if (open.checkpoint().size() == sizeof index) {
      std::memcpy(&index, open.checkpoint().data(), sizeof index);
      ++index;
    }
    v1::SimulateResponse response;
    *response.mutable_opened()->mutable_coarse() = open.scene().garment_mesh();
    for (const auto& obstacle : open.scene().obstacles()) {
      response.mutable_opened()->add_obstacles()->set_name(obstacle.name());
    }
    response.mutable_opened()->set_next_index(index);
    stream->Write(response);
    rpc::PacedWriter<v1::SimulateRequest, v1::SimulateResponse> writer(context, stream, open.window(), index);
    for (; index < open.scene().frames(); ++index) {
      std::this_thread::sleep_for(faults.delay());
      while (faults.holds(index) && !writer.stopped()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      response.Clear();
      v1::SimulatedFrame& frame = *response.mutable_frame();
      switch (faults.next(index)) {
        case Faults::Kind::kBreak:
          return {grpc::StatusCode::UNAVAILABLE, "a fault, on purpose"};
        case Faults::Kind::kHang:
          while (!writer.stopped()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
          return grpc::Status::OK;
        case Faults::Kind::kFrameError:
          response.mutable_error()->set_index(index);
          response.mutable_error()->set_message("exploded, on purpose");
          break;
        default:
          *frame.mutable_coarse() = fake_coarse_frame(coarse, index);
          if (open.fine() != v1::SimulateOpen::FINE_NONE) {
            set(frame.mutable_fine()->mutable_positions(), fake_enhanced(subdivision, coarse.faces, frame.coarse()));
          }
          for (const auto& obstacle : open.scene().obstacles()) {
            v1::ObstacleFrame& sphere = *frame.add_obstacles();
            sphere.set_name(obstacle.name());
            for (int axis = 0; axis < 3; ++axis) sphere.add_center(0.1F * static_cast<float>(index));
            sphere.set_radius(0.5F);
          }
          add_time(frame.mutable_stage_times(), "simulation", 1.5);
          if (frame.has_fine()) add_time(frame.mutable_stage_times(), "simulation.fine", 2.5);
          // In frame 3, and by a session that begins after it as well.
          if (!std::exchange(warned, index >= 3) && index >= 3) frame.add_warnings("doubtful, on purpose");
          if (open.checkpoint_interval() != 0 && (index + 1) % open.checkpoint_interval() == 0) {
            frame.set_checkpoint(&index, sizeof index);
          }
      }
      if (!writer.write(index, response)) return grpc::Status::OK;
      ++frames;
    }
    writer.close();
    return grpc::Status::OK;
  }

  std::vector<grpc::Service*> services() override { return {static_cast<v1::Simulation::Service*>(this)}; }
};

class FakeConversion final : public FakeService, public v1::Conversion::Service {
 public:
  explicit FakeConversion(std::string address) : FakeService(std::move(address)) {}

  grpc::Status Describe(grpc::ServerContext*, const v1::ConversionSetup* setup,
                        v1::ConversionOpened* opened_message) override {
    const Subdivision subdivision = fine_of(*setup);
    *opened_message->mutable_fine() = to_wire(subdivision.fine);
    opened_message->mutable_fine()->set_hash(topology_hash(subdivision.fine));
    return grpc::Status::OK;
  }

  grpc::Status ToImage(grpc::ServerContext* context,
                       grpc::ServerReaderWriter<v1::ToImageResponse, v1::ToImageRequest>* stream) override {
    return serve(
        *this, context, stream, [](const v1::ToImageOpen&, v1::ConversionOpened&) {},
        [](const v1::ToImageRequest& request, std::uint64_t index, v1::ImageFrame& image) {
          const v1::Frame& frame = request.frame();
          image.set_index(index);
          image.set_time_s(frame.time_s());
          auto* values = image.mutable_image()->mutable_values();
          *values = frame.positions();
          add_earlier(request.earlier(), values);
          values->MergeFrom(frame.velocities());
          image.mutable_image()->add_shape(static_cast<std::uint32_t>(values->size()));
          for (int axis = 0; axis < 3; ++axis) image.mutable_alignment()->add_translation(frame.positions(0));
          add_time(image.mutable_stage_times(), "to_image", 0.25);
        });
  }

  grpc::Status ToMesh(grpc::ServerContext* context,
                      grpc::ServerReaderWriter<v1::ToMeshResponse, v1::ToMeshRequest>* stream) override {
    Topology coarse;
    Subdivision subdivision;
    return serve(
        *this, context, stream,
        [&](const v1::ToMeshOpen& open, v1::ConversionOpened& opened_message) {
          coarse = from_wire(open.setup().coarse());
          subdivision = fine_of(open.setup());
          opened_message.mutable_fine()->set_hash(topology_hash(subdivision.fine));
        },
        [&](const v1::ImageFrame& image, std::uint64_t index, v1::MeshFrame& mesh) {
          const auto& values = image.image().values();
          const Eigen::Map<const Positions> positions(values.data(), values.size() / 3, 3);
          mesh.mutable_fine()->set_index(index);
          mesh.mutable_fine()->set_time_s(image.time_s());
          // Without the frame's own alignment the mesh is displaced, and a test sees it.
          Positions fine = upsample(subdivision, coarse.faces, positions);
          const float lost = image.alignment().translation_size() == 3 ? 0.0F : 1.0F;
          fine.array() += lost;
          set(mesh.mutable_fine()->mutable_positions(), fine);
          add_time(mesh.mutable_stage_times(), "to_mesh", 0.5);
        });
  }

 private:
  static Subdivision fine_of(const v1::ConversionSetup& setup) {
    const v1::Representation& r = setup.representation();
    return subdivide(from_wire(setup.coarse()),
                     r.has_subdivision_rounds() ? static_cast<int>(r.subdivision_rounds()) : kDefaultSubdivisionRounds);
  }

  std::vector<grpc::Service*> services() override { return {static_cast<v1::Conversion::Service*>(this)}; }
};

/// A bundle that remembers (state_values 1) counts the frames since it began anew, and shows it in every position.
class FakeSuperResolution final : public FakeService, public v1::SuperResolution::Service {
 public:
  FakeSuperResolution(std::string address, const FakeBundle& bundle)
      : FakeService(std::move(address)), bundle_(bundle) {}

  grpc::Status DescribeModel(grpc::ServerContext*, const v1::DescribeModelRequest* request,
                             v1::ModelDescription* description) override {
    if (!request->model().empty() && request->model() != "fake") {
      return {grpc::StatusCode::NOT_FOUND, "no bundle '" + request->model() + "'"};
    }
    *description = bundle_.describe();
    return grpc::Status::OK;
  }

  grpc::Status Upscale(grpc::ServerContext* context,
                       grpc::ServerReaderWriter<v1::UpscaleResponse, v1::UpscaleRequest>* stream) override {
    float since = 0;
    std::optional<std::uint64_t> last;
    const bool remembers = bundle_.describe().state_values() > 0;
    return serve(
        *this, context, stream,
        [this](const v1::UpscaleOpen&, v1::ModelDescription& model) { model = bundle_.describe(); },
        [&, remembers](const v1::ImageFrame& coarse, std::uint64_t index, v1::ImageFrame& fine) {
          fine.set_index(index);
          fine.set_time_s(coarse.time_s());
          const auto& values = coarse.image().values();
          const int half = values.size() / 2;
          if (remembers) {
            const bool goes_on = !coarse.state().empty() || (last && *last + 1 == index);
            if (coarse.state().size() == sizeof since) std::memcpy(&since, coarse.state().data(), sizeof since);
            since = goes_on ? since + 1 : 1;
            last = index;
            fine.set_state(std::string(reinterpret_cast<const char*>(&since), sizeof since));
          }
          for (int i = 0; i < half; ++i) {
            fine.mutable_image()->add_values(values.Get(i) + kVelocityFactor * values.Get(half + i) +
                                             (remembers ? kMemoryFactor * since : 0.0F));
          }
          add_time(fine.mutable_stage_times(), "superres", 6);
        });
  }

 private:
  std::vector<grpc::Service*> services() override { return {static_cast<v1::SuperResolution::Service*>(this)}; }

  const FakeBundle& bundle_;
};

/// Its state counts the frames since the cloth began anew, in every velocity.
class FakeFold final : public FakeService, public v1::Fold::Service {
 public:
  explicit FakeFold(std::string address) : FakeService(std::move(address)) {}

  grpc::Status Fold(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::FoldResponse, v1::FoldRequest>* stream) override {
    Topology coarse;
    Subdivision subdivision;
    float since = 0;
    std::optional<std::uint64_t> last;
    return serve(
        *this, context, stream,
        [&](const v1::FoldOpen& open, v1::FoldOpened& opened_message) {
          coarse = from_wire(open.coarse());
          subdivision = subdivide(coarse, open.has_subdivision_rounds() ? static_cast<int>(open.subdivision_rounds())
                                                                        : kDefaultSubdivisionRounds);
          opened_message.set_fine_hash(topology_hash(subdivision.fine));
        },
        [&](const v1::FoldFrame& frame, std::uint64_t index, v1::FoldedFrame& folded) {
          const bool goes_on = frame.has_state() || (last && *last + 1 == index);
          if (frame.has_state()) since = frame.state().velocities(0);
          since = goes_on ? since + 1 : 1;
          last = index;
          const auto& values = frame.start().empty() ? frame.coarse().positions() : frame.start();
          Positions fine = Eigen::Map<const Positions>(values.data(), values.size() / 3, 3);
          if (frame.start().empty()) fine = upsample(subdivision, coarse.faces, fine);
          fine.array() += kFoldOffset * since;
          folded.set_index(index);
          folded.set_time_s(frame.coarse().time_s());
          set(folded.mutable_state()->mutable_positions(), fine);
          folded.mutable_state()->mutable_velocities()->Resize(static_cast<int>(fine.size()), since);
          folded.mutable_report()->set_steps(7);
          folded.mutable_report()->set_restarted(!goes_on);
          add_time(folded.mutable_stage_times(), "fold", 3);
        });
  }

 private:
  std::vector<grpc::Service*> services() override { return {static_cast<v1::Fold::Service*>(this)}; }
};

class FakeRefinement final : public FakeService, public v1::Refinement::Service {
 public:
  explicit FakeRefinement(std::string address) : FakeService(std::move(address)) {}

  grpc::Status Refine(grpc::ServerContext* context,
                      grpc::ServerReaderWriter<v1::RefineResponse, v1::RefineRequest>* stream) override {
    bool judges = false;
    return serve(
        *this, context, stream, [&](const v1::RefineOpen& open, v1::RefineOpened&) { judges = open.judge_only(); },
        [&](const v1::RefineFrame& frame, std::uint64_t index, v1::RefinedFrame& refined) {
          *refined.mutable_fine() = frame.fine();
          refined.mutable_fine()->set_index(index);
          for (float& value : *refined.mutable_fine()->mutable_positions()) value += judges ? 0 : kRefinementOffset;
          refined.mutable_report()->set_self_intersections_before(2);
          refined.mutable_report()->set_penetrations_after(index == 3 ? 1 : 0);
          refined.mutable_report()->set_zones(static_cast<std::uint32_t>(frame.obstacles_size()));
          add_time(refined.mutable_stage_times(), "refinement", 4);
        });
  }

 private:
  std::vector<grpc::Service*> services() override { return {static_cast<v1::Refinement::Service*>(this)}; }
};

}  // namespace

void Faults::at(std::uint64_t index, Kind kind, int times) {
  const std::lock_guard lock(mutex_);
  at_[index] = {kind, times};
}

void Faults::refuse(grpc::Status status, int times) {
  const std::lock_guard lock(mutex_);
  refusal_ = std::move(status);
  refusals_ = times;
}

Faults::Kind Faults::next(std::uint64_t index) {
  const std::lock_guard lock(mutex_);
  const auto found = at_.find(index);
  if (found == at_.end() || found->second.second == 0) return Kind::kNone;
  --found->second.second;
  return found->second.first;
}

grpc::Status Faults::next_open() {
  const std::lock_guard lock(mutex_);
  if (refusals_ == 0) return grpc::Status::OK;
  --refusals_;
  return refusal_;
}

FakeBundle::FakeBundle() {
  description_.set_model("fake");
  description_.mutable_representation()->mutable_geometry_image()->set_scale(4);
  description_.set_device("cpu");
  description_.set_precision("float32");
}

v1::ModelDescription FakeBundle::describe() const {
  const std::lock_guard lock(mutex_);
  return description_;
}

void FakeBundle::replace(const std::function<void(v1::ModelDescription&)>& change) {
  const std::lock_guard lock(mutex_);
  change(description_);
}

void FakeService::start() {
  grpc::ServerBuilder builder;
  builder.AddListeningPort(address_, grpc::InsecureServerCredentials());
  builder.SetMaxReceiveMessageSize(rpc::kMaxMessageBytes);
  for (grpc::Service* service : services()) builder.RegisterService(service);
  server_ = builder.BuildAndStart();
  if (!server_) throw std::runtime_error("can't listen at " + address_);
}

void FakeService::stop() {
  if (server_) server_->Shutdown(std::chrono::system_clock::now());
  server_.reset();
}

FakeStages::FakeStages() {
  const std::string socket = "unix:" + folder_.path().string() + "/";
  simulation_ = std::make_unique<FakeSimulation>(socket + "simulation");
  conversion_ = std::make_unique<FakeConversion>(socket + "conversion");
  superres_ = std::make_unique<FakeSuperResolution>(socket + "superres", bundle_);
  refinement_ = std::make_unique<FakeRefinement>(socket + "refinement");
  fold_ = std::make_unique<FakeFold>(socket + "fold");
  for (FakeService* fake : all()) fake->start();
}

FakeStages::~FakeStages() {
  for (FakeService* fake : all()) fake->stop();
}

FakeService& FakeStages::add_superres() {
  more_.push_back(std::make_unique<FakeSuperResolution>(
      "unix:" + folder_.path().string() + "/superres" + std::to_string(more_.size() + 1), bundle_));
  more_.back()->start();
  return *more_.back();
}

FakeService& FakeStages::add_fold() {
  more_.push_back(
      std::make_unique<FakeFold>("unix:" + folder_.path().string() + "/fold" + std::to_string(more_.size() + 1)));
  more_.back()->start();
  return *more_.back();
}

std::vector<FakeService*> FakeStages::all() {
  std::vector<FakeService*> fakes{simulation_.get(), conversion_.get(), superres_.get(), refinement_.get(),
                                  fold_.get()};
  for (const auto& fake : more_) fakes.push_back(fake.get());
  return fakes;
}

Topology sheet(int columns, int rows) {
  Topology topology;
  const int count = (columns + 1) * (rows + 1);
  topology.rest_positions.resize(count, 3);
  topology.uv.resize(count, 2);
  for (int row = 0; row <= rows; ++row) {
    for (int column = 0; column <= columns; ++column) {
      const int v = row * (columns + 1) + column;
      topology.uv.row(v) << 0.1F * static_cast<float>(column), 0.1F * static_cast<float>(row);
      topology.rest_positions.row(v) << topology.uv(v, 0), 1.0F, -topology.uv(v, 1);
    }
  }
  topology.faces.resize(2 * columns * rows, 3);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const auto a = static_cast<std::uint32_t>(row * (columns + 1) + column);
      const auto b = a + 1;
      const auto c = a + static_cast<std::uint32_t>(columns) + 1;
      const int face = 2 * (row * columns + column);
      topology.faces.row(face) << a, b, c + 1;
      topology.faces.row(face + 1) << a, c + 1, c;
    }
  }
  topology.uv_faces = topology.faces;
  return topology;
}

v1::Topology to_wire(const Topology& topology) {
  v1::Topology message;
  set(message.mutable_rest_positions(), topology.rest_positions);
  set(message.mutable_uv(), topology.uv);
  message.mutable_faces()->Assign(topology.faces.data(), topology.faces.data() + topology.faces.size());
  message.mutable_uv_faces()->Assign(topology.uv_faces.data(), topology.uv_faces.data() + topology.uv_faces.size());
  return message;
}

v1::Scene fake_scene(std::uint32_t frames, const std::string& name) {
  v1::Scene scene;
  scene.set_name(name);
  *scene.mutable_garment_mesh() = to_wire(sheet());
  scene.set_material_json("{}");
  scene.set_frames(frames);
  v1::Obstacle& ball = *scene.add_obstacles();
  ball.set_name("ball");
  ball.mutable_sphere()->set_radius(0.5);
  return scene;
}

v1::Frame fake_coarse_frame(const Topology& coarse, std::uint64_t index, double frame_time_s) {
  const auto positions_at = [&](std::uint64_t k) {
    Positions positions = coarse.rest_positions;
    for (Eigen::Index v = 0; v < positions.rows(); ++v) {
      const double phase = 0.3 * static_cast<double>(k) + 0.7 * static_cast<double>(v);
      positions(v, 1) += static_cast<float>(0.05 * std::sin(phase));
    }
    return positions;
  };
  v1::Frame frame;
  frame.set_index(index);
  frame.set_time_s(static_cast<double>(index) * frame_time_s);
  const Positions now = positions_at(index);
  set(frame.mutable_positions(), now);
  const Positions before = index == 0 ? now : positions_at(index - 1);
  for (Eigen::Index i = 0; i < now.size(); ++i) {
    frame.add_velocities(static_cast<float>(
        (static_cast<double>(now.data()[i]) - static_cast<double>(before.data()[i])) / frame_time_s));
  }
  return frame;
}

Positions fake_folded(const Subdivision& subdivision, const Faces& coarse_faces, const v1::Frame& coarse,
                      std::uint64_t since, bool refined) {
  const auto& values = coarse.positions();
  Positions fine =
      upsample(subdivision, coarse_faces, Eigen::Map<const Positions>(values.data(), values.size() / 3, 3));
  fine.array() += kFoldOffset * static_cast<float>(since);
  if (refined) fine.array() += kRefinementOffset;
  return fine;
}

Positions fake_enhanced(const Subdivision& subdivision, const Faces& coarse_faces, const v1::Frame& coarse,
                        bool refined, const std::vector<v1::Frame>& earlier) {
  auto values = coarse.positions();
  add_earlier(earlier, &values);
  Positions positions = Eigen::Map<const Positions>(values.data(), values.size() / 3, 3);
  for (Eigen::Index i = 0; i < positions.size(); ++i) {
    positions.data()[i] = positions.data()[i] + kVelocityFactor * coarse.velocities(static_cast<int>(i));
  }
  Positions fine = upsample(subdivision, coarse_faces, positions);
  if (refined) fine.array() += kRefinementOffset;
  return fine;
}

}  // namespace pleat::testing
