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
#include "services/presentation/export/own_export.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {

namespace {

constexpr std::pair<const char*, ExportFormat> kFormats[] = {
    {"obj", ExportFormat::kObj}, {"ply", ExportFormat::kPly},   {"pc2", ExportFormat::kPc2},
    {"mdd", ExportFormat::kMdd}, {"usda", ExportFormat::kUsda}, {"glb", ExportFormat::kGlb}};

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

}  // namespace

ExportFormat parse_export_format(const std::string& name) {
  std::string known;
  for (const auto& [text, format] : kFormats) {
    if (name == text) return format;
    known += (known.empty() ? "" : ", ") + std::string(text);
  }
  throw_invalid_argument("unknown export format '" + name + "', known are " + known);
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
  return input;
}

std::vector<std::filesystem::path> export_frames(const ExportInput& input, ExportFormat format,
                                                 const std::filesystem::path& folder, const ExportProgress& progress,
                                                 bool overwrite) {
  if (input.frame_count == 0) throw_invalid_argument(input.name + ": has no complete frame to export");
  if (!(input.frame_time_s > 0)) throw_invalid_argument(input.name + ": the time between frames must be positive");
  make_writable_folder(folder);
  const std::vector<std::filesystem::path> files = export_files(input, format, folder);
  if (!overwrite) require_own_exports(files);

  const FrameSource frame = [&](std::size_t t) {
    Positions positions = input.frame(t);
    if (positions.rows() != input.topology.vertex_count() || !all_finite(positions)) {
      throw_invalid_argument(input.name + " frame " + std::to_string(t) + ": " + std::to_string(positions.rows()) +
                             " vertices (expected " + std::to_string(input.topology.vertex_count()) +
                             ") or a value that is not finite");
    }
    if (progress) progress(t + 1);
    return positions;
  };

  switch (format) {
    case ExportFormat::kObj:
      for (std::size_t t = 0; t < files.size(); ++t) write_obj(files[t], input.topology, frame(t));
      break;
    case ExportFormat::kPly:
      for (std::size_t t = 0; t < files.size(); ++t) write_ply(files[t], input.topology, frame(t));
      break;
    case ExportFormat::kUsda:
      write_usda(files[0], input, frame);
      break;
    case ExportFormat::kGlb:
      write_glb(files[0], input, frame);
      break;
    case ExportFormat::kPc2:
    case ExportFormat::kMdd:
      (format == ExportFormat::kPc2 ? write_pc2 : write_mdd)(files[1], input, frame);
      write_obj(files[0], input.topology, input.topology.rest_positions, cache_comments(files[0], files[1]));
      break;
  }
  return files;
}

}  // namespace pleat::presentation
