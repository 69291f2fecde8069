// Every command with input that is wrong: the exit code is right, and one line on stderr names the cause.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <fstream>
#include <functional>

#include "tests/support/executable.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::test {
namespace {

namespace fs = std::filesystem;

constexpr const char* kGarment =
    "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\nf 1/1 2/2 3/3\nf 2/2 4/4 3/3\n";

std::string scene(const std::string& more) {
  return R"({"name": "fall", "garment_file": "cloth.obj", "isotropic": {"density": 375, "youngs_modulus": 7.5e5, "poissons_ratio": 0.3, "thickness": 4e-4}, "frames": 3)" +
         (more.empty() ? std::string() : ", " + more) + "}";
}

struct Case {
  const char* name;
  std::vector<std::string> arguments;  ///< "@" stands for the folder of the case
  int exit_code;
  const char* cause;
  std::map<std::string, std::string> files = {};
};

void PrintTo(const Case& test, std::ostream* out) { *out << test.name; }

class BadInput : public testing::TestWithParam<Case> {};

TEST_P(BadInput, IsNamedInOneLine) {
  const pleat::test::TemporaryFolder temporary;
  const fs::path& folder = temporary.path();
  const Case& test = GetParam();
  std::map<std::string, std::string> files = {{"cloth.obj", kGarment}, {"models/draping.pt", "x"}, {"file", "x"}};
  for (const auto& [file, text] : test.files) files[file] = text;
  for (const auto& [file, text] : files) {
    fs::create_directories((folder / file).parent_path());
    std::ofstream(folder / file, std::ios::binary) << text;
  }
  std::vector<std::string> arguments = test.arguments;
  for (std::string& argument : arguments)
    for (auto at = argument.find('@'); at != std::string::npos; at = argument.find('@'))
      argument.replace(at, 1, folder.string());
  const Outcome outcome =
      run(built("pleat"), arguments, folder / "outcome", {{"PLEAT_MODELS", (folder / "models").string()}});
  EXPECT_EQ(outcome.exit_code, test.exit_code) << outcome.err;
  ASSERT_EQ(outcome.error_lines().size(), 1u) << outcome.err;
  EXPECT_THAT(outcome.err, testing::StartsWith("pleat: "));
  std::string cause = test.cause;
  if (const auto at = cause.find('@'); at != std::string::npos) cause.replace(at, 1, folder.string());
  EXPECT_THAT(outcome.err, testing::HasSubstr(cause));
  EXPECT_TRUE(outcome.out.empty()) << outcome.out;
}

std::string pc2(std::int32_t points, std::int32_t samples, std::size_t bytes) {
  std::string text("POINTCACHE2\0", 12);
  const auto add = [&text](const void* value) { text.append(static_cast<const char*>(value), 4); };
  const std::int32_t version = 1;
  const float start = 0, rate = 1;
  add(&version);
  add(&points);
  add(&start);
  add(&rate);
  add(&samples);
  return text + std::string(bytes, '\0');
}

std::vector<std::string> enhance(const std::string& rest, const std::string& frames) {
  return {"enhance", "--rest", rest, "--frames", frames, "--out", "@/out"};
}
std::vector<std::string> run_scene() { return {"run", "@/scene.json", "--out", "@/out"}; }

const Case kCases[] = {
    {"no_command", {}, 2, "no command given"},
    {"jobs_of_nobody", {"jobs", "list", "--coordinator", "unix:@/nobody"}, 1, "coordinator at unix:@/nobody"},
    {"jobs_without_id", {"jobs", "remove", "--coordinator", "unix:@/nobody"}, 2, "job"},
    {"token_file_missing", {"jobs", "list", "--coordinator", "unix:@/x", "--token-file", "@/none"}, 2, "@/none"},
    {"unknown_detail", {"run", "@/scene.json", "--out", "@/out", "--detail", "folds"}, 2, "--detail"},
    {"model_without_network",
     {"run", "@/scene.json", "--out", "@/out", "--detail", "fold", "--model", "draping"},
     2,
     "--model draping: --detail fold uses no bundle"},
    {"no_material",
     {"enhance", "--rest", "@/cloth.obj", "--frames", "@/cloth.obj", "--out", "@/out", "--detail", "fold", "--material",
      "@/none.json"},
     2,
     "none.json"},
    {"unknown_command", {"fold"}, 2, "fold"},
    {"mistyped_command", {"exprot"}, 2, "did you mean export?"},
    {"help_of_a_mistyped_command", {"help", "dataset", "generte"}, 2, "did you mean generate?"},
    {"quiet_and_verbose", {"check", "@/cloth.obj", "-q", "-v"}, 2, "--quiet excludes --verbose"},
    {"unknown_option", {"run", "x", "--out", "y", "--speed", "9"}, 2, "--speed"},
    {"run_no_scene", {"run", "--out", "@/out"}, 2, "scene"},
    {"run_no_out", {"run", "@/scene.json"}, 2, "--out"},
    {"run_missing_scene", run_scene(), 2, "scene.json: can't be read"},
    {"run_scene_not_json", run_scene(), 2, "scene.json: not JSON", {{"scene.json", "{frames: 3"}}},
    {"run_unknown_key", run_scene(), 2, "unknown key 'gravty'", {{"scene.json", scene("\"gravty\": []")}}},
    {"run_no_such_vertex",
     run_scene(),
     2,
     "handles[0].vertices[0]: vertex 9 does not exist",
     {{"scene.json", scene(R"("handles": [{"vertices": [9]}])")}}},
    {"run_zero_steps",
     run_scene(),
     2,
     "steps_per_frame must be positive",
     {{"scene.json", scene("\"steps_per_frame\": 0")}}},
    {"run_negative_steps", run_scene(), 2, "-2", {{"scene.json", scene("\"steps_per_frame\": -2")}}},
    {"run_missing_garment",
     run_scene(),
     2,
     "none.obj",
     {{"scene.json",
       R"({"name": "x", "garment_file": "none.obj", "isotropic": {"density": 375, "youngs_modulus": 7.5e5, "poissons_ratio": 0.3, "thickness": 4e-4}, "frames": 1})"}}},
    {"run_missing_material",
     run_scene(),
     2,
     "none.json",
     {{"scene.json", R"({"name": "x", "garment_file": "cloth.obj", "material_file": "none.json", "frames": 1})"}}},
    {"run_zero_frames",
     {"run", "@/scene.json", "--out", "@/out", "--frames", "0"},
     2,
     "--frames",
     {{"scene.json", scene("")}}},
    {"run_missing_model",
     {"run", "@/scene.json", "--out", "@/out", "--model", "nobody"},
     2,
     "nobody.pt",
     {{"scene.json", scene("")}}},
    {"run_out_is_a_file", {"run", "@/scene.json", "--out", "@/file"}, 2, "/file", {{"scene.json", scene("")}}},
    {"run_absent_coordinator",
     {"run", "@/scene.json", "--out", "@/out", "--coordinator", "unix:@/none.sock", "--timeout", "0.3"},
     1,
     "none.sock",
     {{"scene.json", scene("")}}},
    {"run_remote_without_tls",
     {"run", "@/scene.json", "--out", "@/out", "--coordinator", "192.0.2.1:50050"},
     2,
     "192.0.2.1:50050",
     {{"scene.json", scene("")}}},
    {"enhance_missing_rest", enhance("@/none.obj", "@/cloth.obj"), 2, "none.obj"},
    {"enhance_no_material_coordinates",
     enhance("@/bad.obj", "@/bad.obj"),
     2,
     "bad.obj",
     {{"bad.obj", "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"}}},
    {"enhance_nan", enhance("@/bad.obj", "@/bad.obj"), 2, "bad.obj:1", {{"bad.obj", "v nan 0 0\n"}}},
    {"enhance_index_out_of_range",
     enhance("@/bad.obj", "@/bad.obj"),
     2,
     "bad.obj",
     {{"bad.obj", "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 9\n"}}},
    {"enhance_negative_index_out_of_range",
     enhance("@/bad.obj", "@/bad.obj"),
     2,
     "bad.obj:4",
     {{"bad.obj", "v 0 0 0\nv 1 0 0\nv 0 0 1\nf -1 -2 -9\n"}}},
    {"enhance_zero_area_material",
     enhance("@/bad.obj", "@/bad.obj"),
     2,
     "bad.obj",
     {{"bad.obj", "v 0 0 0\nv 1 0 0\nv 0 0 1\nvt 0 0\nvt 0 0\nvt 0 0\nf 1/1 2/2 3/3\n"}}},
    {"enhance_folded_material",
     enhance("@/bad.obj", "@/bad.obj"),
     2,
     "bad.obj",
     {{"bad.obj",
       "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nvt 0.1 0.1\nf 1/1 2/2 3/3\nf 2/2 4/4 3/3\n"}}},
    {"enhance_non_manifold",
     enhance("@/bad.obj", "@/bad.obj"),
     2,
     "bad.obj",
     {{"bad.obj", "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nv 0 1 0\nf 1 2 3\nf 2 1 4\nf 1 2 5\n"}}},
    {"enhance_missing_frames", enhance("@/cloth.obj", "@/none.pc2"), 2, "none.pc2"},
    {"enhance_empty_glob", enhance("@/cloth.obj", "@/frame*.obj"), 2, "no file matches"},
    {"enhance_wrong_vertex_count",
     enhance("@/cloth.obj", "@/frame.obj"),
     2,
     "3 vertices, the rest mesh 4",
     {{"frame.obj", "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"}}},
    {"enhance_truncated_pc2",
     enhance("@/cloth.obj", "@/frames.pc2"),
     2,
     "frames.pc2: truncated",
     {{"frames.pc2", pc2(4, 2, 50)}}},
    {"enhance_pc2_of_another_mesh",
     enhance("@/cloth.obj", "@/frames.pc2"),
     2,
     "5 vertices, the rest mesh 4",
     {{"frames.pc2", pc2(5, 1, 60)}}},
    {"enhance_not_hdf5", enhance("@/cloth.obj", "@/frames.h5"), 2, "frames.h5", {{"frames.h5", "text"}}},
    {"enhance_bad_sphere",
     {"enhance", "--rest", "@/cloth.obj", "--frames", "@/cloth.obj", "--out", "@/out", "--obstacle", "sphere:0,0,0"},
     2,
     "sphere:0,0,0"},
    {"enhance_missing_obstacle",
     {"enhance", "--rest", "@/cloth.obj", "--frames", "@/cloth.obj", "--out", "@/out", "--obstacle", "@/body.obj"},
     2,
     "body.obj"},
    {"enhance_bad_fps",
     {"enhance", "--rest", "@/cloth.obj", "--frames", "@/cloth.obj", "--out", "@/out", "--fps", "-1"},
     2,
     "--fps"},
    {"enhance_missing_model",
     {"enhance", "--rest", "@/cloth.obj", "--frames", "@/cloth.obj", "--out", "@/out", "--model", "@/none.pt"},
     2,
     "none.pt"},
    {"export_missing_result", {"export", "@/none.h5", "--format", "pc2"}, 2, "none.h5"},
    {"export_not_a_result", {"export", "@/file", "--format", "pc2"}, 2, "/file"},
    {"export_unknown_format", {"export", "@/file", "--format", "fbx"}, 2, "fbx"},
    {"export_unknown_mesh", {"export", "@/file", "--format", "pc2", "--which", "best"}, 2, "best"},
    {"dataset_no_action", {"dataset"}, 2, "dataset: no command given"},
    {"dataset_info_missing", {"dataset", "info", "@/none"}, 2, "/none"},
    {"dataset_verify_missing", {"dataset", "verify", "@/none"}, 2, "/none"},
    {"dataset_unknown_set", {"dataset", "generate", "@/set", "--set", "dancing"}, 2, "dancing"},
    {"dataset_missing_garment", {"dataset", "generate", "@/set", "--garment", "@/none.obj"}, 2, "none.obj"},
    {"dataset_bad_frames", {"dataset", "generate", "@/set", "--frames", "-5"}, 2, "--frames"},
    {"eval_missing_dataset", {"eval", "--dataset", "@/none"}, 2, "/none"},
    {"eval_no_dataset", {"eval"}, 2, "--dataset"},
    {"eval_both_without_a_bundle", {"eval", "--dataset", "@/none", "--detail", "both"}, 2, "--detail both"},
    {"eval_bundle_that_is_not_used",
     {"eval", "--dataset", "@/none", "--detail", "fold", "--model", "m"},
     2,
     "--model m"},
    {"learn_no_scene", {"learn", "--out", "@/own.pt"}, 2, "scenes"},
    {"learn_missing_scene", {"learn", "@/none.json", "--out", "@/own.pt"}, 2, "none.json"},
    {"learn_no_bundle_name", {"learn", "@/scene.json", "--out", "@/own"}, 2, "own: a bundle's name ends with .pt"},
    {"learn_missing_base",
     {"learn", "@/scene.json", "--out", "@/own.pt", "--base", "@/none.pt"},
     2,
     "none.pt: no such model bundle",
     {{"scene.json", scene("")}}},
    {"learn_unusable_base",
     {"learn", "@/scene.json", "--out", "@/own.pt", "--base", "draping"},
     2,
     "draping.pt: no bundle to begin with",
     {{"scene.json", scene("")}}},
    {"learn_unknown_key",
     {"learn", "@/scene.json", "--out", "@/own.pt", "--base", "none"},
     2,
     "unknown key 'gravty'",
     {{"scene.json", scene("\"gravty\": []")}}},
    {"learn_in_a_foreign_folder",
     {"learn", "@/scene.json", "--out", "@/own.pt", "--base", "none"},
     2,
     "own.learn: has files that pleat learn did not make",
     {{"scene.json", scene("")}, {"own.learn/notes.txt", "mine"}}},
    {"learn_over_a_foreign_bundle",
     {"learn", "@/scene.json", "--out", "@/own.pt", "--base", "none"},
     2,
     "own.pt: is there and was not made by Pleat",
     {{"scene.json", scene("")}, {"own.pt", "mine"}}},
    {"dataset_garment_of_a_scene",
     {"dataset", "generate", "@/out", "--scene", "@/scene.json", "--garment", "@/cloth.obj"},
     2,
     "--garment is for sets",
     {{"scene.json", scene("")}}},
    {"dataset_scene_and_set",
     {"dataset", "generate", "@/out", "--scene", "@/scene.json", "--set", "hitting"},
     2,
     "--scene"},
    {"bench_tables_over_a_foreign_page",
     {"bench", "tables", "--out", "@/out"},
     2,
     "tables.html: is there and was not made by Pleat",
     {{"out/tables.html", "mine"}}},
    {"bench_unknown", {"bench", "speed"}, 2, "speed"},
    {"bench_missing_scene", {"bench", "conversion", "--scene", "@/none.json"}, 2, "none.json"},
    {"health_absent",
     {"health", "unix:@/none.sock", "pleat.v1.Refinement", "--timeout", "0.3"},
     1,
     "pleat.v1.Refinement"},
    {"health_no_service", {"health", "unix:@/none.sock"}, 2, "service"},
    {"up_beyond_this_host", {"up", "--listen", "0.0.0.0:50050", "--data", "@/data"}, 2, "0.0.0.0:50050"},
};

INSTANTIATE_TEST_SUITE_P(Commands, BadInput, testing::ValuesIn(kCases),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(GoodUsage, HelpAndVersionGoToStandardOutput) {
  const pleat::test::TemporaryFolder temporary;
  for (const std::vector<std::string>& arguments : std::vector<std::vector<std::string>>{
           {"--help"}, {"--version"}, {"run", "--help"}, {"dataset", "--help"}, {"help", "dataset", "info"}}) {
    const Outcome outcome = run(built("pleat"), arguments, temporary.path() / "usage");
    EXPECT_EQ(outcome.exit_code, 0);
    EXPECT_FALSE(outcome.out.empty());
    EXPECT_TRUE(outcome.err.empty()) << outcome.err;
  }
}

}  // namespace
}  // namespace pleat::test
