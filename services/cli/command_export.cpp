// `pleat export`: results as files that other tools open.
#include <cstdio>
#include <nlohmann/json.hpp>

#include "common/base/progress.hpp"
#include "common/base/signals.hpp"
#include "services/cli/command.hpp"
#include "services/presentation/export/export.hpp"

namespace pleat::cli {
namespace {

struct Options {
  std::string result, format, out, which = "enhanced", up = "y";
  presentation::ExportChanges changes;
  presentation::ExportOptions files;
  bool json = false;
};

int export_result(Options options) {
  namespace fs = std::filesystem;
  const presentation::ExportFormat format = presentation::parse_export_format(options.format);
  options.changes.z_up = options.up == "z";
  const presentation::ExportInput input =
      presentation::changed(presentation::read_export_input(options.result, options.which), options.changes);
  const fs::path folder =
      options.out.empty() ? fs::path(options.result).parent_path() / options.format : fs::path(options.out);
  Progress progress("frames", input.frame_count);
  const auto files = presentation::export_frames(
      input, format, folder,
      [&progress](std::size_t done) {
        progress.update(done);
        if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted after " + std::to_string(done) + " frames");
      },
      options.files);
  progress.finish();
  if (options.json) {
    nlohmann::json names = nlohmann::json::array();
    for (const fs::path& file : files) names.push_back(file.string());
    const nlohmann::json report = {{"frames", input.frame_count},
                                   {"vertices", input.topology.vertex_count()},
                                   {"frame_time_s", input.frame_time_s},
                                   {"files", std::move(names)}};
    std::printf("%s\n", report.dump(2).c_str());
  } else {
    for (const fs::path& file : files) std::printf("%s\n", file.c_str());
  }
  return kExitDone;
}

}  // namespace

std::vector<Command> add_export(CLI::App& root) {
  CLI::App* app = root.add_subcommand("export", "write a result as files that other tools open");
  const auto options = std::make_shared<Options>();
  app->add_option("result", options->result, "result.h5, finished or .partial")->required();
  app->add_option("--format", options->format,
                  "obj, ply (a file a frame), pc2, mdd (point cache and OBJ), usda, usdz, glb, abc, maps (normals and "
                  "displacements "
                  "for the coarse mesh)")
      ->required()
      ->check(CLI::IsMember({"obj", "ply", "pc2", "mdd", "usda", "usdz", "glb", "abc", "maps"}));
  app->add_option("--out", options->out, "folder (default: one named after the format, beside the result)");
  app->add_option("--which", options->which, "which mesh; fine is the simulated reference")
      ->capture_default_str()
      ->check(CLI::IsMember({"enhanced", "coarse", "fine"}));
  app->add_flag("--overwrite", options->files.overwrite, "also replace files that are no earlier exports");
  presentation::ExportChanges& changes = options->changes;
  app->add_option("--scale", changes.metres_per_unit, "metres per unit of the files: 0.01 for centimetres")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--up", options->up, "the axis that is up in the files")
      ->capture_default_str()
      ->check(CLI::IsMember({"y", "z"}));
  app->add_option("--fps", changes.fps, "frames a second of the files, linear between the result's (default: as it is)")
      ->check(positive_number());
  app->add_option("--start", changes.start, "the first frame, counted from 0")
      ->capture_default_str()
      ->check(natural_number());
  app->add_option("--end", changes.end, "the frame after the last (default: all)")->check(positive_number());
  app->add_option("--size", options->files.map_size, "maps: texels on each side")
      ->capture_default_str()
      ->check(CLI::Range(16, presentation::kMaxMapSize));
  add_json_option(*app, options->json, "print one JSON object: frames, vertices, frame_time_s, files");
  return {{app, [options] { return export_result(*options); }}};
}

}  // namespace pleat::cli
