// The adapter, over a real channel.
#include "services/conversion/service.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <memory>

#include "common/base/error.hpp"
#include "common/features/channel_ranges.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/server.hpp"
#include "common/rpc/stream.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "services/conversion/spec_messages.hpp"
#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

using ImageStream = rpc::FrameStream<v1::ToImageRequest, v1::ToImageResponse>;
using MeshStream = rpc::FrameStream<v1::ToMeshRequest, v1::ToMeshResponse>;

ChannelRanges range_of(const Tensor& image) {
  RangeMeasure measure(static_cast<std::size_t>(image.shape[0]));
  measure.add(image);
  return measure.extremes();
}

class ConversionServer : public testing::Test {
 protected:
  ConversionServer() {
    rpc::ServerOptions options;
    options.listen = "unix:" + (folder_.path() / "conversion.sock").string();
    server_ =
        std::make_unique<rpc::Server>(options, std::vector<rpc::HostedService>{{&service_, "pleat.v1.Conversion"}});
    stub_ = v1::Conversion::NewStub(rpc::create_channel(server_->address()));
    set_size(60, 40);
    *setup_.mutable_coarse() = to_message(garment_.coarse);
  }

  std::unique_ptr<ImageStream> image_stream() {
    return std::make_unique<ImageStream>([this](auto* context, auto* call) { stub_->async()->ToImage(context, call); },
                                         rpc::FrameStreamOptions{.peer = "conversion"});
  }
  std::unique_ptr<MeshStream> mesh_stream() {
    return std::make_unique<MeshStream>([this](auto* context, auto* call) { stub_->async()->ToMesh(context, call); },
                                        rpc::FrameStreamOptions{.peer = "conversion"});
  }
  v1::ToImageRequest image_open() const {
    v1::ToImageRequest request;
    *request.mutable_open()->mutable_setup() = setup_;
    return request;
  }
  void set_size(std::uint32_t width, std::uint32_t height) {
    v1::GeometryImage& image = *setup_.mutable_representation()->mutable_geometry_image();
    image.set_width(width);
    image.set_height(height);
  }
  /// Normalises `image` as the service is asked to. Returns how many values are outside.
  std::size_t set_ranges(const ChannelRanges& range, Tensor& image) {
    v1::ChannelRanges& input = *setup_.mutable_representation()->mutable_input();
    for (std::size_t c = 0; c < range.channels(); ++c) {
      input.add_offset(range.offset[c]);
      input.add_scale(range.scale[c]);
    }
    *setup_.mutable_representation()->mutable_output() = input;
    return normalize(range, image);
  }
  static v1::GeometryImage& image_of(v1::ConversionSetup& setup) {
    return *setup.mutable_representation()->mutable_geometry_image();
  }
  v1::ToMeshRequest mesh_open() const {
    v1::ToMeshRequest request;
    *request.mutable_open()->mutable_setup() = setup_;
    return request;
  }
  template <typename Change>
  void expect_refused(ErrorCode code, const Change& change) {
    v1::ToImageRequest request = image_open();
    change(*request.mutable_open()->mutable_setup());
    const auto stream = image_stream();
    try {
      stream->open(request);
      ADD_FAILURE() << "opened";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), code) << error.what();
    }
  }

  const test::TemporaryFolder folder_;
  test::Garment garment_ = test::load_garment("tablecloth");
  telemetry::Metrics metrics_{"conversion"};
  ConversionService service_{ServiceOptions{}, metrics_};
  std::unique_ptr<rpc::Server> server_;
  std::unique_ptr<v1::Conversion::Stub> stub_;
  v1::ConversionSetup setup_;
};

TEST_F(ConversionServer, ImagesAreThoseOfTheLibraryAndNormalised) {
  const ImageMap map(garment_.coarse, garment_.fine());
  Frame frame = test::wrinkled_frame(garment_.coarse, 0.4f);
  frame.index = 7;
  frame.time_s = 0.28;
  CoarseImage expected = map.coarse_image(frame);
  ChannelRanges range = range_of(expected.image);
  range.scale[0] *= 0.75f;  // so that some values are outside
  const std::size_t outside = set_ranges(range, expected.image);
  ASSERT_GT(outside, 0u);

  const auto stream = image_stream();
  const auto opened = stream->open(image_open());
  EXPECT_EQ(opened.coarse_width(), 60u);
  EXPECT_EQ(opened.coarse_height(), 40u);
  EXPECT_EQ(opened.fine_width(), 240u);
  EXPECT_EQ(opened.fine_height(), 160u);
  v1::ToImageRequest request;
  *request.mutable_frame() = to_message(frame);
  stream->push(request);
  v1::ToImageResponse response;
  ASSERT_TRUE(stream->pop(&response));
  ASSERT_TRUE(response.has_frame());
  EXPECT_EQ(response.frame().index(), 7u);
  EXPECT_EQ(response.frame().time_s(), 0.28);
  EXPECT_EQ(response.frame().out_of_range(), outside);
  EXPECT_EQ(from_message(response.frame().image()).values, expected.image.values);
  EXPECT_EQ(from_message(response.frame().alignment()).rotation, expected.transform.rotation);
  ASSERT_EQ(response.frame().stage_times_size(), 1);
  EXPECT_EQ(response.frame().stage_times(0).stage(), "to_image");
  stream->close();
  EXPECT_FALSE(stream->pop(&response));
}

TEST_F(ConversionServer, BothDirectionsShareTheMaps) {
  image_stream()->open(image_open());
  EXPECT_EQ(metrics_.text().find("pleat_cached_maps_total"), std::string::npos);
  mesh_stream()->open(mesh_open());
  image_stream()->open(image_open());
  EXPECT_NE(metrics_.text().find("pleat_cached_maps_total{service=\"conversion\"} 2"), std::string::npos)
      << metrics_.text();
  set_size(30, 20);
  EXPECT_EQ(image_stream()->open(image_open()).fine_width(), 120u);
}

// Any fine mesh over the same material serves: here one that is not the coarse one subdivided.
TEST_F(ConversionServer, AFineMeshOfItsOwn) {
  const Topology fine = test::other_sheet(garment_.coarse, 37, 29);
  *setup_.mutable_fine() = to_message(fine);
  const auto stream = mesh_stream();
  const auto opened = stream->open(mesh_open());
  EXPECT_EQ(opened.fine().hash(), topology_hash(fine));
  EXPECT_EQ(opened.feature_vertices_size(), 0);
}

TEST_F(ConversionServer, AFittedImageComesBackAsTheMesh) {
  const ImageMap map(garment_.coarse, garment_.fine());
  const Frame coarse = test::wrinkled_frame(garment_.coarse, 0.4f), fine = test::wrinkled_frame(garment_.fine(), 0.4f);
  const RigidTransform transform = map.align(coarse.positions);
  Tensor image = map.fine_image(fine, transform);
  set_ranges(range_of(image), image);
  const auto stream = mesh_stream();
  const auto opened = stream->open(mesh_open());
  EXPECT_EQ(topology_hash(from_message(opened.fine())), topology_hash(garment_.fine()));
  EXPECT_EQ(opened.feature_vertices_size(), 749);
  for (const int channels : {9, 3}) {
    v1::ToMeshRequest request;
    image.values.resize(image.values.size() / static_cast<std::size_t>(image.shape[0]) *
                        static_cast<std::size_t>(channels));
    image.channels.resize(static_cast<std::size_t>(channels));
    image.shape[0] = channels;
    request.mutable_frame()->set_index(3);
    *request.mutable_frame()->mutable_image() = to_message(image);
    *request.mutable_frame()->mutable_alignment() = to_message(transform);
    stream->push(request);
    v1::ToMeshResponse response;
    ASSERT_TRUE(stream->pop(&response));
    ASSERT_TRUE(response.has_frame());
    EXPECT_EQ(response.frame().fine().index(), 3u);
    const Positions back = positions_from_message(response.frame().fine());
    EXPECT_LT(test::rms(back, fine.positions), 1e-6);
  }
}

TEST_F(ConversionServer, ABadFrameIsAnsweredAndTheStreamGoesOn) {
  const auto stream = image_stream();
  stream->open(image_open());
  Frame frame = test::wrinkled_frame(garment_.coarse, 0.1f);
  v1::ToImageRequest good, few, infinite;
  *good.mutable_frame() = to_message(frame);
  good.mutable_frame()->set_index(3);
  few = good;
  few.mutable_frame()->set_index(1);
  few.mutable_frame()->mutable_positions()->Truncate(30);
  infinite = good;
  infinite.mutable_frame()->set_index(2);
  infinite.mutable_frame()->set_positions(5, std::numeric_limits<float>::infinity());
  for (const auto* request : {&few, &infinite, &good}) stream->push(*request);
  v1::ToImageResponse response;
  for (const std::uint64_t index : {1u, 2u}) {
    ASSERT_TRUE(stream->pop(&response));
    ASSERT_TRUE(response.has_error());
    EXPECT_EQ(response.error().index(), index);
    EXPECT_EQ(response.error().code(), static_cast<int>(grpc::StatusCode::INVALID_ARGUMENT));
  }
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_EQ(response.frame().index(), 3u);

  const auto meshes = mesh_stream();
  meshes->open(mesh_open());
  v1::ToMeshRequest image;
  image.mutable_frame()->set_index(5);
  *image.mutable_frame()->mutable_image() = to_message(Tensor{{9, 4, 4}, {}, std::vector<float>(144)});
  *image.mutable_frame()->mutable_alignment() = to_message(RigidTransform{});
  meshes->push(image);
  v1::ToMeshResponse answer;
  ASSERT_TRUE(meshes->pop(&answer));
  ASSERT_TRUE(answer.has_error());
  EXPECT_EQ(answer.error().index(), 5u);
}

// The whole way of a frame with the detail layout: described, encoded, answered as it should be, decoded.
TEST_F(ConversionServer, DetailComesBackAsTheMesh) {
  v1::Representation& wanted = *setup_.mutable_representation();
  wanted.mutable_geometry_image()->set_layout(v1::GeometryImage::LAYOUT_DETAIL);
  wanted.set_subdivision_rounds(1);
  wanted.set_subdivision_rule(v1::SUBDIVISION_RULE_LOOP);
  for (int c = 0; c < 3; ++c) {
    wanted.mutable_output()->add_offset(0.001f);
    wanted.mutable_output()->add_scale(0.02f);
  }
  grpc::ClientContext context;
  v1::ConversionOpened described;
  ASSERT_TRUE(stub_->Describe(&context, setup_, &described).ok());
  const Topology fine_mesh = from_message(described.fine());
  EXPECT_EQ(topology_hash(fine_mesh), topology_hash(subdivide(garment_.coarse, 1, SubdivisionRule::kSmooth).fine));
  EXPECT_EQ(described.input_shape(0), 17u);
  EXPECT_EQ(described.answer_shape(0), 3u);
  EXPECT_EQ(described.constants().shape(0), 32u);
  EXPECT_EQ(described.dtype(), v1::Tensor::DTYPE_FLOAT16);

  const Frame coarse = test::wrinkled_frame(garment_.coarse, 0.4f), fine = test::wrinkled_frame(fine_mesh, 0.4f);
  v1::ToImageRequest open = image_open(), request;
  open.mutable_open()->set_dtype(v1::Tensor::DTYPE_FLOAT16);
  const auto images = image_stream();
  images->open(open);
  *request.mutable_frame() = to_message(coarse);
  images->push(request);
  v1::ToImageResponse encoded;
  ASSERT_TRUE(images->pop(&encoded));
  ASSERT_TRUE(encoded.has_frame());
  RepresentationSpec spec = spec_from(wanted, 4'000'000);
  const auto library = make_representation(garment_.coarse, spec);
  const RigidTransform alignment = library->align(coarse.positions);
  Tensor expected;
  library->encode(std::span(&coarse, 1), alignment, expected, nullptr);
  const Tensor input = from_message(encoded.frame().image());
  ASSERT_EQ(input.values.size(), expected.values.size());
  for (std::size_t i = 0; i < input.values.size(); ++i) {
    ASSERT_NEAR(input.values[i], expected.values[i], 1e-6f + 1e-3f * std::abs(expected.values[i]));
  }

  Tensor answer;
  library->target(coarse, fine, alignment, answer);
  normalize(ranges_from(wanted.output(), 3, "output"), answer);
  v1::ToMeshRequest back;
  *back.mutable_frame()->mutable_alignment() = encoded.frame().alignment();
  *back.mutable_frame()->mutable_coarse() = request.frame();
  to_payload(answer, v1::Tensor::DTYPE_FLOAT16, back.mutable_frame()->mutable_image());
  const auto meshes = mesh_stream();
  meshes->open(mesh_open());
  meshes->push(back);
  v1::ToMeshResponse decoded;
  ASSERT_TRUE(meshes->pop(&decoded));
  ASSERT_TRUE(decoded.has_frame()) << decoded.error().message();
  EXPECT_LT(test::rms(positions_from_message(decoded.frame().fine()), fine.positions), 2e-5);
  // Without its coarse frame an answer means nothing.
  back.mutable_frame()->clear_coarse();
  meshes->push(back);
  ASSERT_TRUE(meshes->pop(&decoded));
  EXPECT_TRUE(decoded.has_error());
}

TEST_F(ConversionServer, AWindowNeedsItsFrames) {
  setup_.mutable_representation()->mutable_geometry_image();
  setup_.mutable_representation()->set_window(2);
  const auto stream = image_stream();
  stream->open(image_open());
  v1::ToImageRequest request;
  v1::ToImageResponse response;
  *request.mutable_frame() = to_message(test::wrinkled_frame(garment_.coarse, 0.4f));
  stream->push(request);
  ASSERT_TRUE(stream->pop(&response));
  EXPECT_TRUE(response.has_error());
  *request.add_earlier() = to_message(test::wrinkled_frame(garment_.coarse, 0.3f));
  stream->push(request);
  ASSERT_TRUE(stream->pop(&response));
  ASSERT_TRUE(response.has_frame());
  EXPECT_EQ(response.frame().image().shape(0), 18u);
  expect_refused(ErrorCode::kInvalidArgument,
                 [](v1::ConversionSetup& s) { s.mutable_representation()->set_window(17); });
  expect_refused(ErrorCode::kInvalidArgument,
                 [](v1::ConversionSetup& s) { s.mutable_representation()->mutable_vertex_features()->set_passes(99); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) {
    s.mutable_representation()->mutable_vertex_features()->set_rotation(static_cast<v1::VertexFeatures::Rotation>(7));
  });
}

TEST_F(ConversionServer, ObstaclesComeWithTheFrameWhereTheyAreRead) {
  v1::Representation& wanted = *setup_.mutable_representation();
  wanted.mutable_vertex_features()->set_obstacles(true);
  wanted.set_subdivision_rounds(1);
  const Frame coarse = test::wrinkled_frame(garment_.coarse, 0.4f);
  ObstacleFrame ball;
  ball.name = "ball";
  ball.center = coarse.positions.row(3).transpose() + Eigen::Vector3f(0, 0, 0.06F);
  ball.radius = 0.05F;
  v1::ToImageRequest open = image_open(), request;
  open.mutable_open()->add_obstacles()->set_name("ball");
  *request.mutable_frame() = to_message(coarse);
  const auto images = image_stream();
  images->open(open);
  images->push(request);  // where is the ball?
  v1::ToImageResponse encoded;
  ASSERT_TRUE(images->pop(&encoded));
  EXPECT_THAT(encoded.error().message(), testing::HasSubstr("obstacles: 0 given"));
  *request.add_obstacles() = to_message(ball);
  images->push(request);
  ASSERT_TRUE(images->pop(&encoded));
  ASSERT_TRUE(encoded.has_frame()) << encoded.error().message();

  const auto library = make_representation(garment_.coarse, spec_from(wanted, 4'000'000));
  ObstacleField field({});
  field.update(std::vector{ball});
  Tensor expected;
  library->encode(std::span(&coarse, 1), library->align(coarse.positions), expected, &field);
  EXPECT_EQ(from_message(encoded.frame().image()).values, expected.values);
}

// The same of vertex features, with a window of two frames.
TEST_F(ConversionServer, VertexFeaturesComeBackAsTheMesh) {
  v1::Representation& wanted = *setup_.mutable_representation();
  wanted.mutable_vertex_features();
  wanted.set_subdivision_rounds(1);
  wanted.set_window(2);
  grpc::ClientContext context;
  v1::ConversionOpened described;
  ASSERT_TRUE(stub_->Describe(&context, setup_, &described).ok());
  const auto faces = static_cast<std::uint32_t>(garment_.coarse.face_count());
  EXPECT_THAT(described.input_shape(), testing::ElementsAre(45, 1, faces));
  EXPECT_THAT(described.answer_shape(), testing::ElementsAre(9, 3, 3 * faces));
  EXPECT_THAT(described.constants().shape(), testing::ElementsAre(27, 1, faces));

  v1::ToImageRequest request;
  *request.mutable_frame() = to_message(test::wrinkled_frame(garment_.coarse, 0.4f));
  *request.add_earlier() = to_message(test::wrinkled_frame(garment_.coarse, 0.3f));
  const auto images = image_stream();
  images->open(image_open());
  images->push(request);
  v1::ToImageResponse encoded;
  ASSERT_TRUE(images->pop(&encoded));
  ASSERT_TRUE(encoded.has_frame()) << encoded.error().message();
  EXPECT_THAT(encoded.frame().image().shape(), testing::ElementsAre(90, 1, faces));

  const auto library = make_representation(garment_.coarse, spec_from(wanted, 4'000'000));
  const Frame coarse = test::wrinkled_frame(garment_.coarse, 0.4f), fine = test::wrinkled_frame(library->fine(), 0.5f);
  Tensor answer;
  library->target(coarse, fine, from_message(encoded.frame().alignment(), "alignment"), answer);
  v1::ToMeshRequest back;
  *back.mutable_frame()->mutable_alignment() = encoded.frame().alignment();
  *back.mutable_frame()->mutable_coarse() = request.frame();
  *back.mutable_frame()->mutable_image() = to_message(answer);
  const auto meshes = mesh_stream();
  meshes->open(mesh_open());
  meshes->push(back);
  v1::ToMeshResponse decoded;
  ASSERT_TRUE(meshes->pop(&decoded));
  ASSERT_TRUE(decoded.has_frame()) << decoded.error().message();
  EXPECT_LT(test::rms(positions_from_message(decoded.frame().fine()), fine.positions), 1e-5);
}

TEST_F(ConversionServer, BadSetupsAreRefused) {
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) { s.clear_coarse(); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) { s.mutable_coarse()->clear_uv(); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) {
    s.mutable_coarse()->clear_uv();
    s.mutable_coarse()->clear_uv_faces();
    s.mutable_coarse()->clear_hash();
  });
  expect_refused(ErrorCode::kInvalidArgument,
                 [](v1::ConversionSetup& s) { s.mutable_coarse()->set_hash("0123456789abcdef"); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) { s.mutable_coarse()->set_faces(0, 999999); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) { s.clear_representation(); });
  expect_refused(ErrorCode::kInvalidArgument,
                 [](v1::ConversionSetup& s) { s.mutable_representation()->set_subdivision_rounds(6); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) { image_of(s).set_scale(17); });
  expect_refused(ErrorCode::kInvalidArgument, [](v1::ConversionSetup& s) { image_of(s).set_height(0); });
  expect_refused(ErrorCode::kInvalidArgument,
                 [](v1::ConversionSetup& s) { s.mutable_representation()->mutable_input()->add_offset(0); });
  expect_refused(ErrorCode::kResourceExhausted, [](v1::ConversionSetup& s) {
    image_of(s).set_width(4'000'000'000u);
    image_of(s).set_height(4'000'000'000u);
  });
  expect_refused(ErrorCode::kResourceExhausted, [](v1::ConversionSetup& s) {
    image_of(s).set_width(0);
    image_of(s).set_height(0);
    image_of(s).set_texels_per_fine_vertex(900);
  });
  EXPECT_NO_THROW(image_stream()->open(image_open()));  // the service goes on serving
}

}  // namespace
}  // namespace pleat::conversion
