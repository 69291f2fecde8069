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

}  // namespace
}  // namespace pleat::superres
