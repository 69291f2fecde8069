#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "common/rpc/channel.hpp"
#include "common/scene/animation_parts.hpp"
#include "services/coordinator/simulation_source.hpp"
#include "tests/support/fake_stages.hpp"

namespace pleat::coordinator {
namespace {

using namespace std::chrono_literals;
using testing::Faults;

class SimulationSourceTest : public ::testing::Test {
 protected:
  SimulationSource::Options options(std::uint32_t frames) {
    SimulationSource::Options made{.addresses = {fakes_.simulation().address()},
                                   .scene = testing::fake_scene(frames),
                                   .checkpoint_interval = 5,
                                   .checkpoint = {},
                                   .link = {}};
    made.link.connect = [](const std::string& address) { return rpc::create_channel(address); };
    made.link.give_up = 1500ms;
    made.link.open_timeout = 5s;
    made.link.answer_timeout = 300ms;
    return made;
  }

  void run(SimulationSource& source) {
    source.open();
    source.run([&](v1::SimulatedFrame& frame) {
      indices_.push_back(frame.coarse().index());
      const v1::Frame expected = testing::fake_coarse_frame(testing::sheet(), frame.coarse().index());
      EXPECT_EQ(frame.coarse().SerializeAsString(), expected.SerializeAsString());
      return true;
    });
  }

  void expect_indices(std::uint64_t first, std::uint64_t end) {
    ASSERT_EQ(indices_.size(), end - first);
    for (std::uint64_t i = first; i < end; ++i) EXPECT_EQ(indices_[i - first], i);
  }

  testing::FakeStages fakes_;
  std::vector<std::uint64_t> indices_;
};

TEST_F(SimulationSourceTest, GivesEveryFrame) {
  SimulationSource source(options(17));
  run(source);
  expect_indices(0, 17);
}

TEST_F(SimulationSourceTest, FaultsAreInvisible) {
  fakes_.simulation().faults.at(3, Faults::Kind::kBreak, 2);
  fakes_.simulation().faults.at(11, Faults::Kind::kBreak);
  fakes_.simulation().faults.at(14, Faults::Kind::kHang);
  SimulationSource source(options(20));
  run(source);
  expect_indices(0, 20);
  EXPECT_EQ(fakes_.simulation().opened, 5);
  // From the start each time it would be at least 20 + 3 + 3 + 11 + 14.
  EXPECT_LT(fakes_.simulation().frames, 45) << "it goes on at the check-point, not at the start";
}

TEST_F(SimulationSourceTest, AnimationsInPartsAreSentAgainAfterAFault) {
  SimulationSource::Options animated = options(12);
  v1::Obstacle& ball = *animated.scene.add_obstacles();
  ball.set_name("ball");
  ball.mutable_sphere()->set_radius(1);
  for (int i = 0; i < 3 * 400'000; ++i) ball.mutable_animation()->add_positions(0);
  animated.animations = std::make_shared<const std::vector<v1::AnimationPart>>(take_animations(animated.scene, 0));
  const int parts = static_cast<int>(animated.animations->size());
  ASSERT_EQ(parts, 2);
  fakes_.simulation().faults.at(7, Faults::Kind::kBreak);
  SimulationSource source(animated);
  run(source);
  expect_indices(0, 12);
  EXPECT_EQ(fakes_.simulation().parts, 2 * parts);
}

TEST_F(SimulationSourceTest, StartsAtACheckpoint) {
  std::string checkpoint;
  {
    SimulationSource source(options(12));
    source.open();
    source.run([&](v1::SimulatedFrame& frame) {
      if (frame.coarse().index() == 4) checkpoint = frame.checkpoint();
      return frame.coarse().index() < 5;
    });
  }
  ASSERT_FALSE(checkpoint.empty());
  SimulationSource::Options from_there = options(12);
  from_there.checkpoint = checkpoint;
  SimulationSource source(from_there);
  run(source);
  expect_indices(5, 12);
}

TEST_F(SimulationSourceTest, AFrameThatAlwaysKillsTheServiceEndsTheJobWithItsName) {
  fakes_.simulation().faults.at(7, Faults::Kind::kBreak, 1'000'000);
  SimulationSource source(options(12));
  try {
    run(source);
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnavailable);
    EXPECT_NE(std::string(e.what()).find("simulation at " + fakes_.simulation().address()), std::string::npos);
  }
  // A break may overtake a frame or two that were sent before it.
  ASSERT_LE(indices_.size(), 7U);
  expect_indices(0, indices_.size());
}

TEST_F(SimulationSourceTest, AnotherReplicaTakesOver) {
  SimulationSource::Options two = options(12);
  two.addresses.insert(two.addresses.begin(), "unix:" + (fakes_.folder() / "nobody").string());
  SimulationSource source(two);
  run(source);
  expect_indices(0, 12);
}

TEST_F(SimulationSourceTest, ABadSceneIsTheClientsFault) {
  SimulationSource::Options bad = options(12);
  bad.scene.add_gravity(1);
  SimulationSource source(bad);
  try {
    source.open();
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_NE(std::string(e.what()).find("scene.gravity"), std::string::npos);
  }
}

TEST_F(SimulationSourceTest, AFrameThatCantBeSimulatedEndsTheRun) {
  fakes_.simulation().faults.at(2, Faults::Kind::kFrameError);
  SimulationSource source(options(12));
  EXPECT_THROW(run(source), Error);
  expect_indices(0, 2);
}

TEST_F(SimulationSourceTest, CancelEndsAWait) {
  fakes_.simulation().faults.at(2, Faults::Kind::kHang);
  SimulationSource::Options patient = options(12);
  patient.link.answer_timeout = 60s;
  SimulationSource source(patient);
  std::jthread canceller([&] {
    while (fakes_.simulation().frames < 2) std::this_thread::sleep_for(1ms);
    source.cancel();
  });
  try {
    run(source);
    ADD_FAILURE();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kCancelled);
  }
  canceller.join();
}

TEST_F(SimulationSourceTest, ATakerThatHasEnoughEndsTheRun) {
  SimulationSource source(options(1000));
  source.open();
  int taken = 0;
  source.run([&](v1::SimulatedFrame&) { return ++taken < 4; });
  EXPECT_EQ(taken, 4);
}

}  // namespace
}  // namespace pleat::coordinator
