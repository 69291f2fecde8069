#include "services/simulation/service.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "common/frame/messages.hpp"
#include "common/rpc/stream.hpp"
#include "common/scene/animation_parts.hpp"
#include "services/simulation/scene_messages.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using testing::HasSubstr;

v1::Scene scene_message(int frames) {
  v1::Scene scene;
  scene.set_name("test");
  *scene.mutable_garment_mesh() = to_message(sheet(4, 4, 0.5, 0.5));
  std::ifstream file("deploy/materials/gray-interlock.json");
  std::ostringstream text;
  text << file.rdbuf();
  scene.set_material_json(text.str());
  scene.set_frames(static_cast<std::uint32_t>(frames));
  scene.add_handles()->add_vertices(0);
  scene.set_perturbation_m(1e-3);
  auto* ball = scene.add_obstacles();
  ball->set_name("ball");
  for (const double v : {0.0, -0.15, 0.0}) ball->mutable_sphere()->add_center(v);
  ball->mutable_sphere()->set_radius(0.1);
  return scene;
}

using Stream = rpc::FrameStream<v1::SimulateRequest, v1::SimulateResponse>;

class ServiceTest : public testing::Test {
 protected:
  ServiceTest() : metrics_("simulation"), service_({.threads = 1, .max_vertices = 100'000}, metrics_) {
    grpc::ServerBuilder builder;
    builder.RegisterService(&service_);
    server_ = builder.BuildAndStart();
    stub_ = v1::Simulation::NewStub(server_->InProcessChannel({}));
  }
  ~ServiceTest() override { server_->Shutdown(std::chrono::system_clock::now() + std::chrono::seconds(5)); }

  std::unique_ptr<Stream> start() {
    rpc::FrameStreamOptions options;
    options.peer = "simulation";
    options.server_driven = true;
    return std::make_unique<Stream>([&](auto* context, auto* call) { stub_->async()->Simulate(context, call); },
                                    options);
  }

  static v1::SimulateRequest open_request(const v1::Scene& scene,
                                          v1::SimulateOpen::Fine fine = v1::SimulateOpen::FINE_NONE) {
    v1::SimulateRequest request;
    *request.mutable_open()->mutable_scene() = scene;
    request.mutable_open()->set_fine(fine);
    request.mutable_open()->set_window(2);
    return request;
  }

  static void acknowledge(Stream& stream, std::uint64_t index) {
    v1::SimulateRequest request;
    request.set_ack_index(index);
    stream.send(request);
  }

  void expect_refused(const v1::SimulateRequest& request, ErrorCode code, const std::string& culprit) {
    const auto stream = start();
    try {
      stream->open(request);
      FAIL() << "accepted: " << culprit;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code) << e.what();
      EXPECT_THAT(e.what(), HasSubstr(culprit));
    }
  }

  telemetry::Metrics metrics_;
  SimulationService service_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<v1::Simulation::Stub> stub_;
};

TEST_F(ServiceTest, StreamsEveryFrameInOrder) {
  const auto stream = start();
  const auto opened = stream->open(open_request(scene_message(6), v1::SimulateOpen::FINE_TRACKED));
  EXPECT_EQ(opened.coarse().rest_positions_size(), 25 * 3);
  EXPECT_EQ(opened.feature_vertices_size(), 25);
  ASSERT_EQ(opened.obstacles_size(), 1);
  EXPECT_EQ(opened.obstacles(0).name(), "ball");
  const Eigen::Index fine_vertices = from_message(opened.fine()).vertex_count();
  v1::SimulateResponse response;
  for (std::uint64_t k = 0; k < 6; ++k) {
    ASSERT_TRUE(stream->pop(&response));
    ASSERT_TRUE(response.has_frame());
    EXPECT_EQ(response.frame().coarse().index(), k);
    EXPECT_NO_THROW(from_message(response.frame().coarse(), 25));
    EXPECT_NO_THROW(from_message(response.frame().fine(), fine_vertices));
    EXPECT_EQ(response.frame().obstacles_size(), 1);
    EXPECT_GE(response.frame().stage_times_size(), 2);
    acknowledge(*stream, k);
  }
  stream->close();
  EXPECT_FALSE(stream->pop(&response));
}

TEST_F(ServiceTest, AnimationsInPartsAreThoseOfTheScene) {
  v1::Scene scene = scene_message(4);
  for (int i = 0; i < 12; ++i) {
    scene.mutable_obstacles(0)->mutable_animation()->add_positions(i % 3 == 1 ? -0.15f + 0.01f * (i / 3) : 0.0f);
  }
  const auto run = [&](Stream& stream) {
    std::string frames;
    v1::SimulateResponse response;
    for (std::uint64_t k = 0; k < 4 && stream.pop(&response); ++k) {
      frames += response.frame().coarse().SerializeAsString() + response.frame().obstacles(0).SerializeAsString();
      acknowledge(stream, k);
    }
    return frames;
  };
  const auto whole = start();
  whole->open(open_request(scene));
  const std::string expected = run(*whole);
  ASSERT_FALSE(expected.empty());

  const auto parts = take_animations(scene, 0);
  const auto stream = start();
  stream->send(open_request(scene));
  v1::SimulateRequest request;
  *request.mutable_animation() = parts.at(0);
  stream->open(request);
  EXPECT_EQ(run(*stream), expected);

  const auto refused = [&](const std::string& culprit, auto change) {
    const auto other = start();
    other->send(open_request(scene));
    v1::SimulateRequest wrong = request;
    change(wrong);
    try {
      other->open(wrong);
      ADD_FAILURE() << "accepted: " << culprit;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument) << e.what();
      EXPECT_THAT(e.what(), HasSubstr(culprit));
    }
  };
  refused("'ball' misses 4 samples", [](auto& wrong) { wrong.set_ack_index(0); });
  refused("more than the 4 samples", [](auto& wrong) {
    for (int i = 0; i < 3; ++i) wrong.mutable_animation()->add_positions(0);
  });
  refused("'bell': no part", [](auto& wrong) { wrong.mutable_animation()->set_obstacle("bell"); });
  refused("is not finite", [](auto& wrong) { wrong.mutable_animation()->set_positions(4, std::nanf("")); });
}

TEST_F(ServiceTest, SendsNoMoreThanTheWindow) {
  const auto stream = start();
  stream->open(open_request(scene_message(50)));
  v1::SimulateResponse response;
  ASSERT_TRUE(stream->pop(&response));
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_EQ(response.frame().coarse().index(), 1u);
  // The third frame waits for an acknowledgement: a reader that looks for it finds nothing until then.
  std::atomic<bool> arrived{false};
  std::thread reader([&] { arrived = stream->pop(&response); });
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_FALSE(arrived);
  acknowledge(*stream, 0);
  reader.join();
  EXPECT_TRUE(arrived);
  EXPECT_EQ(response.frame().coarse().index(), 2u);
  stream->cancel();
}

TEST_F(ServiceTest, ResumesFromACheckpointWithTheSameFrames) {
  std::vector<v1::SimulateResponse> frames(8);
  {
    const auto stream = start();
    auto request = open_request(scene_message(8));
    request.mutable_open()->set_checkpoint_interval(3);
    stream->open(request);
    for (std::uint64_t k = 0; k < 8; ++k) {
      ASSERT_TRUE(stream->pop(&frames[k]));
      EXPECT_EQ(!frames[k].frame().checkpoint().empty(), k % 3 == 2);
      acknowledge(*stream, k);
    }
    stream->close();
  }
  const auto stream = start();
  auto request = open_request(scene_message(8));
  request.mutable_open()->set_checkpoint(frames[5].frame().checkpoint());
  EXPECT_EQ(stream->open(request).next_index(), 6u);
  v1::SimulateResponse response;
  for (std::uint64_t k = 6; k < 8; ++k) {
    ASSERT_TRUE(stream->pop(&response));
    EXPECT_EQ(response.frame().coarse().SerializeAsString(), frames[k].frame().coarse().SerializeAsString());
    acknowledge(*stream, k);
  }
  stream->close();
  request.mutable_open()->set_checkpoint("nonsense");
  expect_refused(request, ErrorCode::kDataLoss, "check-point");
}

TEST_F(ServiceTest, GoesOnServingAfterAClientVanished) {
  {
    const auto stream = start();
    stream->open(open_request(scene_message(1000), v1::SimulateOpen::FINE_TRACKED));
    v1::SimulateResponse response;
    ASSERT_TRUE(stream->pop(&response));
  }  // gone without a word
  const auto stream = start();
  stream->open(open_request(scene_message(1)));
  v1::SimulateResponse response;
  EXPECT_TRUE(stream->pop(&response));
  stream->cancel();
}

TEST_F(ServiceTest, DrainingEndsSessions) {
  const auto stream = start();
  stream->open(open_request(scene_message(1000)));
  service_.drain();
  v1::SimulateResponse response;
  try {
    for (std::uint64_t k = 0; k < 1000; ++k) {
      stream->pop(&response);
      acknowledge(*stream, k);
    }
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnavailable);
  }
}

TEST_F(ServiceTest, RefusesBadScenes) {
  const auto with = [](const std::function<void(v1::SimulateOpen&)>& spoil) {
    auto request = open_request(scene_message(5));
    spoil(*request.mutable_open());
    return request;
  };
  constexpr auto kInvalid = ErrorCode::kInvalidArgument;
  expect_refused(with([](auto& o) { o.mutable_scene()->clear_garment(); }), kInvalid, "garment_mesh");
  expect_refused(with([](auto& o) { o.mutable_scene()->add_garment_layers()->set_faces(4000000000u); }), kInvalid,
                 "has 4000000000 of the 32 faces");
  expect_refused(with([](auto& o) { o.mutable_scene()->set_garment_file("/etc/passwd"); }), kInvalid, "garment_file");
  expect_refused(with([](auto& o) { o.mutable_scene()->set_material_file("x"); }), kInvalid, "material_file");
  expect_refused(with([](auto& o) { o.mutable_scene()->set_material_json("{}"); }), kInvalid, "density");
  expect_refused(with([](auto& o) { o.mutable_scene()->set_frames(0); }), kInvalid, "frames");
  expect_refused(with([](auto& o) { o.mutable_scene()->set_steps_per_frame(4000000000u); }), kInvalid,
                 "steps per frame");
  expect_refused(with([](auto& o) { o.mutable_scene()->set_frame_time_s(-1); }), kInvalid, "frame time");
  expect_refused(with([](auto& o) { o.mutable_scene()->mutable_handles(0)->add_vertices(25); }), kInvalid, "vertex 25");
  expect_refused(with([](auto& o) { o.mutable_scene()->add_gravity(1); }), kInvalid, "gravity");
  expect_refused(with([](auto& o) { o.mutable_scene()->mutable_obstacles(0)->clear_shape(); }), kInvalid, "no shape");
  expect_refused(with([](auto& o) { o.mutable_scene()->mutable_obstacles(0)->mutable_sphere()->set_radius(0.4); }),
                 kInvalid, "ball");
  // An animated obstacle: wrong sizes, and a NaN in the middle of its motion.
  const auto animated = [&](int values, int nan_at) {
    return with([&](auto& o) {
      auto* animation = o.mutable_scene()->mutable_obstacles(0)->mutable_animation();
      for (int i = 0; i < values; ++i) animation->add_positions(i == nan_at ? std::nanf("") : -5.0f);
    });
  };
  expect_refused(animated(9, 7), kInvalid, "obstacle 'ball': sample 2 of the animation is not finite at point 0");
  expect_refused(animated(8, -1), kInvalid, "scene.obstacles[0].animation.positions");
  expect_refused(animated(0, -1), kInvalid, "scene.obstacles[0].animation.positions");
  expect_refused(with([](auto& o) { o.mutable_scene()->mutable_obstacles(0)->mutable_animation()->set_file("a.pc2"); }),
                 kInvalid, "animation.file");
  expect_refused(with([](auto& o) { o.mutable_scene()->mutable_obstacles(0)->mutable_capsules(); }), kInvalid,
                 "capsules");
  expect_refused(with([](auto& o) {
                   auto* capsule = o.mutable_scene()->mutable_obstacles(0)->mutable_capsules()->add_capsules();
                   capsule->set_radius(1);
                 }),
                 kInvalid, "scene.obstacles[0].capsules.capsules[0]: both ends");
  expect_refused(with([](auto& o) { o.mutable_scene()->mutable_placement()->set_angle_deg(3); }), kInvalid, "axis");
  expect_refused(with([](auto& o) { o.set_window(1000); }), kInvalid, "window");
  expect_refused(with([](auto& o) {
                   o.set_fine(v1::SimulateOpen::FINE_FREE);
                   o.mutable_scene()->set_subdivision_rounds(6);
                 }),
                 kInvalid, "subdivision");
  expect_refused(with([](auto& o) {
                   o.set_fine(v1::SimulateOpen::FINE_FREE);
                   o.mutable_scene()->set_subdivision_rounds(5);
                   *o.mutable_scene()->mutable_garment_mesh() = to_message(sheet(20, 20, 1, 1));
                 }),
                 ErrorCode::kResourceExhausted, "limit");
  v1::SimulateRequest no_open;
  no_open.set_ack_index(1);
  expect_refused(no_open, kInvalid, "open");
}

TEST_F(ServiceTest, RefusesBadMaterialsAndServesOn) {
  const auto material = [](const std::function<void(nlohmann::json&)>& spoil) {
    auto json = nlohmann::json::parse(scene_message(3).material_json());
    spoil(json);
    v1::Scene scene = scene_message(3);
    scene.set_material_json(json.dump());
    return open_request(scene);
  };
  constexpr auto kInvalid = ErrorCode::kInvalidArgument;
  expect_refused(material([](auto& m) { m.erase("bending"); }), kInvalid, "key 'bending' is missing");
  expect_refused(material([](auto& m) { m["stretching"].erase(5); }), kInvalid, "stretching must have 6 rows");
  expect_refused(material([](auto& m) { m["bending"][1].push_back(1); }), kInvalid, "bending row 1 must have 5");
  expect_refused(material([](auto& m) { m["density"] = -0.2; }), kInvalid, "density must be positive");
  expect_refused(material([](auto& m) { m["stretching"][2][1] = "stiff"; }), kInvalid, "is not a number");
  const auto isotropic = [](double density, double young, double ratio, double thickness) {
    v1::Scene scene = scene_message(3);
    auto* m = scene.mutable_isotropic();
    m->set_density(density);
    m->set_youngs_modulus(young);
    m->set_poissons_ratio(ratio);
    m->set_thickness(thickness);
    return open_request(scene);
  };
  expect_refused(isotropic(-300, 1e6, 0.3, 5e-4), kInvalid, "scene.isotropic: density");
  expect_refused(isotropic(300, 1e6, 0.7, 5e-4), kInvalid, "scene.isotropic: Poisson's ratio");
  expect_refused(isotropic(300, 1e6, 0.3, 0), kInvalid, "scene.isotropic: thickness");
  const auto stream = start();
  stream->open(isotropic(300, 1e6, 0.3, 5e-4));
  v1::SimulateResponse response;
  EXPECT_TRUE(stream->pop(&response));
  stream->cancel();
}

TEST_F(ServiceTest, UntanglesAStartWhereAsked) {
  v1::Scene scene = scene_message(2);
  scene.mutable_obstacles(0)->mutable_sphere()->set_center(1, -0.06);
  expect_refused(open_request(scene), ErrorCode::kInvalidArgument, "'ball'");
  scene.set_untangle(true);
  const auto stream = start();
  stream->open(open_request(scene));
  v1::SimulateResponse response;
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_EQ(response.frame().coarse().index(), 0u);
  stream->cancel();
}

TEST_F(ServiceTest, SendsWarningsAndGoesOn) {
  v1::Scene scene = scene_message(4);
  scene.clear_obstacles();
  scene.set_handle_stretch_warning(1.0001);  // any load is beyond it
  const auto stream = start();
  stream->open(open_request(scene));
  v1::SimulateResponse response;
  int warnings = 0;
  for (std::uint64_t k = 0; k < 4; ++k) {
    ASSERT_TRUE(stream->pop(&response));
    warnings += response.frame().warnings_size();
    if (response.frame().warnings_size() > 0) {
      EXPECT_THAT(response.frame().warnings(0), HasSubstr("handle 0 stretches"));
    }
    acknowledge(*stream, k);
  }
  EXPECT_EQ(warnings, 1);
  stream->close();
}

TEST(SceneMessages, FillInTheContractsDefaults) {
  const Scene scene = scene_from_message(scene_message(5));
  EXPECT_EQ(scene.frame_time_s, 0.04);
  EXPECT_EQ(scene.steps_per_frame, 8);
  EXPECT_EQ(scene.gravity, Eigen::Vector3d(0, -9.81, 0));
  EXPECT_EQ(scene.wind.density, 1);
  EXPECT_EQ(scene.contact.friction, 0.6);
  EXPECT_EQ(scene.contact.obstacle_friction, 0.3);
  EXPECT_EQ(scene.handles.at(0).stiffness, 1000);
  EXPECT_EQ(scene.tracking.frequency, Tracking::kDefaultFrequency);
  EXPECT_EQ(scene.tracking.spring, 0);
  EXPECT_FALSE(scene.tracking.two_level);
  EXPECT_EQ(scene.subdivision_rounds, 2);
  EXPECT_EQ(scene.subdivision_rule, SubdivisionRule::kMidpoint);
  EXPECT_FALSE(scene.strain_limits.limits());
  EXPECT_FALSE(scene.untangle);
  EXPECT_EQ(scene.handle_stretch_warning, 2);
}

TEST(SceneMessages, BringTheOptions) {
  v1::Scene message = scene_message(5);
  message.mutable_material_options()->set_minimum_stretch(0.9);
  message.mutable_material_options()->set_maximum_stretch(1.1);
  message.set_untangle(true);
  message.set_subdivision_rule(v1::SUBDIVISION_RULE_LOOP);
  message.set_handle_stretch_warning(1.5);
  const Scene scene = scene_from_message(message);
  EXPECT_EQ(scene.strain_limits.minimum, 0.9);
  EXPECT_EQ(scene.strain_limits.maximum, 1.1);
  EXPECT_TRUE(scene.untangle);
  EXPECT_EQ(scene.subdivision_rule, SubdivisionRule::kSmooth);
  EXPECT_EQ(scene.handle_stretch_warning, 1.5);
}

TEST(SceneMessages, ScenesWithSpringsMeanWhatTheyMeant) {
  v1::Scene message = scene_message(5);
  message.mutable_tracking()->set_spring(3);
  Tracking tracking = scene_from_message(message).tracking;
  EXPECT_EQ(tracking.spring, 3);
  EXPECT_TRUE(tracking.two_level);
  EXPECT_EQ(tracking.frequency, 0);
  message.mutable_tracking()->clear_spring();
  message.mutable_tracking()->set_two_level(false);
  tracking = scene_from_message(message).tracking;
  EXPECT_EQ(tracking.spring, 10);
  EXPECT_FALSE(tracking.two_level);
  EXPECT_EQ(tracking.frequency, 0);
  message.mutable_tracking()->set_frequency(20);
  tracking = scene_from_message(message).tracking;
  EXPECT_EQ(tracking.spring, 0);
  EXPECT_EQ(tracking.frequency, 20);
}

TEST(SceneMessages, BringCapsulesAndAnimations) {
  v1::Scene message = scene_message(5);
  auto* capsule = message.mutable_obstacles(0)->mutable_capsules()->add_capsules();
  for (const double v : {0.0, -1.0, 0.0}) capsule->add_a(v);
  for (const double v : {0.0, -2.0, 0.0}) capsule->add_b(v);
  capsule->set_radius(0.25);
  for (int i = 0; i < 12; ++i) message.mutable_obstacles(0)->mutable_animation()->add_positions(static_cast<float>(i));
  const Scene scene = scene_from_message(message);
  const Obstacle& obstacle = scene.obstacles.at(0);
  EXPECT_EQ(obstacle.radius, 0);
  ASSERT_EQ(obstacle.capsules.size(), 1u);
  EXPECT_EQ(obstacle.capsules[0].b, Eigen::Vector3d(0, -2, 0));
  ASSERT_EQ(obstacle.animation.samples.size(), 2u);
  EXPECT_EQ(obstacle.animation.samples[1](1, 2), 11);
  EXPECT_EQ(obstacle.animation.sample_time_s, 0.04);
}

TEST(SceneMessages, TurnDegreesIntoRotations) {
  v1::Scene message = scene_message(5);
  for (const double v : {0.0, 0.0, 5.0}) message.mutable_placement()->add_axis(v);
  message.mutable_placement()->set_angle_deg(180);
  auto* key = message.mutable_handles(0)->add_motion();
  for (const double v : {0.0, 2.0, 0.0}) key->add_axis(v);
  key->set_angle_deg(90);
  message.clear_obstacles();
  const Scene scene = scene_from_message(message);
  EXPECT_NEAR(scene.transform.rotation.z(), 3.141592653589793, 1e-12);
  EXPECT_NEAR(scene.handles.at(0).motion.keys.at(0).rotation.y(), 1.5707963267948966, 1e-12);
}

}  // namespace
}  // namespace pleat::simulation
