// Refined frames before an independent judge: CGAL. Frames as in `pleat bench refinement`: of a data set, enhanced by a
// bundle, or of a scene with wrinkles; noise makes them hard. Ends with exit code 1 if any frame is not clean, or if
// none had anything to repair although noise was asked for.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <optional>
#include <random>

#include "common/base/error.hpp"
#include "services/evaluation/bench_inputs.hpp"
#include "services/refinement/refiner.hpp"
#include "tests/support/cgal_judge.hpp"

namespace {

using namespace pleat;  // a program of its own

int run(const evaluation::BenchOptions& options, float noise) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal(0, noise);
  std::optional<refinement::Refiner> refiner;
  const evaluation::RefinementSetting* setting = nullptr;
  std::size_t frames = 0, unclean = 0, dirty_inputs = 0, changed = 0;
  refinement::RefinedMesh refined;
  const auto begin = [&](const evaluation::RefinementSetting& s) {
    setting = &s;
    refiner.emplace(s.coarse, s.subdivision, s.shapes);
  };
  evaluation::visit_refinement_inputs(options, begin, [&](const evaluation::RefinementInput& input) {
    Positions fine = input.fine;
    if (noise > 0) fine += Positions::NullaryExpr(fine.rows(), 3, [&] { return normal(random); });
    refiner->refine(input.coarse, fine, input.obstacles, refined);
    ++frames;
    dirty_inputs += refined.report.pairs_before + refined.report.penetrations_before > 0 ? 1 : 0;
    changed += refined.report.vertices_moved > 0 ? 1 : 0;
    const test::Judgement judgement =
        test::judge(refined.positions, setting->subdivision.fine.faces, setting->shapes, input.obstacles);
    if (judgement.clean()) return;
    ++unclean;
    std::printf("%s: %zu self-intersections, %zu penetrations: %s\n", input.name.c_str(), judgement.self_intersections,
                judgement.penetrations, judgement.first.c_str());
  });
  std::printf("%zu frames, %zu of them not clean before refinement, %zu changed by it; %zu not clean after it\n",
              frames, dirty_inputs, changed, unclean);
  return unclean == 0 && frames > 0 && (noise == 0 || changed > 0) ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("refined frames before CGAL");
  evaluation::BenchOptions options;
  app.add_option("--dataset", options.dataset, "folder of a data set, for its test frames");
  app.add_option("--models", options.models, "folder of the model bundles");
  app.add_option("--model", options.model, "bundle that enhances the data set's frames");
  app.add_option("--scene", options.scene, "scene file, without a data set");
  app.add_option("--frames", options.frames, "frames")->capture_default_str();
  float noise = 0;
  app.add_option("--noise", noise, "standard deviation of noise on the fine vertices, metres")
      ->check(CLI::Range(0.f, 1.f));
  CLI11_PARSE(app, argc, argv);
  try {
    return run(options, noise);
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
