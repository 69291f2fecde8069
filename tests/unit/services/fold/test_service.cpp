// The adapter, over a real channel.
#include "services/fold/service.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <memory>

#include "common/base/error.hpp"
#include "common/features/frame_features.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/server.hpp"
#include "common/rpc/stream.hpp"
#include "services/fold/default_material.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

using Stream = rpc::FrameStream<v1::FoldRequest, v1::FoldResponse>;

class FoldServer : public testing::Test {
 protected:
  FoldServer() : coarse_(simulation::sheet(6, 6, 0.5, 0.5)), subdivision_(subdivide(coarse_, 2)) {
    rpc::ServerOptions options;
    options.listen = "unix:" + (folder_.path() / "fold.sock").string();
    server_ = std::make_unique<rpc::Server>(options, std::vector<rpc::HostedService>{{&service_, "pleat.v1.Fold"}});
    stub_ = v1::Fold::NewStub(rpc::create_channel(server_->address()));
    *open_.mutable_open()->mutable_coarse() = to_message(coarse_);
    *open_.mutable_open()->add_obstacles() = to_message(ObstacleShape{"ball", {}});
  }

  std::unique_ptr<Stream> stream() {
    return std::make_unique<Stream>([this](auto* context, auto* call) { stub_->async()->Fold(context, call); },
                                    rpc::FrameStreamOptions{.peer = "fold"});
  }
  /// A sheet that is squeezed and swings.
  Positions coarse_at(std::uint64_t k) const {
    Positions positions = coarse_.rest_positions;
    const float t = 0.04F * static_cast<float>(k);
    positions.col(0) *= 1 - 0.5F * std::min(t, 0.2F);
    for (Eigen::Index v = 0; v < positions.rows(); ++v) {
      positions(v, 1) += 0.1F * std::sin(3 * t) + 2e-3F * std::sin(40 * positions(v, 0) + 9 * positions(v, 2));
    }
    return positions;
  }
  v1::FoldRequest frame(std::uint64_t index) const {
    Frame coarse;
    coarse.index = index;
    coarse.time_s = 0.04 * static_cast<double>(index);
    coarse.positions = coarse_at(index);
    coarse.velocities = backward_velocities(coarse.positions, index > 0 ? coarse_at(index - 1) : Positions(), 0.04);
    v1::FoldRequest request;
    *request.mutable_frame()->mutable_coarse() = to_message(coarse);
    v1::ObstacleFrame& ball = *request.mutable_frame()->add_obstacles();
    ball.set_name("ball");
    ball.set_radius(0.1F);
    for (const float value : {0.25F, -0.6F, 0.25F}) ball.add_center(value);
    return request;
  }
  v1::FoldResponse answer(Stream& fold, const v1::FoldRequest& request) {
    fold.push(request);
    v1::FoldResponse response;
    EXPECT_TRUE(fold.pop(&response));
    return response;
  }
  v1::FoldedFrame folded(Stream& fold, const v1::FoldRequest& request) {
    const v1::FoldResponse response = answer(fold, request);
    EXPECT_TRUE(response.has_frame()) << response.error().message();
    return response.frame();
  }
  template <typename Change>
  void expect_refused(ErrorCode code, const std::string& words, const Change& change) {
    v1::FoldRequest request = open_;
    change(*request.mutable_open());
    const auto refused = stream();
    try {
      refused->open(request);
      ADD_FAILURE() << "opened; expected " << words;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), code) << error.what();
      EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    }
  }

  const test::TemporaryFolder folder_;
  Topology coarse_;
  Subdivision subdivision_;
  telemetry::Metrics metrics_{"fold"};
  FoldService service_{ServiceOptions{.max_vertices = 2000}, metrics_};
  std::unique_ptr<rpc::Server> server_;
  std::unique_ptr<v1::Fold::Stub> stub_;
  v1::FoldRequest open_;
};

TEST_F(FoldServer, FramesAreThoseOfTheLibrary) {
  FoldOptions options;
  options.material = simulation::parse_material(default_material_json(), "default");
  options.gravity = {0, -5, 0};
  options.frequency = 12;
  const std::vector<ObstacleShape> shapes{{"ball", {}}};
  FoldStep step(coarse_, subdivision_, shapes, options);
  FoldState state;
  for (const double value : {0.0, -5.0, 0.0}) open_.mutable_open()->add_gravity(value);
  open_.mutable_open()->mutable_settings()->set_frequency(12);
  v1::Handle& handle = *open_.mutable_open()->add_handles();
  handle.add_vertices(0);
  handle.set_end_s(0.1);
  const auto fold = stream();
  EXPECT_EQ(fold->open(open_).fine_hash(), topology_hash(subdivision_.fine));
  for (std::uint64_t k = 0; k < 6; ++k) {
    const v1::FoldRequest request = frame(k);
    const v1::FoldedFrame response = folded(*fold, request);
    const Frame coarse = from_message(request.frame().coarse());
    const std::vector<ObstacleFrame> balls{from_message(request.frame().obstacles(0))};
    const std::vector<std::uint32_t> held = k < 3 ? std::vector<std::uint32_t>{0} : std::vector<std::uint32_t>{};
    const FoldReport report = step.fold(
        {.coarse = coarse.positions, .coarse_velocities = coarse.velocities, .obstacles = balls, .held = held}, state);
    EXPECT_EQ(response.index(), k);
    EXPECT_EQ(response.time_s(), request.frame().coarse().time_s());
    EXPECT_EQ(positions_from_message(response.state().positions(), -1, "positions"), state.positions) << k;
    EXPECT_EQ(positions_from_message(response.state().velocities(), -1, "velocities"), state.velocities) << k;
    EXPECT_EQ(response.report().steps(), static_cast<std::uint32_t>(report.steps));
    EXPECT_EQ(response.report().obstacle_contacts(), report.obstacle_contacts);
    EXPECT_EQ(response.report().restarted(), k == 0);
    EXPECT_EQ(response.stage_times(response.stage_times_size() - 1).stage(), "fold");
  }
  EXPECT_NE(metrics_.text().find("pleat_fold_restarts_total{service=\"fold\"} 1"), std::string::npos)
      << metrics_.text();
}

TEST_F(FoldServer, AStreamThatIsOpenedAgainGoesOnWithTheStateAndTheSameBits) {
  std::vector<v1::FoldedFrame> calm;
  const auto fold = stream();
  fold->open(open_);
  for (std::uint64_t k = 0; k < 7; ++k) calm.push_back(folded(*fold, frame(k)));
  const auto again = stream();
  again->open(open_);
  v1::FoldRequest first = frame(4);
  *first.mutable_frame()->mutable_state() = calm[3].state();
  EXPECT_EQ(folded(*again, first).state().SerializeAsString(), calm[4].state().SerializeAsString());
  for (std::uint64_t k = 5; k < 7; ++k) {
    const v1::FoldedFrame response = folded(*again, frame(k));
    EXPECT_FALSE(response.report().restarted());
    EXPECT_EQ(response.state().SerializeAsString(), calm[k].state().SerializeAsString()) << k;
  }
}

TEST_F(FoldServer, AFrameThatFollowsNoneBeginsAnew) {
  const auto fold = stream();
  fold->open(open_);
  EXPECT_TRUE(folded(*fold, frame(0)).report().restarted());
  EXPECT_FALSE(folded(*fold, frame(1)).report().restarted());
  const v1::FoldedFrame behind_a_gap = folded(*fold, frame(3));
  EXPECT_TRUE(behind_a_gap.report().restarted());
  const auto fresh = stream();
  fresh->open(open_);
  EXPECT_EQ(folded(*fresh, frame(3)).state().SerializeAsString(), behind_a_gap.state().SerializeAsString());
}

TEST_F(FoldServer, ABadFrameIsAnsweredAndTheStreamGoesOnFromTheOneBefore) {
  const auto fold = stream();
  fold->open(open_);
  folded(*fold, frame(0));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  v1::FoldRequest few = frame(1), infinite = frame(1), unknown = frame(1), still = frame(1), start = frame(1),
                  state = frame(1);
  few.mutable_frame()->mutable_coarse()->mutable_positions()->Truncate(30);
  infinite.mutable_frame()->mutable_coarse()->set_velocities(4, nan);
  unknown.mutable_frame()->mutable_obstacles(0)->set_name("wall");
  still.mutable_frame()->mutable_coarse()->clear_velocities();
  start.mutable_frame()->mutable_start()->Resize(12, 0);
  state.mutable_frame()->mutable_state()->mutable_positions()->Resize(
      static_cast<int>(3 * subdivision_.fine.vertex_count()), nan);
  state.mutable_frame()->mutable_state()->mutable_velocities()->Resize(3, 0);
  for (const auto* request : {&few, &infinite, &unknown, &still, &start, &state}) {
    const v1::FoldResponse response = answer(*fold, *request);
    ASSERT_TRUE(response.has_error());
    EXPECT_EQ(response.error().index(), 1U);
    EXPECT_EQ(response.error().code(), static_cast<int>(grpc::StatusCode::INVALID_ARGUMENT));
  }
  EXPECT_FALSE(folded(*fold, frame(1)).report().restarted());
}

TEST_F(FoldServer, BadOpensAreRefused) {
  const auto invalid = ErrorCode::kInvalidArgument;
  expect_refused(invalid, "open.coarse", [](v1::FoldOpen& o) { o.clear_coarse(); });
  expect_refused(invalid, "open.coarse", [](v1::FoldOpen& o) {
    o.mutable_coarse()->clear_uv();
    o.mutable_coarse()->clear_uv_faces();
    o.mutable_coarse()->clear_hash();
  });
  expect_refused(invalid, "gravity", [](v1::FoldOpen& o) { o.add_gravity(1); });
  expect_refused(invalid, "frame time", [](v1::FoldOpen& o) { o.set_frame_time_s(-1); });
  expect_refused(invalid, "open.material.json", [](v1::FoldOpen& o) { o.mutable_material()->set_json("{}"); });
  expect_refused(invalid, "open.material.options.density_scale",
                 [](v1::FoldOpen& o) { o.mutable_material()->mutable_options()->set_density_scale(0); });
  expect_refused(invalid, "open.handles[0].vertices: vertex 900",
                 [](v1::FoldOpen& o) { o.add_handles()->add_vertices(900); });
  expect_refused(invalid, "1000 steps a frame", [](v1::FoldOpen& o) { o.mutable_settings()->set_step_s(3e-5); });
  expect_refused(invalid, "1000 steps a frame", [](v1::FoldOpen& o) { o.set_frame_time_s(9); });
  expect_refused(invalid, "open.wind.velocity", [](v1::FoldOpen& o) { o.mutable_wind()->add_velocity(9); });
  expect_refused(invalid, "frequency", [](v1::FoldOpen& o) { o.mutable_settings()->set_frequency(51); });
  expect_refused(invalid, "window", [](v1::FoldOpen& o) { o.set_window(1000); });
  expect_refused(invalid, "ball", [](v1::FoldOpen& o) { *o.add_obstacles() = o.obstacles(0); });
  expect_refused(ErrorCode::kResourceExhausted, "fine vertices, more than this service's limit of 2000",
                 [](v1::FoldOpen& o) { o.set_subdivision_rounds(4); });
  EXPECT_NO_THROW(stream()->open(open_));
}

}  // namespace
}  // namespace pleat::fold
