// `pleat body`: a rigged character and a motion to the animated mesh of a scene.
#include <cstdio>
#include <nlohmann/json.hpp>

#include "common/base/limits.hpp"
#include "common/base/progress.hpp"
#include "common/base/signals.hpp"
#include "common/mesh/obj.hpp"
#include "common/store/hdf5.hpp"
#include "services/cli/command.hpp"
#include "services/presentation/export/export.hpp"
#include "services/simulation/body/animated_body.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxFastPlaces = 5;

struct BodyOptions {
  body::AnimatedBody::Source source;
  body::MotionOptions motion;
  body::SpeedLimits limits;
  std::string out, skinning = "linear";
  bool keep_place = false, json = false;
  std::size_t frames = 0;
};

/// What the body is, in which places its motion is too fast, and where it was written.
nlohmann::json describe(const body::AnimatedBody& body, const BodyOptions& options, std::size_t frames) {
  nlohmann::json description = {{"vertices", body.mesh().mesh.vertex_count()},
                                {"joints", body.mesh().skeleton.size()},
                                {"frames", frames},
                                {"frame_time_s", options.motion.frame_time_s},
                                {"notes", body.notes()},
                                {"too_fast", nlohmann::json::array()}};
  for (const auto& place : body::find_fast(body.motion(), options.limits))
    description["too_fast"].push_back(body::describe(place, options.limits));
  return description;
}

void print(const nlohmann::json& description) {
  std::printf("body: %zu vertices, %zu joints\n", description.at("vertices").get<std::size_t>(),
              description.at("joints").get<std::size_t>());
  std::printf("motion: %zu frames of %g s\n", description.at("frames").get<std::size_t>(),
              description.at("frame_time_s").get<double>());
  for (const auto& note : description.at("notes")) std::printf("note: %s\n", note.get<std::string>().c_str());
  const nlohmann::json& fast = description.at("too_fast");
  for (std::size_t i = 0; i < std::min(fast.size(), kMaxFastPlaces); ++i)
    std::printf("too fast: %s\n", fast[i].get<std::string>().c_str());
  if (fast.size() > kMaxFastPlaces) std::printf("too fast: and %zu more joints\n", fast.size() - kMaxFastPlaces);
}

/// `positions` (T, V, 3) and `faces` (F, 3) at the root.
void write_h5(const fs::path& path, const presentation::ExportInput& input,
              const presentation::ExportProgress& progress) {
  const fs::path partial = path.string() + ".partial";
  const auto lock = hdf5::lock();
  hdf5::File file = hdf5::File::create(partial);
  const auto vertices = static_cast<hsize_t>(input.topology.vertex_count());
  file.set_attribute("/", "frame_time_s", input.frame_time_s);
  file.write_array("/faces", H5T_NATIVE_UINT32, {static_cast<hsize_t>(input.topology.face_count()), 3},
                   input.topology.faces.data());
  file.make_rows("/positions", H5T_NATIVE_FLOAT, {input.frame_count, vertices, 3}, 1, true);
  {
    hdf5::Rows rows = file.rows("/positions");
    for (std::size_t k = 0; k < input.frame_count; ++k) {
      rows.write(H5T_NATIVE_FLOAT, k, 1, input.frame(k).data());
      progress(k + 1);
    }
  }
  file.close();
  file.rename(path);
}

int make_body(BodyOptions options) {
  options.motion.at_rest_place = !options.keep_place;
  const fs::path out = options.out;
  const std::string kind = out.extension().string();
  if (kind != ".h5" && kind != ".pc2" && kind != ".obj")
    throw_invalid_argument("--out " + options.out + ": expected a name that ends in .h5, .pc2 or .obj");
  const body::AnimatedBody animated(
      options.source, options.motion,
      options.skinning == "dual" ? body::Skinning::kDualQuaternion : body::Skinning::kLinear);
  const std::size_t frames = options.frames > 0 ? options.frames : animated.frame_count();
  nlohmann::json description = describe(animated, options, frames);
  if (!options.json) print(description);
  if (out.has_parent_path()) fs::create_directories(out.parent_path());
  presentation::ExportInput input;
  input.name = out.stem().string();
  input.topology = animated.mesh().mesh;
  input.frame_count = frames;
  input.frame_time_s = options.motion.frame_time_s;
  input.frame = [&animated](std::size_t frame) { return animated.positions(frame); };
  Progress bar("frames", frames);
  const auto progress = [&bar](std::size_t done) {
    bar.update(done);
    if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted after " + std::to_string(done) + " frames");
  };
  fs::path mesh = out;
  mesh.replace_extension(".obj");
  if (kind == ".pc2") {
    presentation::export_frames(input, presentation::ExportFormat::kPc2,
                                out.has_parent_path() ? out.parent_path() : fs::path("."), progress);
  } else {
    write_obj(mesh, input.topology);
    if (kind == ".h5") write_h5(out, input, progress);
  }
  bar.finish();
  if (kind != ".obj") description["files"].push_back(out.string());
  description["files"].push_back(mesh.string());
  if (options.json)
    std::printf("%s\n", description.dump(2).c_str());
  else
    for (const auto& file : description.at("files")) std::printf("%s\n", file.get<std::string>().c_str());
  return kExitDone;
}

}  // namespace

std::vector<Command> add_body(CLI::App& root) {
  CLI::App* app = root.add_subcommand("body", "a rigged character and a motion to the animated mesh of a scene");
  const auto options = std::make_shared<BodyOptions>();
  body::MotionOptions& motion = options->motion;
  app->add_option("body", options->source.body, "skinned mesh with a skeleton: glTF, FBX or Collada")->required();
  app->add_option("motion", options->source.motion,
                  "BVH, AMC (with its ASF beside it), or a file with an animation (default: the body's own)");
  app->add_option("--out", options->out,
                  "FILE.h5 or FILE.pc2 (every frame, and the mesh at rest as FILE.obj), or FILE.obj (only that)")
      ->required();
  app->add_option("--asf", options->source.asf, "the skeleton of an AMC motion (default: the one beside it)");
  app->add_option("--frames", options->frames, "frames to write; the last pose stays (default: all)")
      ->check(CLI::Range(std::uint64_t{0}, kMaxFrames));
  app->add_option("--frame-time", motion.frame_time_s, "seconds between frames")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--start", motion.start_s, "seconds of the motion to leave out")->check(CLI::NonNegativeNumber);
  app->add_option("--end", motion.end_s, "seconds of the motion after which the rest is left out (default: none)")
      ->check(positive_number());
  app->add_option("--ease", motion.ease_frames, "frames from the rest pose into the motion")->capture_default_str();
  app->add_option("--smooth", motion.smoothing, "rounds of smoothing")->capture_default_str();
  app->add_flag("--mirror", motion.mirrored, "left and right exchanged");
  app->add_flag("--keep-place", options->keep_place,
                "the motion's own place and heading (default: it starts where the body stands at rest)");
  app->add_option("--skinning", options->skinning, "linear, or dual quaternions, which keep volume where joints twist")
      ->capture_default_str()
      ->check(CLI::IsMember({"linear", "dual"}));
  app->add_option("--speed-limit", options->limits.metres_per_s, "a joint that is faster is named, m/s")
      ->capture_default_str()
      ->check(positive_number());
  add_json_option(*app, options->json, "print one JSON object: vertices, joints, frames, too_fast, files");
  return {{app, [options] { return make_body(*options); }}};
}

}  // namespace pleat::cli
