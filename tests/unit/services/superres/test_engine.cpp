// Bundles and inference: what is written runs, what is damaged or foreign is refused with its cause.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <future>
#include <limits>
#include <thread>

#include "services/superres/batcher.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/bundle/folder.hpp"
#include "services/superres/engine.hpp"
#include "services/superres/networks/network.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using test::error_of;
using testing::HasSubstr;

constexpr int kChannels = 9;

class EngineTest : public testing::Test {
 public:
  static Tensor image(int height, int width, float phase = 0) {
    Tensor t{{kChannels, height, width}, {}, {}};
    for (int i = 0; i < kChannels * height * width; ++i) {
      t.values.push_back(0.5F + 0.4F * std::sin(phase + 0.3F * static_cast<float>(i)));
    }
    return t;
  }

 protected:
  void SetUp() override { fs::create_directories(root_ / "models"); }

  std::string folder() const { return (root_ / "models").string(); }
  std::string file(const std::string& name) const { return folder() + "/" + name + ".pt"; }

  static Metadata metadata(const std::string& name) {
    Metadata m;
    m.name = name;
    m.architecture =
        complete({"mfsr", R"({"blocks": 1, "layers": 2, "growth": 4, "features": 8, "upsampling": "subpixel"})"});
    conversion::GeometryImageSpec spec;
    spec.image.coarse_width = 6, spec.image.coarse_height = 5;
    m.representation.kind = spec;
    m.input = m.output = {std::vector<float>(kChannels, -1), std::vector<float>(kChannels, 2), 0};
    m.float32_parameters = {"shallow"};
    return m;
  }

  static Network network(const Metadata& metadata) { return {describe(metadata.architecture, ports_of(metadata)), 9}; }

  void write(const std::string& name) const { write(metadata(name)); }
  void write(const Metadata& metadata) const {
    save_bundle(network(metadata).to_script(), metadata, file(metadata.name));
  }

  /// A module made by somebody else, without float32_parameters.
  void write_foreign(const std::string& name, const std::string& source) const {
    torch::jit::Module module("Foreign");
    module.define(source);
    Metadata m = metadata(name);
    m.architecture.kind = "foreign";
    m.float32_parameters.clear();
    save_bundle(module, m, file(name));
  }

  EngineOptions options(Precision precision = Precision::kFloat32) const {
    EngineOptions o;
    o.folder = folder();
    o.precision = precision;
    o.threads = 1;
    o.use_cuda = false;
    o.largest_batch = 2;
    return o;
  }

  const test::TemporaryFolder temporary_;
  const fs::path root_ = temporary_.path();
};

double worst_difference(const std::vector<float>& a, const std::vector<float>& b) {
  EXPECT_EQ(a.size(), b.size());
  double worst = 0;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    worst = std::max(worst, static_cast<double>(std::abs(a[i] - b[i])));
  }
  return worst;
}

TEST_F(EngineTest, RunsWhatWasWritten) {
  write("small");
  Engine engine(options(), "small");
  EXPECT_EQ(engine.status().precision, "float32");
  EXPECT_EQ(engine.status().device, "cpu");
  for (const auto& [h, w] : {std::pair{5, 6}, std::pair{8, 7}}) {
    const Tensor input = image(h, w);
    const Tensor output = engine.upscale({&input});
    EXPECT_EQ(output.shape, (std::vector<std::int64_t>{9, 4 * h, 4 * w}));
    const auto expected = network(metadata("small"))
                              .forward(torch::tensor(input.values).view({1, kChannels, h, w}))
                              .detach()
                              .contiguous();
    EXPECT_LT(
        worst_difference(output.values, {expected.data_ptr<float>(), expected.data_ptr<float>() + expected.numel()}),
        1e-5);
  }
}

TEST_F(EngineTest, BatchEqualsSingleImages) {
  write("small");
  Engine engine(options(), "small");
  const Tensor a = image(5, 6), b = image(5, 6, 2);
  const NetworkInput both[] = {{&a}, {&b}};
  const auto results = engine.upscale(both);
  ASSERT_EQ(results.size(), 2U);
  EXPECT_LT(worst_difference(results[0].values, engine.upscale({&a}).values), 1e-6);
  EXPECT_LT(worst_difference(results[1].values, engine.upscale({&b}).values), 1e-6);
  const Tensor three = engine.upscale({&a}, 3);
  EXPECT_EQ(three.shape, (std::vector<std::int64_t>{3, 20, 24}));
  EXPECT_LT(worst_difference(three.values, {results[0].values.begin(), results[0].values.begin() + 3 * 480}), 1e-6);
  EXPECT_EQ(error_of([&] { engine.upscale({&a}, 10); }).code(), ErrorCode::kInvalidArgument);
}

TEST_F(EngineTest, Bfloat16OnlyWhereTheProcessorAndTheBundleHaveIt) {
  write("small");
  write_foreign("foreign",
                "def forward(self, x):\n  return torch.upsample_nearest2d(x, [x.size(2) * 4, x.size(3) * 4])\n");
  EXPECT_EQ(Engine(options(Precision::kAuto), "foreign").status().precision, "float32");
  EXPECT_EQ(error_of([&] { Engine(options(Precision::kBfloat16), "foreign"); }).code(), ErrorCode::kFailedPrecondition);
  if (processor_has_bfloat16()) {
    Engine engine(options(Precision::kAuto), "small");
    EXPECT_EQ(engine.status().precision, "bfloat16");
    // Eight bits, and an answer of up to 1.5 on inputs that are pure noise.
    const Tensor input = image(5, 6);
    EXPECT_LT(worst_difference(engine.upscale({&input}).values, Engine(options(), "small").upscale({&input}).values),
              3e-2);
  } else {
    EXPECT_EQ(Engine(options(Precision::kAuto), "small").status().precision, "float32");
    EXPECT_EQ(error_of([&] { Engine(options(Precision::kBfloat16), "small"); }).code(), ErrorCode::kFailedPrecondition);
  }
}

TEST_F(EngineTest, ForeignModulesRunAndBadOnesAreRefused) {
  write_foreign("good",
                "def forward(self, x):\n  return torch.upsample_nearest2d(x, [x.size(2) * 4, x.size(3) * 4])\n");
  const Tensor input = image(3, 4);
  EXPECT_FLOAT_EQ(Engine(options(), "good").upscale({&input}).values[0], input.values[0]);
  write_foreign("shape", "def forward(self, x):\n  return x\n");
  EXPECT_THAT(error_of([&] { Engine(options(), "shape"); }).what(), HasSubstr("another shape"));
  write_foreign("nan",
                "def forward(self, x):\n  y = torch.upsample_nearest2d(x, [x.size(2) * 4, x.size(3) * 4])\n"
                "  return y / (y - y)\n");
  EXPECT_EQ(error_of([&] { Engine(options(), "nan"); }).code(), ErrorCode::kDataLoss);
}

/// What make_python_bundle.py's module answers, in plain loops.
std::vector<double> python_answer(const Tensor& x) {
  const int h = static_cast<int>(x.shape[1]), w = static_cast<int>(x.shape[2]);
  const auto at = [&](int c, int y, int column) {
    return static_cast<double>(x.values[static_cast<std::size_t>((c * h + y) * w + column)]);
  };
  const auto inside = [&](int y, int column) { return y >= 0 && y < h && column >= 0 && column < w; };
  std::vector<double> answer(static_cast<std::size_t>(kChannels * 16 * h * w));
  for (int c = 0; c < kChannels; ++c) {
    for (int y = 0; y < 4 * h; ++y) {
      for (int column = 0; column < 4 * w; ++column) {
        const int o = (c * 4 + y % 4) * 4 + column % 4;
        double sum = 0.05 * std::sin(0.37 * o);
        for (int i = 0; i < kChannels; ++i) {
          for (int k = 0; k < 9; ++k) {
            const int py = y / 4 + k / 3 - 1, px = column / 4 + k % 3 - 1;
            if (inside(py, px)) sum += 0.05 * std::sin(0.37 * ((o * kChannels + i) * 9 + k)) * at(i, py, px);
          }
        }
        // Texel centres, held at the border.
        const double v = std::clamp((y + 0.5) / 4 - 0.5, 0.0, h - 1.0);
        const double u = std::clamp((column + 0.5) / 4 - 0.5, 0.0, w - 1.0);
        const int y0 = static_cast<int>(v), x0 = static_cast<int>(u);
        const int y1 = std::min(y0 + 1, h - 1), x1 = std::min(x0 + 1, w - 1);
        const double b = v - y0, a = u - x0;
        answer[static_cast<std::size_t>((c * 4 * h + y) * 4 * w + column)] =
            std::tanh(sum) + (1 - b) * ((1 - a) * at(c, y0, x0) + a * at(c, y0, x1)) +
            b * ((1 - a) * at(c, y1, x0) + a * at(c, y1, x1));
      }
    }
  }
  return answer;
}

void expect_python_answer(Engine& engine) {
  EXPECT_EQ(engine.describe().architecture.kind, "small-from-python");
  const Tensor input = EngineTest::image(5, 6, 0.7F);
  const auto expected = python_answer(input);
  const auto output = engine.upscale({&input}).values;
  EXPECT_LT(worst_difference(output, {expected.begin(), expected.end()}), 1e-5);
}

fs::path source_of_tests() { return fs::path(std::getenv("PLEAT_SOURCE_DIR")) / "tests/unit/services/superres"; }

TEST_F(EngineTest, ModulesFromPythonRun) {
  fs::copy_file(source_of_tests() / "python_bundle.pt", file("python_bundle"));
  Engine engine(options(), "python_bundle");
  expect_python_answer(engine);
}

TEST_F(EngineTest, ModulesThatPythonWritesNowRun) {
  if (std::system("/usr/bin/python3 -c 'import torch' 2>/dev/null") != 0) GTEST_SKIP() << "no python3-torch here";
  const std::string command =
      "/usr/bin/python3 " + (source_of_tests() / "make_python_bundle.py").string() + " " + file("fresh");
  ASSERT_EQ(std::system(command.c_str()), 0);
  Engine engine(options(), "fresh");
  expect_python_answer(engine);
}

TEST_F(EngineTest, NamesDoNotLeaveTheFolder) {
  write("small");
  fs::copy_file(file("small"), root_ / "outside.pt");
  fs::create_symlink(root_ / "outside.pt", fs::path(folder()) / "link.pt");
  for (const std::string name : {"../outside", "..", "", "/etc/passwd", "a/b", "..\\outside", "link"}) {
    EXPECT_EQ(error_of([&] { bundle_path(folder(), name); }).code(), ErrorCode::kInvalidArgument) << name;
  }
  EXPECT_EQ(error_of([&] { bundle_path(folder(), std::string("small\0.pt", 9)); }).code(), ErrorCode::kInvalidArgument);
  EXPECT_EQ(error_of([&] { bundle_path(folder(), "absent"); }).code(), ErrorCode::kNotFound);
  EXPECT_EQ(error_of([&] { bundle_path(folder() + "/absent", "small"); }).code(), ErrorCode::kNotFound);
  EXPECT_EQ(bundle_path(folder(), "small"), bundle_path(folder(), "small.pt"));
  EXPECT_EQ(list_bundles(folder()), (std::vector<std::string>{"link", "small"}));
}

TEST_F(EngineTest, DamagedBundlesAreDataLoss) {
  write("small");
  const auto size = fs::file_size(file("small"));
  for (const std::uintmax_t kept : {std::uintmax_t{0}, std::uintmax_t{10}, size / 2, size - 1}) {
    fs::copy_file(file("small"), file("cut"), fs::copy_options::overwrite_existing);
    fs::resize_file(file("cut"), kept);
    const Error error = error_of([&] { Engine(options(), "cut"); });
    EXPECT_EQ(error.code(), ErrorCode::kDataLoss) << kept << ": " << error.what();
    EXPECT_THAT(error.what(), HasSubstr("cut.pt"));
  }
  std::ofstream(file("text")) << "no archive at all";
  EXPECT_EQ(error_of([&] { read_metadata(folder(), "text"); }).code(), ErrorCode::kDataLoss);
}

TEST_F(EngineTest, ScriptWithoutMetadataIsNoBundle) {
  network(metadata("bare")).to_script().save(file("bare"));
  const Error error = error_of([&] { read_metadata(folder(), "bare"); });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_THAT(error.what(), HasSubstr("pleat.json"));
}

TEST_F(EngineTest, OtherMeshIsRefused) {
  Metadata m = metadata("small");
  m.topology_hash = "00000000000000aa";
  write(m);
  Engine engine(options(), "small");
  engine.require_topology("00000000000000aa");
  const Tensor other = image(8, 7);
  EXPECT_THAT(error_of([&] { engine.upscale({&other}); }).what(), HasSubstr("6x5"));
  const Error error = error_of([&] { engine.require_topology("00000000000000bb"); });
  EXPECT_EQ(error.code(), ErrorCode::kFailedPrecondition);
  EXPECT_THAT(error.what(), HasSubstr("00000000000000bb"));
}

TEST_F(EngineTest, BadImagesAreRefused) {
  write("small");
  Engine engine(options(), "small");
  const auto refusal = [&](const Tensor& wrong) { return error_of([&] { engine.upscale({&wrong}); }); };
  Tensor wrong = image(5, 6);
  wrong.values.pop_back();
  EXPECT_EQ(refusal(wrong).code(), ErrorCode::kInvalidArgument);
  wrong = image(5, 6);
  wrong.values[7] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(refusal(wrong).what(), HasSubstr("finite"));
  wrong = image(5, 6);
  wrong.shape = {9, 0, 6};
  EXPECT_EQ(refusal(wrong).code(), ErrorCode::kInvalidArgument);
  wrong.shape = {10, 5, 6};
  EXPECT_THAT(refusal(wrong).what(), HasSubstr("(9, h, w)"));
  wrong.shape = {9, 30};
  EXPECT_EQ(refusal(wrong).code(), ErrorCode::kInvalidArgument);
  const Tensor good = image(5, 6);
  EXPECT_EQ(engine.upscale({&good}).values.size(), 9U * 20 * 24);
}

/// Two frames of nine channels and two constant ones.
TEST_F(EngineTest, WindowsAndConstantsReachTheNetwork) {
  Metadata m = metadata("window");
  m.representation.window = 2;
  m.constants = 2;
  write(m);
  Tensor frames{{18, 5, 6}, {}, {}}, first{{2, 5, 6}, {}, {}}, second = first;
  for (int i = 0; i < 18 * 30; ++i) frames.values.push_back(std::sin(0.3F * static_cast<float>(i)));
  for (int i = 0; i < 2 * 30; ++i) {
    first.values.push_back(std::cos(0.2F * static_cast<float>(i)));
    second.values.push_back(std::sin(0.7F * static_cast<float>(i)));
  }
  for (const bool torchscript : {false, true}) {
    EngineOptions o = options();
    o.torchscript = torchscript;
    Engine engine(o, "window");
    EXPECT_EQ(engine.status().kernels == "TorchScript", torchscript);
    EXPECT_THAT(error_of([&] { engine.upscale({&frames}); }).what(), HasSubstr("constants"));
    EXPECT_EQ(error_of([&] { engine.take_constants(frames); }).code(), ErrorCode::kInvalidArgument);
    EXPECT_EQ(error_of([&] { engine.take_constants({}); }).code(), ErrorCode::kInvalidArgument);
    // Sessions with constants of their own, frame by frame in turn.
    const auto a = engine.take_constants(first), b = engine.take_constants(second);
    for (const auto& constants : {a, b, a}) {
      auto input = torch::empty({1, 20, 5, 6});
      std::copy(frames.values.begin(), frames.values.end(), input.data_ptr<float>());
      std::copy(constants->values.begin(), constants->values.end(), input.data_ptr<float>() + frames.values.size());
      const auto expected = network(m).forward(input).detach().contiguous();
      EXPECT_LT(worst_difference(engine.upscale({&frames, constants}).values,
                                 {expected.data_ptr<float>(), expected.data_ptr<float>() + expected.numel()}),
                1e-5);
    }
  }
}

TEST_F(EngineTest, OutOfMemoryHalvesTheBatchFromThenOn) {
  write_foreign("greedy",
                "def forward(self, x):\n  assert x.size(0) == 1, 'CUDA out of memory'\n"
                "  return torch.upsample_bilinear2d(x, [x.size(2) * 4, x.size(3) * 4], False)\n");
  EngineOptions four = options();
  four.largest_batch = 4;
  Engine engine(four, "greedy");
  const Tensor a = image(5, 6, 0.1F), b = image(5, 6, 0.7F);
  const NetworkInput both[] = {{&a}, {&b}};
  const auto results = engine.upscale(both);
  EXPECT_EQ(engine.status().largest_batch, 1);
  EXPECT_EQ(results[0].values, engine.upscale({&a}).values);
  EXPECT_EQ(results[1].values, engine.upscale({&b}).values);
}

TEST_F(EngineTest, BatcherAnswersManySessionsAndSparesTheInnocent) {
  write("small");
  auto engine = std::make_shared<Engine>(options(), "small");
  BatcherOptions batching;
  batching.largest_batch = 3;
  batching.latency = std::chrono::milliseconds(20);
  Batcher batcher(engine, batching);
  std::vector<std::thread> sessions;
  std::vector<double> worst(4, 1);
  for (std::size_t s = 0; s < worst.size(); ++s) {
    sessions.emplace_back([&, s] {
      const auto token = batcher.open_session();
      double difference = 0;
      Tensor answer;
      for (int frame = 0; frame < 5; ++frame) {
        const Tensor input = image(5, 6, static_cast<float>(10 * s) + static_cast<float>(frame));
        batcher.upscale({&input}, 0, answer);
        difference = std::max(difference, worst_difference(answer.values, engine->upscale({&input}).values));
      }
      worst[s] = difference;
    });
  }
  for (auto& session : sessions) session.join();
  for (const double w : worst) EXPECT_LT(w, 1e-6);

  const auto a = batcher.open_session(), b = batcher.open_session();
  const Tensor good = image(5, 6);
  Tensor bad = good;
  bad.values[0] = std::numeric_limits<float>::infinity();
  const auto answer_of = [&](const Tensor& input) {
    Tensor answer;
    batcher.upscale({&input}, 0, answer);
    return answer.values.size();
  };
  auto good_answer = std::async(std::launch::async, [&] { return answer_of(good); });
  auto bad_answer = std::async(std::launch::async, [&] { return answer_of(bad); });
  EXPECT_EQ(good_answer.get(), 9U * 20 * 24);
  EXPECT_EQ(error_of([&] { bad_answer.get(); }).code(), ErrorCode::kInvalidArgument);
}

TEST_F(EngineTest, PrecisionNames) {
  EXPECT_EQ(precision_from_string("auto"), Precision::kAuto);
  EXPECT_EQ(precision_from_string("float32"), Precision::kFloat32);
  EXPECT_EQ(precision_from_string("bfloat16"), Precision::kBfloat16);
  EXPECT_THAT(error_of([] { precision_from_string("int8"); }).what(), HasSubstr("int8"));
}

/// A module that answers with what it remembers: the sums of the last two inputs, the oldest first.
TEST_F(EngineTest, RemembersFromFrameToFrame) {
  torch::jit::Module module("Remembering");
  module.define(
      "def forward(self, x, memory):\n"
      "  sums = memory.sum([1, 2, 3]).reshape([-1, 1, 1, 1])\n"
      "  return torch.zeros_like(x).repeat([1, 1, 4, 4]) + sums, "
      "torch.cat([memory.narrow(1, 1, 1), x.sum([1, 2, 3]).reshape([-1, 1, 1, 1])], 1)\n");
  Metadata m = metadata("remembering");
  m.architecture.kind = "foreign";
  m.float32_parameters.clear();
  m.memory = {2, 1, 1};
  save_bundle(module, m, file(m.name));
  Engine engine(options(), "remembering");
  EXPECT_EQ(memory_values(engine.describe()), 2U);

  const Tensor a = image(5, 6), b = image(5, 6, 2);
  std::vector<float> first, second;
  const auto one = engine.upscale({.frames = &a, .left = &first});
  EXPECT_EQ(one.values[0], 0);
  ASSERT_EQ(first.size(), 2U);
  EXPECT_EQ(first[0], 0);
  const auto two = engine.upscale({.frames = &b, .memory = first, .left = &second});
  EXPECT_EQ(two.values[0], first[1]);
  EXPECT_EQ(second[0], first[1]);

  // With others in one batch every stream has its own, and the same bits.
  std::vector<float> left[2];
  const NetworkInput both[] = {{.frames = &a, .left = &left[0]}, {.frames = &b, .memory = first, .left = &left[1]}};
  const auto results = engine.upscale(both);
  EXPECT_EQ(results[0].values, one.values);
  EXPECT_EQ(results[1].values, two.values);
  EXPECT_EQ(left[0], first);
  EXPECT_EQ(left[1], second);

  const std::vector<float> three(3), bad{1, std::numeric_limits<float>::quiet_NaN()};
  EXPECT_THAT(error_of([&] { engine.upscale({.frames = &a, .memory = three}); }).what(),
              HasSubstr("state: 3 numbers, the bundle remembers 2"));
  EXPECT_THAT(error_of([&] { engine.upscale({.frames = &a, .memory = bad}); }).what(), HasSubstr("not finite"));
}

TEST_F(EngineTest, AModuleThatRemembersSomethingElseIsNoBundle) {
  torch::jit::Module module("Forgetful");
  module.define("def forward(self, x, memory):\n  return torch.zeros_like(x).repeat([1, 1, 4, 4]), x\n");
  Metadata m = metadata("forgetful");
  m.architecture.kind = "foreign";
  m.float32_parameters.clear();
  m.memory = {2, 1, 1};
  save_bundle(module, m, file(m.name));
  EXPECT_THAT(error_of([&] { Engine(options(), "forgetful"); }).what(), HasSubstr("another shape"));
}

}  // namespace
}  // namespace pleat::superres
