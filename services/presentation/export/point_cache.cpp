// PLY, PC2 and MDD: headers and raw numbers.
#include <cstring>
#include <limits>

#include "common/base/error.hpp"
#include "services/presentation/export/output_file.hpp"
#include "services/presentation/export/own_export.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {

namespace {

void write_positions(OutputFile& file, const Positions& positions, std::endian order) {
  for (Eigen::Index i = 0; i < positions.size(); ++i) file.number(positions.data()[i], order);
}

std::int32_t count_for(const std::filesystem::path& path, std::size_t count, const char* what) {
  if (count > static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max())) {
    throw_invalid_argument(path.string() + ": the format can't hold " + std::to_string(count) + " " + what);
  }
  return static_cast<std::int32_t>(count);
}

}  // namespace

void write_ply(const std::filesystem::path& path, const Topology& topology, const Positions& positions) {
  const Positions normals = vertex_normals(positions, topology.faces);
  OutputFile file(path);
  file.text("ply\nformat binary_little_endian 1.0\ncomment metres, Y up\n" + std::string(kPlyMark) +
            "\nelement vertex " + std::to_string(positions.rows()) +
            "\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n"
            "property float nz\nelement face " +
            std::to_string(topology.face_count()) + "\nproperty list uchar uint vertex_indices\nend_header\n");
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) file.number(positions(v, axis), std::endian::little);
    for (Eigen::Index axis = 0; axis < 3; ++axis) file.number(normals(v, axis), std::endian::little);
  }
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) {
    file.text("\3");
    for (Eigen::Index corner = 0; corner < 3; ++corner) file.number(topology.faces(f, corner), std::endian::little);
  }
  file.commit();
}

void write_pc2(OutputFile& file, const ExportInput& input, const FrameSource& frame) {
  constexpr std::endian kOrder = std::endian::little;
  constexpr std::int32_t kVersion = 1;
  constexpr float kStartFrame = 0;
  constexpr float kSampleRate = 1;  // samples per frame
  file.text(std::string_view("POINTCACHE2\0", 12));
  file.number(kVersion, kOrder);
  file.number(count_for(file.path(), static_cast<std::size_t>(input.topology.vertex_count()), "vertices"), kOrder);
  file.number(kStartFrame, kOrder);
  file.number(kSampleRate, kOrder);
  file.number(count_for(file.path(), input.frame_count, "frames"), kOrder);
  for (std::size_t t = 0; t < input.frame_count; ++t) write_positions(file, frame(t), kOrder);
}

void write_mdd(OutputFile& file, const ExportInput& input, const FrameSource& frame) {
  constexpr std::endian kOrder = std::endian::big;
  file.number(count_for(file.path(), input.frame_count, "frames"), kOrder);
  file.number(count_for(file.path(), static_cast<std::size_t>(input.topology.vertex_count()), "vertices"), kOrder);
  for (std::size_t t = 0; t < input.frame_count; ++t) {
    file.number(static_cast<float>(static_cast<double>(t) * input.frame_time_s), kOrder);
  }
  for (std::size_t t = 0; t < input.frame_count; ++t) write_positions(file, frame(t), kOrder);
}

}  // namespace pleat::presentation
