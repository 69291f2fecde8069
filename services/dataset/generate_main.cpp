// pleat-generate: `pleat dataset` for machines without gRPC.
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "services/dataset/generate.hpp"
#include "services/dataset/verify.hpp"

namespace {

using pleat::dataset::GenerateOptions;
using pleat::dataset::Progress;

constexpr const char* kUsage =
    "usage: pleat-generate FOLDER [--set draping|hitting|sheet|disk] [--rounds N] [--scale small|full] [--frames N]\n"
    "                      [--train N] [--test N] [--extra N]\n"
    "                      [--seed N] [--workers N] [--garment OBJ] [--material JSON] [--revision TEXT] "
    "[--fine tracked|free] [--no-deflate]\n"
    "       pleat-generate --info FOLDER\n"
    "       pleat-generate --verify FOLDER [--stride N]\n";

int to_number(const std::string& flag, const std::string& text) {
  try {
    std::size_t end = 0;
    const int value = std::stoi(text, &end);
    if (end == text.size() && value >= 0) return value;
  } catch (const std::exception&) {
  }
  pleat::throw_invalid_argument(flag + ": '" + text + "' is not a whole number");
}

void print(const Progress& progress) {
  static double last = -10;
  if (progress.message.empty() && progress.elapsed_s - last < 10) return;
  last = progress.elapsed_s;
  std::printf("%llu of %llu frames, %.0f s, %.0f s left%s%s\n", static_cast<unsigned long long>(progress.frames_done),
              static_cast<unsigned long long>(progress.frames), progress.elapsed_s, progress.left_s,
              progress.message.empty() ? "" : ": ", progress.message.c_str());
  std::fflush(stdout);
}

int verify(const std::string& folder, int stride) {
  const auto report = pleat::dataset::verify(folder, {static_cast<std::uint64_t>(stride)}, [](const std::string& line) {
    std::printf("%s\n", line.c_str());
    std::fflush(stdout);
  });
  for (const std::string& problem : report.problems) std::printf("problem: %s\n", problem.c_str());
  std::printf(
      "%llu sequences, %llu frames, %llu judged: %llu self-intersections, %llu penetrations; feature vertices "
      "%.4f m off on average, %.4f m at most\n",
      static_cast<unsigned long long>(report.sequences), static_cast<unsigned long long>(report.frames),
      static_cast<unsigned long long>(report.frames_judged), static_cast<unsigned long long>(report.self_intersections),
      static_cast<unsigned long long>(report.penetrations), report.feature_distance_mean_m,
      report.feature_distance_max_m);
  return report.problems.empty() ? 0 : 1;
}

int run(const std::vector<std::string>& arguments) {
  GenerateOptions options;
  options.scenes.material = "deploy/materials/gray-interlock.json";
  std::string mode = "generate", folder;
  int stride = 1;
  int frames = 0, train = -1, test = -1;
  bool full = false;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string& flag = arguments[i];
    const auto value = [&]() -> const std::string& {
      if (i + 1 >= arguments.size()) pleat::throw_invalid_argument(flag + " needs a value");
      return arguments[++i];
    };
    if (flag == "--help" || flag == "-h") {
      std::printf("%s", kUsage);
      return 0;
    } else if (flag == "--info" || flag == "--verify") {
      mode = flag.substr(2);
    } else if (flag == "--set") {
      options.scenes.set = value();
    } else if (flag == "--scale") {
      const std::string& scale = value();
      if (scale != "small" && scale != "full") pleat::throw_invalid_argument("--scale: small or full");
      full = scale == "full";
    } else if (flag == "--fine") {
      const std::string& fine = value();
      if (fine != "tracked" && fine != "free") pleat::throw_invalid_argument("--fine: tracked or free");
      options.scenes.tracked = fine == "tracked";
    } else if (flag == "--frames") {
      frames = to_number(flag, value());
    } else if (flag == "--train") {
      train = to_number(flag, value());
    } else if (flag == "--test") {
      test = to_number(flag, value());
    } else if (flag == "--extra") {
      options.scenes.extra = to_number(flag, value());
    } else if (flag == "--rounds") {
      options.scenes.rounds = to_number(flag, value());
    } else if (flag == "--seed") {
      options.scenes.seed = static_cast<std::uint64_t>(to_number(flag, value()));
    } else if (flag == "--workers") {
      options.workers = to_number(flag, value());
    } else if (flag == "--stride") {
      stride = to_number(flag, value());
    } else if (flag == "--garment") {
      options.scenes.garment = value();
    } else if (flag == "--material") {
      options.scenes.material = value();
    } else if (flag == "--revision") {
      options.git_revision = value();
    } else if (flag == "--no-deflate") {
      options.deflate = false;
    } else if (!flag.empty() && flag[0] == '-') {
      pleat::throw_invalid_argument("unknown option " + flag);
    } else if (folder.empty()) {
      folder = flag;
    } else {
      pleat::throw_invalid_argument("more than one folder: " + flag);
    }
  }
  if (folder.empty()) pleat::throw_invalid_argument("which folder?");
  if (mode == "verify") return verify(folder, stride);
  if (mode == "info") {
    for (const std::string& line : pleat::dataset::describe(folder)) std::printf("%s\n", line.c_str());
    return 0;
  }
  options.folder = folder;
  if (options.scenes.garment.empty()) {
    options.scenes.garment = "deploy/" + pleat::dataset::default_garment(options.scenes.set);
  }
  const pleat::dataset::SetSize size = pleat::dataset::set_size(options.scenes.set, full);
  options.scenes.frames = frames > 0 ? frames : size.frames;
  options.scenes.train = train >= 0 ? train : size.train;
  options.scenes.test = test >= 0 ? test : size.test;
  pleat::dataset::generate(options, print);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run({argv + 1, argv + argc});
  } catch (const pleat::Error& error) {
    std::fprintf(stderr, "pleat-generate: %s\n", error.what());
    const bool usage =
        error.code() == pleat::ErrorCode::kInvalidArgument || error.code() == pleat::ErrorCode::kNotFound;
    if (usage) std::fprintf(stderr, "%s", kUsage);
    return usage ? 2 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "pleat-generate: %s\n", error.what());
    return 1;
  }
}
