// The adapter, over a real channel.
#include "services/refinement/service.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <memory>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/server.hpp"
#include "common/rpc/stream.hpp"
#include "services/refinement/judge.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
namespace {

using Stream = rpc::FrameStream<v1::RefineRequest, v1::RefineResponse>;

class RefinementServer : public testing::Test {
 protected:
  RefinementServer() {
    cloth_.coarse = test::square_sheet(8, 1);
    cloth_.subdivision = subdivide(cloth_.coarse, 2);
    rpc::ServerOptions options;
    options.listen = "unix:" + (folder_.path() / "refinement.sock").string();
    server_ =
        std::make_unique<rpc::Server>(options, std::vector<rpc::HostedService>{{&service_, "pleat.v1.Refinement"}});
    stub_ = v1::Refinement::NewStub(rpc::create_channel(server_->address()));
    *open_.mutable_open()->mutable_coarse() = to_message(cloth_.coarse);
    *open_.mutable_open()->add_obstacles() = to_message(ObstacleShape{"ball", {}});
  }

  std::unique_ptr<Stream> stream() {
    return std::make_unique<Stream>([this](auto* context, auto* call) { stub_->async()->Refine(context, call); },
                                    rpc::FrameStreamOptions{.peer = "refinement"});
  }
  v1::RefineRequest frame(std::uint64_t index, const Positions& fine) const {
    v1::RefineRequest request;
    Frame coarse_frame, fine_frame;
    coarse_frame.index = fine_frame.index = index;
    fine_frame.time_s = 0.5;
    coarse_frame.positions = cloth_.coarse.rest_positions;
    fine_frame.positions = fine;
    *request.mutable_frame()->mutable_coarse() = to_message(coarse_frame);
    *request.mutable_frame()->mutable_fine() = to_message(fine_frame);
    *request.mutable_frame()->add_obstacles() = to_message(ball_);
    return request;
  }
  template <typename Change>
  void expect_refused(ErrorCode code, const Change& change) {
    v1::RefineRequest request = open_;
    change(*request.mutable_open());
    const auto refused = stream();
    try {
      refused->open(request);
      ADD_FAILURE() << "opened";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), code) << error.what();
    }
  }

  const test::TemporaryFolder folder_;
  test::Cloth cloth_;
  ObstacleFrame ball_ = test::sphere("ball", {0.5f, -0.35f, -0.5f}, 0.3f);
  telemetry::Metrics metrics_{"refinement"};
  RefinementService service_{ServiceOptions{}, metrics_};
  std::unique_ptr<rpc::Server> server_;
  std::unique_ptr<v1::Refinement::Stub> stub_;
  v1::RefineRequest open_;
};

TEST_F(RefinementServer, FramesComeBackCleanWithTheirReport) {
  const auto refine = stream();
  EXPECT_EQ(refine->open(open_).fine_hash(), topology_hash(cloth_.fine()));
  const Positions noisy = cloth_.fine().rest_positions + test::noise(cloth_.fine().vertex_count(), 0.02f, 1);
  Positions dented = cloth_.fine().rest_positions;
  dented.col(1).array() -= 0.08f;
  std::uint64_t index = 40;
  for (const Positions& fine : {cloth_.fine().rest_positions, noisy, dented}) {
    refine->push(frame(++index, fine));
    v1::RefineResponse response;
    ASSERT_TRUE(refine->pop(&response));
    ASSERT_TRUE(response.has_frame()) << response.error().message();
    EXPECT_EQ(response.frame().fine().index(), index);
    EXPECT_EQ(response.frame().fine().time_s(), 0.5);
    const Positions result = positions_from_message(response.frame().fine());
    const v1::RefinementReport& report = response.frame().report();
    const std::vector<ObstacleFrame> balls{ball_};
    EXPECT_EQ(report.self_intersections_before(), count_self_intersections(fine, cloth_.fine().faces));
    EXPECT_EQ(report.penetrations_before(), count_penetrations(fine, cloth_.fine().faces, {}, balls));
    EXPECT_EQ(report.self_intersections_after(), 0u);
    EXPECT_EQ(report.penetrations_after(), 0u);
    EXPECT_EQ(count_self_intersections(result, cloth_.fine().faces), 0u);
    EXPECT_EQ(count_penetrations(result, cloth_.fine().faces, {}, balls), 0u);
    EXPECT_FALSE(report.input_intersects());
    ASSERT_EQ(response.frame().stage_times_size(), 1);
    EXPECT_EQ(response.frame().stage_times(0).stage(), "refinement");
  }
}

TEST_F(RefinementServer, AJudgeCountsAndChangesNothing) {
  open_.mutable_open()->set_judge_only(true);
  const auto judge = stream();
  EXPECT_EQ(judge->open(open_).fine_hash(), topology_hash(cloth_.fine()));
  Positions dented = cloth_.fine().rest_positions + test::noise(cloth_.fine().vertex_count(), 0.02f, 1);
  dented.col(1).array() -= 0.08f;
  judge->push(frame(3, dented));
  v1::RefineResponse response;
  ASSERT_TRUE(judge->pop(&response));
  ASSERT_TRUE(response.has_frame()) << response.error().message();
  EXPECT_EQ(positions_from_message(response.frame().fine()), dented);
  const v1::RefinementReport& report = response.frame().report();
  EXPECT_GT(report.self_intersections_after(), 0u);
  EXPECT_EQ(report.self_intersections_after(), count_self_intersections(dented, cloth_.fine().faces));
  EXPECT_GT(report.penetrations_after(), 0u);
  EXPECT_EQ(report.penetrations_after(),
            count_penetrations(dented, cloth_.fine().faces, {}, std::vector<ObstacleFrame>{ball_}));
  EXPECT_FALSE(report.input_intersects());

  v1::RefineRequest folded = frame(4, dented);
  v1::Frame& coarse = *folded.mutable_frame()->mutable_coarse();
  coarse.set_positions(3 * 40 + 1, -0.2f);  // the middle, down into the ball
  judge->push(folded);
  ASSERT_TRUE(judge->pop(&response));
  EXPECT_TRUE(response.frame().report().input_intersects());
}

TEST_F(RefinementServer, CapsuleSetsAreObstacles) {
  ObstacleFrame limbs;
  limbs.name = "limbs";
  limbs.capsule_ends.resize(4, 3);
  limbs.capsule_ends << 0.1f, -0.15f, -0.5f, 0.6f, -0.15f, -0.5f, 0.6f, -0.15f, -0.5f, 0.7f, -0.4f, -0.2f;
  limbs.capsule_radii = {0.1f, 0.08f};
  open_.mutable_open()->clear_obstacles();
  *open_.mutable_open()->add_obstacles() = to_message(ObstacleShape{"limbs", {}, 2});
  const auto refine = stream();
  refine->open(open_);
  Positions dented = cloth_.fine().rest_positions;
  dented.col(1).array() -= 0.09f;
  v1::RefineRequest request = frame(0, dented);
  *request.mutable_frame()->mutable_obstacles(0) = to_message(limbs);
  refine->push(request);
  v1::RefineResponse response;
  ASSERT_TRUE(refine->pop(&response));
  ASSERT_TRUE(response.has_frame()) << response.error().message();
  EXPECT_GT(response.frame().report().penetrations_before(), 0u);
  EXPECT_EQ(response.frame().report().penetrations_after(), 0u);
  const Positions result = positions_from_message(response.frame().fine());
  EXPECT_EQ(count_penetrations(result, cloth_.fine().faces, {}, std::vector{limbs}), 0u);

  request.mutable_frame()->mutable_obstacles(0)->set_capsule_radii(0, -1);
  refine->push(request);
  ASSERT_TRUE(refine->pop(&response));
  EXPECT_TRUE(response.has_error());
}

TEST_F(RefinementServer, ABadFrameIsAnsweredAndTheStreamGoesOn) {
  const auto refine = stream();
  refine->open(open_);
  const Positions& fine = cloth_.fine().rest_positions;
  v1::RefineRequest few = frame(1, fine.topRows(5)), infinite = frame(2, fine), unknown = frame(3, fine),
                    mixed = frame(4, fine);
  infinite.mutable_frame()->mutable_fine()->set_positions(0, std::numeric_limits<float>::quiet_NaN());
  unknown.mutable_frame()->mutable_obstacles(0)->set_name("wall");
  mixed.mutable_frame()->mutable_fine()->set_index(9);
  v1::RefineResponse response;
  for (const auto* request : {&few, &infinite, &unknown, &mixed}) {
    refine->push(*request);
    ASSERT_TRUE(refine->pop(&response));
    ASSERT_TRUE(response.has_error());
    EXPECT_EQ(response.error().index(), request->frame().coarse().index());
    EXPECT_EQ(response.error().code(), static_cast<int>(grpc::StatusCode::INVALID_ARGUMENT));
  }
  refine->push(frame(5, fine));
  ASSERT_TRUE(refine->pop(&response));
  EXPECT_TRUE(response.has_frame());
}

TEST_F(RefinementServer, BadOpensAreRefused) {
  expect_refused(ErrorCode::kInvalidArgument, [](v1::RefineOpen& o) { o.clear_coarse(); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::RefineOpen& o) { o.set_clearance_m(-1); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::RefineOpen& o) { o.set_subdivision_rounds(7); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::RefineOpen& o) { o.set_window(1000); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::RefineOpen& o) { o.mutable_obstacles(0)->clear_name(); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::RefineOpen& o) { *o.add_obstacles() = o.obstacles(0); });
  expect_refused(ErrorCode::kFailedPrecondition, [](v1::RefineOpen& o) { *o.mutable_fine() = o.coarse(); });
  EXPECT_NO_THROW(stream()->open(open_));
}

}  // namespace
}  // namespace pleat::refinement
