// `pleat learn`: a bundle, its page and a line with the result, from nothing and from a bundle; interrupted, it goes
// on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "common/mesh/obj.hpp"
#include "tests/support/executable.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::test {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

std::string text_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// 6 x 5 vertices, 5 cm apart, flat.
Topology cloth() {
  constexpr int kColumns = 6, kRows = 5;
  Topology mesh;
  mesh.rest_positions.resize(kColumns * kRows, 3), mesh.uv.resize(kColumns * kRows, 2);
  mesh.faces.resize(2 * (kColumns - 1) * (kRows - 1), 3);
  Eigen::Index face = 0;
  for (int j = 0; j < kRows; ++j) {
    for (int i = 0; i < kColumns; ++i) {
      const float u = 0.05F * static_cast<float>(i), v = 0.05F * static_cast<float>(j);
      mesh.rest_positions.row(j * kColumns + i) << u, 0, -v;
      mesh.uv.row(j * kColumns + i) << u, v;
      if (i + 1 == kColumns || j + 1 == kRows) continue;
      const auto a = static_cast<std::uint32_t>(j * kColumns + i), b = a + kColumns;
      mesh.faces.row(face++) << a, a + 1, b + 1;
      mesh.faces.row(face++) << a, b + 1, b;
    }
  }
  mesh.uv_faces = mesh.faces;
  return mesh;
}

TEST(Learn, MakesABundleOfAGarmentAndGoesOnWhenInterrupted) {
  const TemporaryFolder temporary;
  const fs::path root = temporary.path(), out = root / "own.pt";
  write_obj(root / "cloth.obj", cloth());
  std::ofstream(root / "hung.json") << R"({"name": "hung", "garmentFile": "cloth.obj",
    "isotropic": {"density": 375, "youngs_modulus": 7.5e5, "poissons_ratio": 0.3, "thickness": 4e-4},
    "placement": {"translation": [0, 1, 0]}, "stepsPerFrame": 4, "frames": 12,
    "handles": [{"vertices": [24, 29]}], "perturbationM": 0.002})";
  const std::map<std::string, std::string> environment = {{"PLEAT_MODELS", root.string()}};
  std::vector<std::string> arguments{
      "learn", (root / "hung.json").string(), "--out", out.string(), "--sequences", "4", "--minutes", "0.15"};
  {
    Background begun(built("pleat"), arguments, root / "begun", environment);
    for (int tries = 0; tries < 6000 && !fs::exists(root / "own.learn" / "train.json"); ++tries) usleep(20'000);
    begun.send(SIGINT);
    const Outcome outcome = begun.wait();
    ASSERT_EQ(outcome.exit_code, 1) << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr("the same command goes on"));
    EXPECT_FALSE(fs::exists(out));
  }
  const auto made = fs::last_write_time(root / "own.learn" / "data" / "sequences" / "hung-02.h5");
  const Outcome outcome = run(built("pleat"), arguments, root / "outcome", environment);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(fs::last_write_time(root / "own.learn" / "data" / "sequences" / "hung-02.h5"), made);
  EXPECT_THAT(outcome.out, HasSubstr("own.pt: RMSE "));
  EXPECT_THAT(outcome.out, HasSubstr("; 0 intersections"));
  const std::string page = text_of(root / "own.html");
  EXPECT_THAT(page, HasSubstr("<th>fold</th><th>pleat:learned</th>"));
  EXPECT_THAT(page, HasSubstr("hung, hung-03"));
  EXPECT_THAT(page, HasSubstr("fresh weights"));
  ASSERT_TRUE(fs::exists(out));

  // The learned one is a base, and a bundle that is ours may be replaced.
  arguments[3] = (root / "more.pt").string();
  arguments.insert(arguments.end(), {"--base", out.string()});
  const Outcome more = run(built("pleat"), arguments, root / "more", environment);
  ASSERT_EQ(more.exit_code, 0) << more.err;
  EXPECT_THAT(more.out, HasSubstr("bundle own "));
  EXPECT_THAT(text_of(root / "more.html"), HasSubstr("<th>pleat:base</th><th>pleat:learned</th>"));
  const std::string trained = text_of(root / "more.learn" / "logs" / "train.log");
  EXPECT_THAT(trained, HasSubstr("weights begin as those of"));

  arguments[5] = "5";
  const Outcome other = run(built("pleat"), arguments, root / "other", environment);
  EXPECT_EQ(other.exit_code, 2);
  EXPECT_THAT(other.err, HasSubstr("begun with other scenes or options"));
}

}  // namespace
}  // namespace pleat::test
