// bench_result_judged: every frame of a result file before an independent judge, CGAL: the coarse and the enhanced
// cloth against themselves and against the obstacles as they are. Ends with exit code 1 if any frame is not clean.
#include <CLI/CLI.hpp>
#include <cstdio>

#include "common/base/error.hpp"
#include "common/store/result.hpp"
#include "tests/support/cgal_judge.hpp"

namespace {

using namespace pleat;  // a program of its own

int run(const std::string& path, std::uint64_t first, std::uint64_t stride) {
  const ResultReader reader(path);
  const auto& info = reader.info();
  std::size_t frames = 0, unclean = 0;
  for (std::uint64_t t = first; t < reader.frames_complete(); t += stride) {
    const auto obstacles = reader.obstacles(t, t + 1).at(0);
    ++frames;
    bool clean = true;
    const auto judge = [&](const char* name, const Positions& cloth, const Faces& faces) {
      const test::Judgement judgement = test::judge(cloth, faces, info.obstacles, obstacles);
      if (judgement.clean()) return;
      clean = false;
      std::printf("frame %llu, %s: %zu self-intersections, %zu penetrations: %s\n", static_cast<unsigned long long>(t),
                  name, judgement.self_intersections, judgement.penetrations, judgement.first.c_str());
    };
    judge("coarse", reader.coarse(t, t + 1).at(0), info.topology.coarse.faces);
    judge("enhanced", reader.enhanced(t, t + 1).at(0), info.topology.fine.faces);
    unclean += clean ? 0 : 1;
    std::fflush(stdout);
  }
  std::printf("%zu frames judged, %zu not clean\n", frames, unclean);
  return unclean == 0 && frames > 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Judges every frame of a result with CGAL: self-intersections and penetrations, coarse and enhanced.");
  std::string path;
  std::uint64_t first = 0, stride = 1;
  app.add_option("result", path, "result.h5")->required();
  app.add_option("--first", first, "first frame")->capture_default_str();
  app.add_option("--stride", stride, "every n-th frame")->capture_default_str()->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  try {
    return run(path, first, stride);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_result_judged: %s\n", error.what());
    return 1;
  }
}
