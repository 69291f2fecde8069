#include "common/frame/messages.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include <Eigen/Geometry>

#include "common/base/error.hpp"

namespace pleat {
namespace {

Topology square() {
  Topology topology;
  topology.rest_positions.resize(4, 3);
  topology.rest_positions << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0;
  topology.faces.resize(2, 3);
  topology.faces << 0, 1, 2, 0, 2, 3;
  topology.uv = topology.rest_positions.leftCols(2);
  topology.uv_faces = topology.faces;
  return topology;
}

Frame sample_frame() {
  Frame frame;
  frame.index = 1ull << 40;
  frame.time_s = 0.12;
  frame.positions = square().rest_positions * 2.5f;
  frame.velocities = square().rest_positions * -1.0f;
  return frame;
}

void expect_refused(const std::function<void()>& action, const std::string& field,
                    ErrorCode code = ErrorCode::kInvalidArgument) {
  try {
    action();
    ADD_FAILURE() << field << " was accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), code) << error.what();
    EXPECT_EQ(std::string(error.what()).find(field), 0u) << error.what() << " should begin with " << field;
  }
}

TEST(Messages, TopologyRoundTrip) {
  const Topology topology = square();
  const v1::Topology message = to_message(topology);
  EXPECT_EQ(message.hash(), topology_hash(topology));
  const Topology back = from_message(message);
  EXPECT_EQ(back.rest_positions, topology.rest_positions);
  EXPECT_EQ(back.faces, topology.faces);
  EXPECT_EQ(back.uv, topology.uv);
  EXPECT_EQ(back.uv_faces, topology.uv_faces);
}

TEST(Messages, TopologyIsChecked) {
  const v1::Topology good = to_message(square());
  const auto refused = [&](const std::function<void(v1::Topology&)>& spoil, const std::string& field) {
    v1::Topology bad = good;
    bad.clear_hash();
    spoil(bad);
    expect_refused([&] { from_message(bad, "open.coarse"); }, field);
  };
  refused([](auto& m) { m.add_rest_positions(1); }, "open.coarse.rest_positions");
  refused([](auto& m) { m.clear_rest_positions(); }, "open.coarse.rest_positions");
  refused([](auto& m) { m.set_rest_positions(4, std::nanf("")); }, "open.coarse");
  refused([](auto& m) { m.set_faces(0, 4); }, "open.coarse");
  refused([](auto& m) { m.clear_faces(); }, "open.coarse.faces");
  refused([](auto& m) { m.add_faces(1); }, "open.coarse.faces");
  refused([](auto& m) { m.set_uv_faces(5, 77); }, "open.coarse");
  refused([](auto& m) { m.add_uv(0); }, "open.coarse.uv");
  refused([](auto& m) { m.set_hash("0123456789abcdef"); }, "open.coarse.hash");
}

TEST(Messages, FrameRoundTrip) {
  const Frame frame = sample_frame();
  v1::Frame message;
  to_message(frame, &message);
  to_message(frame, &message);  // a reused message must not grow
  const Frame back = from_message(message, 4);
  EXPECT_EQ(back.index, frame.index);
  EXPECT_EQ(back.time_s, frame.time_s);
  EXPECT_EQ(back.positions, frame.positions);
  EXPECT_EQ(back.velocities, frame.velocities);
  EXPECT_EQ(positions_from_message(message), frame.positions);
  message.clear_velocities();
  EXPECT_EQ(from_message(message).velocities.rows(), 0);
}

TEST(Messages, FrameIsChecked) {
  const v1::Frame good = to_message(sample_frame());
  const auto refused = [&](const std::function<void(v1::Frame&)>& spoil, const std::string& field) {
    v1::Frame bad = good;
    spoil(bad);
    expect_refused([&] { from_message(bad, 4, "coarse"); }, field);
  };
  refused([](auto& m) { m.mutable_positions()->Truncate(9); }, "coarse.positions");
  refused([](auto& m) { m.mutable_velocities()->Truncate(9); }, "coarse.velocities");
  refused([](auto& m) { m.set_positions(11, std::numeric_limits<float>::infinity()); }, "coarse.positions");
  refused([](auto& m) { m.set_velocities(0, std::nanf("")); }, "coarse.velocities");
  refused([](auto& m) { m.set_time_s(std::nan("")); }, "coarse.time_s");
}

TEST(Messages, ObstaclesRoundTripInTheSessionsOrder) {
  ObstacleFrame sphere, mesh;
  sphere.name = "ball";
  sphere.center << 1, 2, 3;
  sphere.radius = 0.5f;
  mesh.name = "table";
  mesh.positions = square().rest_positions;
  const std::vector<ObstacleShape> shapes = {{"table", square().faces}, {"ball", {}}};
  google::protobuf::RepeatedPtrField<v1::ObstacleFrame> messages;
  *messages.Add() = to_message(sphere);
  *messages.Add() = to_message(mesh);
  const auto frames = obstacles_from_messages(messages, shapes);
  ASSERT_EQ(frames.size(), 2u);
  EXPECT_EQ(frames[0].name, "table");
  EXPECT_EQ(frames[0].positions, mesh.positions);
  EXPECT_EQ(frames[1].center, sphere.center);
  EXPECT_EQ(frames[1].radius, sphere.radius);
  EXPECT_EQ(from_message(to_message(shapes[0])).faces, shapes[0].faces);

  auto fewer = messages;
  fewer.RemoveLast();
  expect_refused([&] { obstacles_from_messages(fewer, shapes); }, "obstacles");
  auto renamed = messages;
  renamed[0].set_name("other");
  expect_refused([&] { obstacles_from_messages(renamed, shapes); }, "obstacles");
  auto exchanged = messages;
  exchanged[0].set_name("table");
  exchanged[1].set_name("ball");
  expect_refused([&] { obstacles_from_messages(exchanged, shapes); }, "obstacles");
  auto short_mesh = messages;
  short_mesh[1].mutable_positions()->Truncate(9);
  expect_refused([&] { obstacles_from_messages(short_mesh, shapes); }, "obstacles");
  auto flat = messages;
  flat[0].set_radius(-1);
  expect_refused([&] { obstacles_from_messages(flat, shapes); }, "obstacles[0].radius");
}

TEST(Messages, CapsuleSetsRoundTrip) {
  ObstacleFrame limbs;
  limbs.name = "limbs";
  limbs.capsule_ends = square().rest_positions;  // 4 ends
  limbs.capsule_radii = {0.5f, 0.25f};
  const std::vector<ObstacleShape> shapes = {{"limbs", {}, 2}};
  EXPECT_EQ(from_message(to_message(shapes[0])).capsules, 2u);
  google::protobuf::RepeatedPtrField<v1::ObstacleFrame> messages;
  *messages.Add() = to_message(limbs);
  const auto frames = obstacles_from_messages(messages, shapes);
  ASSERT_EQ(frames.size(), 1u);
  EXPECT_EQ(frames[0].capsule_ends, limbs.capsule_ends);
  EXPECT_EQ(frames[0].capsule_radii, limbs.capsule_radii);
  EXPECT_EQ(frames[0].radius, 0);

  const auto refused = [&](const std::function<void(v1::ObstacleFrame&)>& spoil, const std::string& field) {
    auto bad = messages;
    spoil(bad[0]);
    expect_refused([&] { obstacles_from_messages(bad, shapes); }, field);
  };
  refused([](auto& m) { m.mutable_capsule_ends()->Truncate(9); }, "obstacles[0].capsule_ends");
  refused([](auto& m) { m.clear_capsule_ends(); }, "obstacles[0].capsule_ends");
  refused([](auto& m) { m.set_capsule_ends(3, std::nanf("")); }, "obstacles[0].capsule_ends");
  refused([](auto& m) { m.set_capsule_radii(1, 0); }, "obstacles[0].capsule_radii");
  refused([](auto& m) { m.set_capsule_radii(0, std::nanf("")); }, "obstacles[0].capsule_radii");
  refused([](auto& m) { m.set_radius(1); }, "obstacles[0] 'limbs': either");
  refused(
      [](auto& m) {
        m.mutable_capsule_ends()->Truncate(6);
        m.mutable_capsule_radii()->Truncate(1);
      },
      "obstacles: 'limbs' has 1 capsules instead of 2");
  expect_refused([&] { obstacles_from_messages(messages, {{"limbs", {}, 0}}); }, "obstacles: 'limbs' is a sphere");
  expect_refused(
      [&] {
        obstacles_from_messages(messages, {{"limbs", square().faces, 0}});
      },
      "obstacles: 'limbs' is a mesh");
  v1::ObstacleShape both = to_message(ObstacleShape{"limbs", square().faces, 0});
  both.set_capsules(3);
  expect_refused([&] { from_message(both); }, "obstacle 'limbs': either capsules or faces");
}

TEST(Messages, RigidTransformRoundTrip) {
  RigidTransform transform;
  transform.rotation = Eigen::AngleAxisf(0.7f, Eigen::Vector3f(1, 2, -1).normalized()).toRotationMatrix();
  transform.translation << 4, 5, 6;
  v1::RigidTransform message = to_message(transform);
  EXPECT_EQ(message.rotation(1), transform.rotation(0, 1)) << "row-major";
  EXPECT_EQ(from_message(message).rotation, transform.rotation);
  EXPECT_EQ(from_message(message).translation, transform.translation);
  message.set_rotation(0, 3);
  expect_refused([&] { from_message(message); }, "alignment.rotation");
}

TEST(Messages, TensorRoundTrip) {
  const Tensor tensor{{2, 1, 3}, {"a", "b"}, {1, -2, 3.5f, 0, 5, 6}};
  const Tensor back = from_message(to_message(tensor));
  EXPECT_EQ(back.shape, tensor.shape);
  EXPECT_EQ(back.channels, tensor.channels);
  EXPECT_EQ(back.values, tensor.values);
}

TEST(Messages, HalfPrecisionTensors) {
  v1::Tensor message;
  message.add_shape(5);
  message.set_dtype(v1::Tensor::DTYPE_FLOAT16);
  // 1, -2, 0.5, the smallest subnormal 2^-24, the largest 65504
  message.set_data(std::string("\x00\x3c\x00\xc0\x00\x38\x01\x00\xff\x7b", 10));
  EXPECT_EQ(from_message(message).values, (std::vector<float>{1, -2, 0.5f, std::ldexp(1.0f, -24), 65504}));
  message.set_dtype(v1::Tensor::DTYPE_BFLOAT16);
  message.set_data(std::string("\x80\x3f\x00\xc0\x00\x3f\x00\x00\x40\x40", 10));
  EXPECT_EQ(from_message(message).values, (std::vector<float>{1, -2, 0.5f, 0, 3}));
  message.set_data(std::string("\x80\x7f\x00\xc0\x00\x3f\x00\x00\x40\x40", 10));
  expect_refused([&] { from_message(message); }, "tensor.values");
  message.set_data("123");
  expect_refused([&] { from_message(message); }, "tensor.data");
}

TEST(Messages, PayloadsOfEveryType) {
  const Tensor tensor{{2, 1, 3}, {"a", "b"}, {1, -2, 3.5f, 0, 5, 6.25f}};
  Tensor back;
  for (const auto dtype : {v1::Tensor::DTYPE_FLOAT32, v1::Tensor::DTYPE_FLOAT16, v1::Tensor::DTYPE_BFLOAT16}) {
    v1::Tensor message;
    to_payload(tensor, dtype, &message);
    EXPECT_EQ(message.values_size(), 0);
    EXPECT_EQ(message.data().size(), 6 * (dtype == v1::Tensor::DTYPE_FLOAT32 ? 4u : 2u));
    from_payload(message, "payload", &back);
    EXPECT_EQ(back.shape, tensor.shape);
    EXPECT_EQ(back.values, tensor.values);
    EXPECT_EQ(from_message(message).values, tensor.values);
    message.mutable_data()->pop_back();
    expect_refused([&] { from_payload(message, "payload", &back); }, "payload.data");
  }
  from_payload(to_message(tensor), "payload", &back);
  EXPECT_EQ(back.values, tensor.values);
  // Both forms at once are none.
  v1::Tensor message = to_message(tensor);
  message.set_data(std::string(24, 'x'));
  expect_refused([&] { from_payload(message, "payload", &back); }, "payload.data");
}

TEST(Messages, Bfloat16RoundsToTheNearest) {
  v1::Tensor message;
  Tensor back;
  to_payload({{3}, {}, {1.00390625f, 1.01171875f, -3.0e38f}}, v1::Tensor::DTYPE_BFLOAT16, &message);  // ties to even
  from_payload(message, "payload", &back);
  EXPECT_EQ(back.values[0], 1.0f);
  EXPECT_EQ(back.values[1], 1.015625f);
  EXPECT_NEAR(back.values[2], -3.0e38f, 1e36f);
}

TEST(Messages, HalvesAreRoundedAsEigenRoundsThem) {
  // Every half, values between two of them, and beyond both ends; a number of values that is no multiple of eight.
  Tensor tensor;
  for (std::uint32_t bits = 0; bits < 0x10000; ++bits) {
    const auto half = Eigen::numext::bit_cast<Eigen::half>(static_cast<std::uint16_t>(bits));
    if (!(Eigen::numext::isfinite)(half)) continue;
    for (const float factor : {1.0f, 1.0003f, 1.00048828125f})
      tensor.values.push_back(static_cast<float>(half) * factor);
  }
  for (const float value : {1e30f, -1e30f, 1e-30f, -0.0f, 65519.9f}) tensor.values.push_back(value);
  ASSERT_NE(tensor.values.size() % 8, 0u);
  tensor.shape = {static_cast<std::int64_t>(tensor.values.size())};
  v1::Tensor message;
  to_payload(tensor, v1::Tensor::DTYPE_FLOAT16, &message);
  Tensor back;
  from_payload(message, "tensor", &back);
  for (std::size_t i = 0; i < tensor.values.size(); ++i) {
    ASSERT_EQ(back.values[i], static_cast<float>(Eigen::half(tensor.values[i]))) << tensor.values[i];
  }
}

TEST(Messages, TensorIsChecked) {
  const v1::Tensor good = to_message(Tensor{{2, 2}, {"a", "b"}, {1, 2, 3, 4}});
  v1::Tensor bad = good;
  bad.set_shape(0, 3);
  bad.clear_channels();
  expect_refused([&] { from_message(bad); }, "tensor.values");
  bad = good;
  bad.clear_shape();
  expect_refused([&] { from_message(bad); }, "tensor.shape");
  bad = good;
  bad.set_shape(0, 4'000'000'000u);
  expect_refused([&] { from_message(bad); }, "tensor.shape", ErrorCode::kResourceExhausted);
  bad = good;
  bad.add_channels("c");
  expect_refused([&] { from_message(bad); }, "tensor.channels");
  bad = good;
  bad.set_values(0, std::nanf(""));
  expect_refused([&] { from_message(bad); }, "tensor.values");
}

}  // namespace
}  // namespace pleat
