#include "services/presentation/export/export.hpp"

#include <algorithm>
#include <cstdio>
#include <memory>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/own_file.hpp"
#include "common/mesh/obj.hpp"
#include "common/store/result.hpp"
#include "services/presentation/export/detail_maps.hpp"
#include "services/presentation/export/images.hpp"
#include "services/presentation/export/own_export.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {

namespace {

constexpr std::pair<const char*, ExportFormat> kFormats[] = {
    {"obj", ExportFormat::kObj}, {"ply", ExportFormat::kPly},   {"pc2", ExportFormat::kPc2},
    {"mdd", ExportFormat::kMdd}, {"usda", ExportFormat::kUsda}, {"usdz", ExportFormat::kUsdz},
    {"glb", ExportFormat::kGlb}, {"abc", ExportFormat::kAbc},   {"maps", ExportFormat::kMaps}};

/// "name.0007.obj": at least four digits, so that names sort in the order of the frames.
std::string numbered(const std::string& name, std::size_t frame, std::size_t count, const char* ending) {
  const std::size_t digits = std::max<std::size_t>(4, std::to_string(count - 1).size());
  std::string number = std::to_string(frame);
  number.insert(0, digits - number.size(), '0');
  return name + "." + number + "." + ending;
}

/// The files of an export, in the order of its frames.
std::vector<std::filesystem::path> export_files(const ExportInput& input, ExportFormat format,
                                                const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  switch (format) {
    case ExportFormat::kObj:
    case ExportFormat::kPly:
      for (std::size_t t = 0; t < input.frame_count; ++t) {
        const char* ending = format == ExportFormat::kObj ? "obj" : "ply";
        files.push_back(folder / numbered(input.name, t, input.frame_count, ending));
      }
      break;
    case ExportFormat::kUsda:
      files.push_back(folder / (input.name + ".usda"));
      break;
    case ExportFormat::kAbc:
      files.push_back(folder / (input.name + ".abc"));
      break;
    case ExportFormat::kUsdz:
      files.push_back(folder / (input.name + ".usdz"));
      break;
    case ExportFormat::kMaps:
      files.push_back(folder / (input.coarse->name + ".obj"));
      files.push_back(folder / (input.coarse->name + ".pc2"));
      for (std::size_t t = 0; t < input.frame_count; ++t) {
        files.push_back(folder / numbered(input.name + ".displacement", t, input.frame_count, "exr"));
        files.push_back(folder / numbered(input.name + ".normal", t, input.frame_count, "png"));
      }
      break;
    case ExportFormat::kGlb:
      files.push_back(folder / (input.name + ".glb"));
      break;
    case ExportFormat::kPc2:
    case ExportFormat::kMdd:
      // The shape that the cache moves: tools load it first and attach the cache to it.
      files.push_back(folder / (input.name + ".obj"));
      files.push_back(folder / (input.name + (format == ExportFormat::kPc2 ? ".pc2" : ".mdd")));
      break;
  }
  return files;
}

/// What an OBJ says of an input that is not in metres with Y up.
std::string unit_comment(const ExportInput& input) {
  if (input.metres_per_unit == 1 && !input.z_up) return {};
  char text[80];
  std::snprintf(text, sizeof text, "# now a unit is %g m, and %c is up\n", input.metres_per_unit,
                input.z_up ? 'Z' : 'Y');
  return text;
}

Positions checked_frame(const ExportInput& input, std::size_t t) {
  Positions positions = input.frame(t);
  if (positions.rows() != input.topology.vertex_count() || !all_finite(positions)) {
    throw_invalid_argument(input.name + " frame " + std::to_string(t) + ": " + std::to_string(positions.rows()) +
                           " vertices (expected " + std::to_string(input.topology.vertex_count()) +
                           ") or a value that is not finite");
  }
  return positions;
}

}  // namespace

ExportFormat parse_export_format(const std::string& name) {
  std::string known;
  for (const auto& [text, format] : kFormats) {
    if (name == text) return format;
    known += (known.empty() ? "" : ", ") + std::string(text);
  }
  throw_invalid_argument("unknown export format '" + name + "', known are " + known);
}

ExportInput changed(ExportInput input, const ExportChanges& changes) {
  const std::size_t end = std::min(changes.end, input.frame_count);
  if (changes.start >= end) {
    throw_invalid_argument(input.name + ": no frame from " + std::to_string(changes.start) + " to " +
                           std::to_string(end) + " of " + std::to_string(input.frame_count));
  }
  const auto scale = static_cast<float>(1 / changes.metres_per_unit);
  const auto placed = [scale, z_up = changes.z_up](Positions positions) {
    if (scale != 1) positions *= scale;
    if (z_up) {
      positions.col(1).swap(positions.col(2));
      positions.col(1) *= -1;
    }
    return positions;
  };
  const double result_time = input.frame_time_s;
  const std::size_t frames = end - changes.start;
  input.frame_count = frames;
  if (changes.fps > 0) {
    input.frame_time_s = 1 / changes.fps;
    input.frame_count =
        static_cast<std::size_t>(static_cast<double>(frames - 1) * result_time * changes.fps + 1e-6) + 1;
  }
  input.frame = [source = std::move(input.frame), placed, start = changes.start, frames,
                 step = input.frame_time_s / result_time](std::size_t t) {
    const double place = static_cast<double>(t) * step;
    const auto before = std::min(static_cast<std::size_t>(place + 1e-6), frames - 1);
    const double part = place - static_cast<double>(before);
    if (part < 1e-6 || before + 1 == frames) return placed(source(start + before));
    const Positions first = source(start + before), second = source(start + before + 1);
    return placed(first + static_cast<float>(part) * (second - first));
  };
  input.topology.rest_positions = placed(std::move(input.topology.rest_positions));
  input.metres_per_unit *= changes.metres_per_unit;
  input.z_up = input.z_up || changes.z_up;
  if (input.coarse) input.coarse = std::make_shared<const ExportInput>(changed(*input.coarse, changes));
  return input;
}

ExportInput read_export_input(const std::filesystem::path& result, const std::string& mesh) {
  const auto reader = std::make_shared<const ResultReader>(result);
  const ResultOptions& info = reader->info();
  ExportInput input;
  input.name = mesh;
  input.frame_count = static_cast<std::size_t>(info.frames);
  input.frame_time_s = info.frame_time_s;
  input.topology = mesh == "coarse" ? info.topology.coarse : info.topology.fine;
  if (mesh == "coarse") {
    input.frame = [reader](std::size_t t) { return std::move(reader->coarse(t, t + 1).at(0)); };
  } else if (mesh == "enhanced") {
    input.frame = [reader](std::size_t t) { return std::move(reader->enhanced(t, t + 1).at(0)); };
  } else if (mesh == "fine") {
    if (!info.has_fine) {
      throw Error(ErrorCode::kFailedPrecondition, result.string() + ": has no simulated reference (mesh 'fine')");
    }
    input.frame = [reader](std::size_t t) { return std::move(reader->fine(t, t + 1).at(0)); };
  } else {
    throw_invalid_argument("unknown mesh '" + mesh + "', known are enhanced, coarse, fine");
  }
  if (mesh != "coarse") input.coarse = std::make_shared<const ExportInput>(read_export_input(result, "coarse"));
  return input;
}

std::vector<std::filesystem::path> export_frames(const ExportInput& input, ExportFormat format,
                                                 const std::filesystem::path& folder, const ExportProgress& progress,
                                                 const ExportOptions& options) {
  if (input.frame_count == 0) throw_invalid_argument(input.name + ": has no complete frame to export");
  if (!(input.frame_time_s > 0)) throw_invalid_argument(input.name + ": the time between frames must be positive");
  if (format == ExportFormat::kGlb && (input.metres_per_unit != 1 || input.z_up))
    throw_invalid_argument("glTF is in metres with Y up, in no other unit or axis");
  if (format == ExportFormat::kMaps && input.coarse == nullptr)
    throw_invalid_argument(input.name + ": has no coarse mesh that maps could be for");
  make_writable_folder(folder);
  const std::vector<std::filesystem::path> files = export_files(input, format, folder);
  if (!options.overwrite) require_own_exports(files);

  const FrameSource frame = [&](std::size_t t) {
    Positions positions = checked_frame(input, t);
    if (progress) progress(t + 1);
    return positions;
  };
  const std::string comments = unit_comment(input);

  switch (format) {
    case ExportFormat::kObj:
      for (std::size_t t = 0; t < files.size(); ++t) write_obj(files[t], input.topology, frame(t), comments);
      break;
    case ExportFormat::kPly:
      for (std::size_t t = 0; t < files.size(); ++t) write_ply(files[t], input.topology, frame(t));
      break;
    case ExportFormat::kUsda:
      write_usda(files[0], input, frame);
      break;
    case ExportFormat::kAbc:
      write_alembic(files[0], input, frame);
      break;
    case ExportFormat::kUsdz:
      write_usdz(files[0], input, frame);
      break;
    case ExportFormat::kMaps: {
      const DetailMaps maps(input, options.map_size);
      write_pc2(files[1], *input.coarse, [&](std::size_t t) { return checked_frame(*input.coarse, t); });
      write_obj(files[0], maps.mesh(), maps.mesh().rest_positions, comments + cache_comments(files[0], files[1]));
      for (std::size_t t = 0; t < input.frame_count; ++t) {
        const DetailMaps::Images images = maps.at(checked_frame(*input.coarse, t), frame(t));
        write_exr(files[2 + 2 * t], images.size, images.displacement);
        write_png(files[3 + 2 * t], images.size, images.normal);
      }
      break;
    }
    case ExportFormat::kGlb:
      write_glb(files[0], input, frame);
      break;
    case ExportFormat::kPc2:
    case ExportFormat::kMdd:
      (format == ExportFormat::kPc2 ? write_pc2 : write_mdd)(files[1], input, frame);
      write_obj(files[0], input.topology, input.topology.rest_positions, comments + cache_comments(files[0], files[1]));
      break;
  }
  return files;
}

}  // namespace pleat::presentation
