// `pleat dress`: garments of about the right place onto a body.
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/process.hpp"
#include "common/base/progress.hpp"
#include "common/base/signals.hpp"
#include "common/mesh/garment.hpp"
#include "common/mesh/obj.hpp"
#include "services/cli/command.hpp"
#include "services/simulation/body/animated_body.hpp"
#include "services/simulation/dress/dress.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;

constexpr int kPoseFrames = 40;  // from the rest pose into another one
constexpr int kHoldFrames = 10;  // in which the cloth comes to rest there
constexpr const char* kMaterial = "materials/isotropic-medium.json";

struct Options {
  std::vector<std::string> garments;
  body::AnimatedBody::Source source;
  double start_s = 0, scale = 1;
  dress::DressOptions dress;
  std::string material, out, body_out;
  bool json = false;
};

/// Where each garment goes: FILE.obj for one, a folder's NAME.obj for several.
std::vector<fs::path> outputs(const Options& options) {
  const fs::path out = options.out;
  if (out.extension() == ".obj") {
    if (options.garments.size() > 1)
      throw_invalid_argument("--out " + options.out + ": there are several garments, give a folder");
    return {out};
  }
  std::vector<fs::path> paths;
  for (const std::string& garment : options.garments) {
    paths.push_back(out / (fs::path(garment).stem().string() + ".obj"));
    for (std::size_t k = 0; k + 1 < paths.size(); ++k) {
      if (paths[k] == paths.back()) throw_invalid_argument("two garments would be written to " + paths[k].string());
    }
  }
  return paths;
}

int run_dress(Options options) {
  const std::vector<fs::path> paths = outputs(options);
  std::vector<std::string> notes;
  std::vector<dress::Garment> garments;
  for (const std::string& file : options.garments) {
    garments.push_back({file, read_garment(file, notes, options.scale)});
    require_rest_lengths(garments.back().mesh, file);
  }
  options.dress.material =
      simulation::read_material(options.material.empty() ? shipped_file(kMaterial) : fs::path(options.material));
  body::MotionOptions motion;
  motion.start_s = options.start_s;
  motion.ease_frames = kPoseFrames;
  const bool posed = !options.source.motion.empty();
  const body::AnimatedBody body(options.source, motion, body::Skinning::kLinear);
  for (int k = 1; posed && k <= kPoseFrames + kHoldFrames; ++k) {
    options.dress.then.push_back(body.positions(static_cast<std::size_t>(std::min(k, kPoseFrames))));
  }
  notes.insert(notes.end(), body.notes().begin(), body.notes().end());

  Progress bar("frames", garments.size() * static_cast<std::size_t>(options.dress.grow_frames) +
                             static_cast<std::size_t>(options.dress.settle_frames) + options.dress.then.size());
  const dress::Dressed dressed = dress::dress(garments, body.mesh(), options.dress, [&bar](std::size_t done) {
    bar.update(done);
    if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
  });
  bar.finish();
  notes.insert(notes.end(), dressed.notes.begin(), dressed.notes.end());
  nlohmann::json report = {{"notes", notes}, {"garments", nlohmann::json::array()}};
  if (!options.json) {
    for (const std::string& note : notes) std::printf("note: %s\n", note.c_str());
  }
  for (std::size_t g = 0; g < garments.size(); ++g) {
    if (paths[g].has_parent_path()) fs::create_directories(paths[g].parent_path());
    garments[g].mesh.rest_positions = dressed.garments[g];
    write_obj(paths[g], garments[g].mesh);
    report["garments"].push_back({{"file", paths[g].string()}, {"stretch", dressed.stretch[g]}});
    if (!options.json)
      std::printf("%s: worn, clean; 98 %% of its edges are stretched by %.1f %% at most\n", paths[g].c_str(),
                  100 * (dressed.stretch[g] - 1));
  }
  if (!options.body_out.empty()) {
    Topology mesh = body.mesh().mesh;
    if (posed) mesh.rest_positions = options.dress.then.back();
    write_obj(options.body_out, mesh);
    report["body"] = options.body_out;
    if (!options.json) std::printf("%s\n", options.body_out.c_str());
  }
  if (options.json) std::printf("%s\n", report.dump(2).c_str());
  return kExitDone;
}

}  // namespace

std::vector<Command> add_dress(CLI::App& root) {
  CLI::App* app = root.add_subcommand("dress", "garments of about the right place onto a body");
  const auto options = std::make_shared<Options>();
  app->add_option("garment", options->garments,
                  "garments with material coordinates, about where they are worn; several: the innermost first")
      ->required();
  app->add_option("--body", options->source.body, "skinned mesh with a skeleton in T or A pose: glTF, FBX or Collada")
      ->required();
  app->add_option("--out", options->out, "FILE.obj; a folder where there are several garments")->required();
  app->add_option(
      "--pose", options->source.motion,
      "a motion (BVH, AMC, or a file with an animation): dressed at rest, the body goes into its first pose");
  app->add_option("--asf", options->source.asf, "the skeleton of an AMC motion (default: the one beside it)");
  app->add_option("--start", options->start_s, "seconds of the motion to leave out")->check(CLI::NonNegativeNumber);
  app->add_option("--body-out", options->body_out, "FILE.obj: the body in that pose");
  app->add_option("--material", options->material, "what the cloth is made of (default: isotropic-medium)");
  app->add_option("--scale", options->scale, "metres per unit of the garments")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--reach", options->dress.reach_m, "metres by which a garment may be moved to get around the body")
      ->capture_default_str();
  app->add_option("--threads", options->dress.threads, "0: the processors this process may use")
      ->capture_default_str()
      ->check(CLI::Range(0, 1024));
  add_json_option(*app, options->json, "print one JSON object: notes, garments (file, stretch), body");
  return {{app, [options] { return run_dress(*options); }}};
}

}  // namespace pleat::cli
