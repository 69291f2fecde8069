// bench_solver_families: error against milliseconds of three families of solvers on the same energies and contact: the
// engine's linearised implicit Euler, small-step XPBD, vertex block descent. A measurement, not a test.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/machine.hpp"
#include "common/base/statistics.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/bench/rivals/block_descent.hpp"
#include "tests/bench/rivals/xpbd.hpp"

namespace {

using nlohmann::json;
using pleat::Positions;
using pleat::simulation::Scene;
using pleat::simulation::Simulation;

// Everything runs on the calling thread: its processor time is the time on a quiet machine, also on a busy one.
double processor_ms() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

struct Run {
  Positions middle, last;  // after half of the frames, and after all
  std::vector<double> frame_ms;

  void add(int frame, int frames, double ms, const Positions& positions) {
    frame_ms.push_back(ms);
    if (frame == frames / 2) middle = positions;
    last = positions;
  }
};
/// A solver of a family with its parameters, ready to simulate from the start.
struct Candidate {
  std::string family, parameters;
  std::function<Run()> run;
};

Run run_engine(Scene scene, int steps, int frames) {
  scene.steps_per_frame = steps;
  scene.frames = frames + 1;
  Simulation simulation(std::move(scene), pleat::simulation::Mode::kCoarse);
  Run run;
  simulation.next_frame();
  for (int k = 1; k <= frames; ++k) {
    const double start = processor_ms();
    const Positions positions = simulation.next_frame().coarse.positions;
    run.add(k, frames, processor_ms() - start, positions);
  }
  return run;
}

Run run_rival(pleat::bench::RivalCloth& cloth, int contact_steps, int frames) {
  Run run;
  for (int k = 1; k <= frames; ++k) {
    const double start = processor_ms();
    cloth.frame(contact_steps);
    run.add(k, frames, processor_ms() - start, cloth.positions());
  }
  return run;
}

double rms_mm(const Positions& a, const Positions& b) {
  const Eigen::MatrixXd difference = a.cast<double>() - b.cast<double>();
  return 1e3 * std::sqrt(difference.rowwise().squaredNorm().mean());
}

/// The candidates of one scene. Every family's first is its converged run.
class Families {
 public:
  Families(const Scene& scene, int frames, int contact_steps)
      : scene_(scene), frames_(frames), contact_steps_(contact_steps) {
    Scene first = scene;
    first.frames = 1;
    Simulation simulation(std::move(first), pleat::simulation::Mode::kCoarse);
    garment_ = simulation.coarse();
    start_ = simulation.next_frame().coarse.positions;
    const double mismatch = pleat::bench::Xpbd(scene_, garment_, start_, 1).force_mismatch();
    if (!(mismatch < 1e-3)) throw std::runtime_error("the rivals' forces are not the engine's");
  }

  Candidate engine(int steps) const {
    return {"engine", std::to_string(steps) + " steps", [this, steps] { return run_engine(scene_, steps, frames_); }};
  }
  Candidate xpbd(int substeps, int contact_steps) const {
    return {"XPBD", std::to_string(substeps) + " sub-steps", [this, substeps, contact_steps] {
              pleat::bench::Xpbd cloth(scene_, garment_, start_, substeps / contact_steps);
              return run_rival(cloth, contact_steps, frames_);
            }};
  }
  Candidate block_descent(int steps, int sweeps, double radius) const {
    const std::string name = radius > 0 ? "block descent, Chebyshev" : "block descent";
    return {name, std::to_string(steps) + " steps x " + std::to_string(sweeps) + " sweeps",
            [this, steps, sweeps, radius] {
              pleat::bench::BlockDescent cloth(scene_, garment_, start_, {sweeps, radius});
              return run_rival(cloth, steps, frames_);
            }};
  }

  std::vector<std::vector<Candidate>> all(bool descend, double radius) const {
    std::vector<std::vector<Candidate>> families(2);
    for (const int steps : {256, 1, 2, 4, 8, 16, 32}) families[0].push_back(engine(steps));
    families[1].push_back(xpbd(1024, 64));
    for (const int substeps : {8, 16, 32, 64, 128, 256}) families[1].push_back(xpbd(substeps, contact_steps_));
    if (!descend) return families;
    families.emplace_back();
    families[2].push_back(block_descent(128, 16, 0));
    for (const int sweeps : {4, 16, 64}) families[2].push_back(block_descent(4, sweeps, 0));
    for (const int sweeps : {2, 8, 32}) families[2].push_back(block_descent(8, sweeps, 0));
    for (const int sweeps : {2, 8, 32}) families[2].push_back(block_descent(16, sweeps, 0));
    for (const int sweeps : {1, 4, 16}) families[2].push_back(block_descent(32, sweeps, 0));
    for (const int sweeps : {8, 16}) families[2].push_back(block_descent(8, sweeps, radius));
    return families;
  }

 private:
  Scene scene_;
  int frames_, contact_steps_;
  pleat::Topology garment_;
  Positions start_;
};

json measure(const Scene& scene, bool contact, int frames, int contact_steps, bool descend, double radius) {
  Scene switched = scene;
  switched.contact.self_collision = contact;
  const Families families(switched, frames, contact_steps);
  const std::string middle = std::to_string(frames / 2), last = std::to_string(frames);
  std::printf("\nself-contact %s: RMS in mm from the converged run of\n%-26s %-24s %10s %10s %10s %10s %10s\n",
              contact ? "on" : "off", "family", "parameters", "median ms", ("own @" + middle).c_str(),
              ("own @" + last).c_str(), ("engine @" + middle).c_str(), ("engine @" + last).c_str());
  json rows = json::array();
  Run engine_truth;
  for (const auto& family : families.all(descend, radius)) {
    Run own_truth;
    for (const Candidate& candidate : family) {
      const Run run = candidate.run();
      const bool converged = &candidate == &family.front();
      if (converged) own_truth = run;
      if (engine_truth.frame_ms.empty()) engine_truth = run;
      const double ms = pleat::median(run.frame_ms);
      const double own_middle = rms_mm(run.middle, own_truth.middle), own_last = rms_mm(run.last, own_truth.last),
                   engine_middle = rms_mm(run.middle, engine_truth.middle),
                   engine_last = rms_mm(run.last, engine_truth.last);
      std::printf("%-26s %-24s %10.2f %10.2f %10.2f %10.2f %10.2f\n", candidate.family.c_str(),
                  candidate.parameters.c_str(), ms, own_middle, own_last, engine_middle, engine_last);
      std::fflush(stdout);
      rows.push_back({{"family", candidate.family},
                      {"parameters", candidate.parameters},
                      {"contact", contact},
                      {"converged", converged},
                      {"ms", ms},
                      {"rms_own_middle_mm", own_middle},
                      {"rms_own_mm", own_last},
                      {"rms_engine_middle_mm", engine_middle},
                      {"rms_engine_mm", engine_last}});
    }
  }
  return rows;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Error against milliseconds of three families of solvers on the same energies and contact, one thread.\n"
      "Milliseconds are processor time, the median of the frames; errors are RMS over vertices half way and at\n"
      "the end, against the family's own converged run (its first row) and against the engine's. The engine and block\n"
      "descent treat contact once a step, XPBD --contact-steps times a frame, linearised over the sub-steps.");
  std::string scene_file = "deploy/scenes/draping.json", json_file;
  int frames = 20, contact_steps = 8;
  int rounds = 0;
  bool contact_only = false, skip_descent = false;
  double radius = 0.9;
  app.add_option("scene", scene_file, "scene file")->capture_default_str();
  app.add_option("--frames", frames, "frames")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--contact-steps", contact_steps, "contact steps a frame of XPBD; a divisor of 8")
      ->check(CLI::IsMember({1, 2, 4, 8}))
      ->capture_default_str();
  app.add_option("--spectral-radius", radius, "of Chebyshev's acceleration")
      ->check(CLI::Range(0.01, 0.999))
      ->capture_default_str();
  app.add_option("--rounds", rounds, "subdivides the garment first")->check(CLI::Range(0, 3))->capture_default_str();
  app.add_flag("--contact-only", contact_only, "leaves the runs without contact out");
  app.add_flag("--skip-block-descent", skip_descent, "leaves the slowest family out");
  app.add_option("--json", json_file, "writes the rows to this file");
  CLI11_PARSE(app, argc, argv);
  try {
    Scene scene = pleat::simulation::scene_from_message(pleat::presentation::read_scene_file(scene_file));
    scene.threads = 1;
    scene.garment = pleat::subdivide(scene.garment, rounds).fine;
    std::printf("%s: %ld vertices, %d frames of %g ms\n", scene_file.c_str(),
                static_cast<long>(scene.garment.vertex_count()), frames, 1e3 * scene.frame_time_s);
    json rows = json::array();
    for (const bool contact : {true, false}) {
      if (contact_only && !contact) continue;
      for (json& row : measure(scene, contact, frames, contact_steps, !skip_descent, radius))
        rows.push_back(std::move(row));
    }
    if (!json_file.empty()) {
      std::ofstream(json_file) << json{{"scene", scene_file},
                                       {"vertices", scene.garment.vertex_count()},
                                       {"frames", frames},
                                       {"rows", rows},
                                       {"machine", pleat::machine_info()},
                                       {"git_revision", pleat::git_revision()}}
                                      .dump(2)
                               << "\n";
    }
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_solver_families: %s\n", error.what());
    return 1;
  }
}
