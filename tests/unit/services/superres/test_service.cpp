// The service as a process: bundles that are replaced while sessions are open.
#include "services/superres/service.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

#include "common/base/process.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/channel.hpp"
#include "common/rpc/stream.hpp"
#include "services/superres/bundle/bundle.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using Stream = rpc::FrameStream<v1::UpscaleRequest, v1::UpscaleResponse>;

constexpr int kChannels = 9, kHeight = 5, kWidth = 6;

class ReplacedBundle : public testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(models_);
    publish(1);
    process_.emplace(fs::path(std::getenv("PLEAT_BINARY_DIR")) / "bin" / "pleat-superres",
                     std::vector<std::string>{"--listen", address_, "--die-with-parent", "--models", models_.string(),
                                              "--model", "small", "--threads", "1"},
                     log_);
    const auto channel = rpc::create_channel(address_);
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (!rpc::is_healthy(channel, "pleat.v1.SuperResolution", std::chrono::milliseconds(300))) {
      ASSERT_TRUE(process_->running() && std::chrono::steady_clock::now() < deadline) << log();
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    stub_ = v1::SuperResolution::NewStub(channel);
  }

  /// A bundle that answers with the upsampled image times `factor`.
  void publish(double factor) const {
    torch::jit::Module module("Scaled");
    module.define(
        "def forward(self, x):\n  return torch.upsample_bilinear2d(x, [x.size(2) * 4, x.size(3) * 4], False) * " +
        std::to_string(factor) + "\n");
    Metadata m;
    m.name = "small";
    m.architecture.kind = "scaled";
    conversion::GeometryImageSpec spec;
    spec.image.coarse_width = kWidth, spec.image.coarse_height = kHeight;
    m.representation.kind = spec;
    m.input = m.output = {std::vector<float>(kChannels, -1), std::vector<float>(kChannels, 2), 0};
    save_bundle(module, m, (models_ / "small.pt").string());
  }

  std::unique_ptr<Stream> session() {
    auto stream =
        std::make_unique<Stream>([this](auto* context, auto* call) { stub_->async()->Upscale(context, call); },
                                 rpc::FrameStreamOptions{.peer = "superres"});
    v1::UpscaleRequest open;
    open.mutable_open()->set_model("small");
    stream->open(open);
    return stream;
  }

  /// The factor of the bundle that answers frame `index` of a session.
  static double factor_of(Stream& session, std::uint64_t index) {
    Tensor image{{kChannels, kHeight, kWidth}, {}, {}};
    image.values.assign(static_cast<std::size_t>(kChannels) * kHeight * kWidth, 0.25F);
    v1::UpscaleRequest request;
    request.mutable_frame()->set_index(index);
    to_message(image, request.mutable_frame()->mutable_image());
    *request.mutable_frame()->mutable_alignment() = to_message(RigidTransform{});
    session.push(request);
    v1::UpscaleResponse response;
    if (!session.pop(&response) || !response.has_frame() || response.frame().index() != index) return -1;
    return from_message(response.frame().image(), "answer").values.at(0) / 0.25;
  }

  std::string log() const {
    std::ostringstream text;
    text << std::ifstream(log_).rdbuf();
    return text.str();
  }

  PrivateFolder folder_;
  const fs::path models_ = folder_.path() / "models", log_ = folder_.path() / "log.txt";
  const std::string address_ = "unix:" + (folder_.path() / "superres.sock").string();
  std::optional<ChildProcess> process_;
  std::unique_ptr<v1::SuperResolution::Stub> stub_;
};

TEST_F(ReplacedBundle, SaysHowConversionHasToBeSetUp) {
  std::ofstream(models_ / "text.pt") << "no archive";
  v1::ListModelsResponse response;
  grpc::ClientContext context;
  ASSERT_TRUE(stub_->ListModels(&context, {}, &response).ok());
  ASSERT_EQ(response.models_size(), 1);
  const v1::Representation& representation = response.models(0).representation();
  EXPECT_EQ(representation.geometry_image().width(), static_cast<std::uint32_t>(kWidth));
  EXPECT_EQ(representation.subdivision_rounds(), 2U);
  EXPECT_EQ(representation.input().scale_size(), kChannels);
  EXPECT_EQ(representation.output().offset(8), -1);
}

TEST_F(ReplacedBundle, ServesNewSessionsAndDropsNone) {
  const auto first = session();
  EXPECT_NEAR(factor_of(*first, 0), 1, 1e-5);
  publish(2);
  const auto second = session();
  EXPECT_NEAR(factor_of(*second, 0), 2, 1e-5);
  EXPECT_NEAR(factor_of(*first, 1), 1, 1e-5);  // opened with the old one, whose normalisation its images have

  std::ofstream(models_ / "small.pt", std::ios::trunc) << "half a fi";
  const auto third = session();
  EXPECT_NEAR(factor_of(*third, 0), 2, 1e-5);
  EXPECT_THAT(log(), testing::HasSubstr("its file was changed and can't be used"));
  fs::remove(models_ / "small.pt");
  EXPECT_NEAR(factor_of(*session(), 0), 2, 1e-5);

  publish(3);
  const auto last = session();
  EXPECT_NEAR(factor_of(*last, 0), 3, 1e-5);
  EXPECT_NEAR(factor_of(*first, 2), 1, 1e-5);
  EXPECT_NEAR(factor_of(*second, 1), 2, 1e-5);
  EXPECT_NEAR(factor_of(*third, 1), 2, 1e-5);
  EXPECT_TRUE(process_->running());
}

/// A bundle that counts frames: each answer is the number of frames since it began anew.
class RememberingBundle : public ReplacedBundle {
 protected:
  void SetUp() override {
    ReplacedBundle::SetUp();
    torch::jit::Module module("Counting");
    module.define(
        "def forward(self, x, memory):\n"
        "  count = memory + 1.0\n"
        "  return torch.zeros_like(x).repeat([1, 1, 4, 4]) + count, count\n");
    Metadata m;
    m.name = "counting";
    m.architecture.kind = "counting";
    conversion::GeometryImageSpec spec;
    spec.image.coarse_width = kWidth, spec.image.coarse_height = kHeight;
    m.representation.kind = spec;
    m.input = m.output = {std::vector<float>(kChannels, 0), std::vector<float>(kChannels, 1), 0};
    m.memory = {1, 1, 1};
    save_bundle(module, m, (models_ / "counting.pt").string());
  }

  std::unique_ptr<Stream> counting() {
    auto stream =
        std::make_unique<Stream>([this](auto* context, auto* call) { stub_->async()->Upscale(context, call); },
                                 rpc::FrameStreamOptions{.peer = "superres"});
    v1::UpscaleRequest open;
    open.mutable_open()->set_model("counting");
    EXPECT_EQ(stream->open(open).state_values(), 1U);
    return stream;
  }

  static v1::UpscaleResponse answer(Stream& stream, std::uint64_t index, const std::string& state = {}) {
    Tensor image{{kChannels, kHeight, kWidth}, {}, {}};
    image.values.assign(static_cast<std::size_t>(kChannels) * kHeight * kWidth, 0.25F);
    v1::UpscaleRequest request;
    request.mutable_frame()->set_index(index);
    request.mutable_frame()->set_state(state);
    to_message(image, request.mutable_frame()->mutable_image());
    *request.mutable_frame()->mutable_alignment() = to_message(RigidTransform{});
    stream.push(request);
    v1::UpscaleResponse response;
    EXPECT_TRUE(stream.pop(&response));
    return response;
  }
  static float count(const v1::UpscaleResponse& response) {
    return response.has_frame() ? from_message(response.frame().image(), "answer").values.at(0) : -1;
  }
};

TEST_F(RememberingBundle, GoesOnFromTheFrameBeforeOrFromWhatTheMessageHas) {
  const auto stream = counting();
  v1::UpscaleResponse last;
  for (std::uint64_t i = 0; i < 5; ++i) last = answer(*stream, i);
  EXPECT_EQ(count(last), 5);
  // Another stream, as after a kill, with what the last frame left.
  const auto other = counting();
  EXPECT_EQ(count(answer(*other, 5, last.frame().state())), 6);
  EXPECT_EQ(count(answer(*other, 6)), 7);
  // A gap, and a frame once more: nothing to go on from.
  EXPECT_EQ(count(answer(*other, 9)), 1);
  EXPECT_EQ(count(answer(*other, 9)), 1);
  EXPECT_EQ(count(answer(*other, 10)), 2);
}

TEST_F(RememberingBundle, AStateThatIsNoneIsRefusedAndTheStreamGoesOn) {
  const auto stream = counting();
  const auto small = answer(*stream, 0, "abc");
  ASSERT_TRUE(small.has_error());
  EXPECT_EQ(small.error().message(), "frame.state: 3 bytes, the bundle remembers 4");
  const auto bad = answer(*stream, 1, std::string("\x00\x00\xc0\x7f", 4));
  ASSERT_TRUE(bad.has_error());
  EXPECT_THAT(bad.error().message(), testing::HasSubstr("state: a number is not finite"));
  EXPECT_EQ(count(answer(*stream, 2)), 1);
  EXPECT_EQ(count(answer(*stream, 3)), 2);
}

TEST_F(RememberingBundle, ManyFramesInFlightKeepTheirOrder) {
  const auto stream = counting();
  Tensor image{{kChannels, kHeight, kWidth}, {}, {}};
  image.values.assign(static_cast<std::size_t>(kChannels) * kHeight * kWidth, 0.25F);
  std::uint64_t sent = 0;
  for (std::uint64_t i = 0; i < 60; ++i) {
    for (; sent < 60 && sent < i + 4; ++sent) {
      v1::UpscaleRequest request;
      request.mutable_frame()->set_index(sent);
      to_message(image, request.mutable_frame()->mutable_image());
      *request.mutable_frame()->mutable_alignment() = to_message(RigidTransform{});
      stream->push(request);
    }
    v1::UpscaleResponse response;
    ASSERT_TRUE(stream->pop(&response));
    ASSERT_EQ(count(response), static_cast<float>(i + 1));
  }
}

}  // namespace
}  // namespace pleat::superres
