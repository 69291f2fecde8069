#include "services/presentation/export/export.hpp"

#include <algorithm>
#include <cstdio>
#include <memory>
#include <system_error>
#include <utility>

#include "common/base/error.hpp"
#include "common/mesh/obj.hpp"
#include "common/store/result.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {

namespace {

constexpr std::pair<const char*, ExportFormat> kFormats[] = {{"obj", ExportFormat::kObj},
                                                             {"ply", ExportFormat::kPly},
                                                             {"pc2", ExportFormat::kPc2},
                                                             {"mdd", ExportFormat::kMdd},
                                                             {"usda", ExportFormat::kUsda}};

/// "name.0007.obj": at least four digits, so that names sort in the order of the frames.
std::string numbered(const std::string& name, std::size_t frame, std::size_t count, const char* ending) {
  const std::size_t digits = std::max<std::size_t>(4, std::to_string(count - 1).size());
  std::string number = std::to_string(frame);
  number.insert(0, digits - number.size(), '0');
  return name + "." + number + "." + ending;
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
                                                 const std::filesystem::path& folder, const ExportProgress& progress) {
  if (input.frame_count == 0) throw_invalid_argument(input.name + ": has no complete frame to export");
  if (!(input.frame_time_s > 0)) throw_invalid_argument(input.name + ": the time between frames must be positive");
  std::error_code failure;
  std::filesystem::create_directories(folder, failure);
  if (failure) throw_invalid_argument(folder.string() + ": can't be made: " + failure.message());

  const FrameSource frame = [&](std::size_t t) {
    Positions positions = input.frame(t);
    if (positions.rows() != input.topology.vertex_count() || !positions.allFinite()) {
      throw_invalid_argument(input.name + " frame " + std::to_string(t) + ": " + std::to_string(positions.rows()) +
                             " vertices (expected " + std::to_string(input.topology.vertex_count()) +
                             ") or a value that is not finite");
    }
    if (progress) progress(t + 1);
    return positions;
  };

  std::vector<std::filesystem::path> files;
  if (format == ExportFormat::kObj || format == ExportFormat::kPly) {
    const bool obj = format == ExportFormat::kObj;
    for (std::size_t t = 0; t < input.frame_count; ++t) {
      files.push_back(folder / numbered(input.name, t, input.frame_count, obj ? "obj" : "ply"));
      if (obj) {
        write_obj(files.back(), input.topology, frame(t));
      } else {
        write_ply(files.back(), input.topology, frame(t));
      }
    }
    return files;
  }
  if (format == ExportFormat::kUsda) {
    files.push_back(folder / (input.name + ".usda"));
    write_usda(files.back(), input, frame);
    return files;
  }
  // The shape that the cache moves: tools load it first and attach the cache to it.
  files.push_back(folder / (input.name + ".obj"));
  write_obj(files.back(), input.topology, input.topology.rest_positions);
  const bool pc2 = format == ExportFormat::kPc2;
  files.push_back(folder / (input.name + (pc2 ? ".pc2" : ".mdd")));
  if (pc2) {
    write_pc2(files.back(), input, frame);
  } else {
    write_mdd(files.back(), input, frame);
  }
  return files;
}

}  // namespace pleat::presentation
