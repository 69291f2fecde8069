// PLY, PC2 and MDD: headers and raw numbers.
#include <bit>
#include <cstdint>
#include <limits>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "services/presentation/export/own_export.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {

namespace {

/// A float or 32-bit integer in the byte order asked for.
template <class T>
void write_number(WholeFile& file, T value, std::endian order) {
  static_assert(sizeof(T) == 4);
  auto bits = std::bit_cast<std::uint32_t>(value);
  if (order != std::endian::native) bits = __builtin_bswap32(bits);
  file.write({reinterpret_cast<const char*>(&bits), sizeof bits});
}

void write_positions(WholeFile& file, const Positions& positions, std::endian order) {
  for (Eigen::Index i = 0; i < positions.size(); ++i) write_number(file, positions.data()[i], order);
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
  WholeFile file(path);
  file.write("ply\nformat binary_little_endian 1.0\ncomment metres, Y up\n" + std::string(kPlyMark) +
             "\nelement vertex " + std::to_string(positions.rows()) +
             "\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n"
             "property float nz\nelement face " +
             std::to_string(topology.face_count()) + "\nproperty list uchar uint vertex_indices\nend_header\n");
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) write_number(file, positions(v, axis), std::endian::little);
    for (Eigen::Index axis = 0; axis < 3; ++axis) write_number(file, normals(v, axis), std::endian::little);
  }
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) {
    file.write("\3");
    for (Eigen::Index corner = 0; corner < 3; ++corner)
      write_number(file, topology.faces(f, corner), std::endian::little);
  }
  file.commit();
}

void write_pc2(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame) {
  constexpr std::endian kOrder = std::endian::little;
  constexpr std::int32_t kVersion = 1;
  constexpr float kStartFrame = 0;
  constexpr float kSampleRate = 1;  // samples per frame
  WholeFile file(path);
  file.write(std::string_view("POINTCACHE2\0", 12));
  write_number(file, kVersion, kOrder);
  write_number(file, count_for(path, static_cast<std::size_t>(input.topology.vertex_count()), "vertices"), kOrder);
  write_number(file, kStartFrame, kOrder);
  write_number(file, kSampleRate, kOrder);
  write_number(file, count_for(path, input.frame_count, "frames"), kOrder);
  for (std::size_t t = 0; t < input.frame_count; ++t) write_positions(file, frame(t), kOrder);
  file.commit();
}

void write_mdd(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame) {
  constexpr std::endian kOrder = std::endian::big;
  WholeFile file(path);
  write_number(file, count_for(path, input.frame_count, "frames"), kOrder);
  write_number(file, count_for(path, static_cast<std::size_t>(input.topology.vertex_count()), "vertices"), kOrder);
  for (std::size_t t = 0; t < input.frame_count; ++t) {
    write_number(file, static_cast<float>(static_cast<double>(t) * input.frame_time_s), kOrder);
  }
  for (std::size_t t = 0; t < input.frame_count; ++t) write_positions(file, frame(t), kOrder);
  file.commit();
}

}  // namespace pleat::presentation
