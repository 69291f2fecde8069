#include "services/presentation/input/animation_input.hpp"

#include "common/base/error.hpp"
#include "common/store/hdf5.hpp"
#include "services/presentation/input/sequence_input.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

// A message has at most 64 MiB: this leaves room for the rest of the scene.
constexpr std::uint64_t kMaxBytes = 60u << 20;
constexpr hsize_t kMaxValues = 10'000'000'000;

void check_points(const std::string& source, Eigen::Index points, std::uint64_t found) {
  if (found == static_cast<std::uint64_t>(points)) return;
  throw_invalid_argument(source + " has " + std::to_string(found) + " points, the obstacle " + std::to_string(points));
}

void check_size(const std::string& source, std::uint64_t samples, Eigen::Index points) {
  if (samples == 0) throw_invalid_argument(source + " has no samples");
  const std::uint64_t row = 12 * static_cast<std::uint64_t>(points);
  if (samples <= kMaxBytes / row) return;
  throw Error(ErrorCode::kResourceExhausted, source + ": " + std::to_string(samples) + " samples of " +
                                                 std::to_string(points) + " points are more than the " +
                                                 std::to_string(kMaxBytes >> 20) + " MiB that a scene can hold");
}

std::vector<Positions> read_array(const fs::path& path, const std::string& array, Eigen::Index points) {
  const std::string source = path.string() + ":" + array;
  const auto lock = hdf5::lock();
  const hdf5::File file = hdf5::File::open(path, false);
  if (!file.exists(array) || !file.is_array(array)) throw_invalid_argument(source + ": no such array");
  const auto extents = file.extents(array, 3, kMaxValues);
  if (extents[2] != 3) throw_invalid_argument(source + " has " + std::to_string(extents[2]) + " columns, not 3");
  check_points(source, points, extents[1]);
  check_size(source, extents[0], points);
  const hdf5::Rows rows = file.rows(array);
  std::vector<Positions> samples;
  for (hsize_t k = 0; k < extents[0]; ++k) {
    samples.emplace_back(points, 3);
    rows.read(H5T_NATIVE_FLOAT, k, 1, samples.back().data());
    for (Eigen::Index v = 0; v < points; ++v) {
      if (!samples.back().row(v).allFinite()) {
        throw_invalid_argument(source + " sample " + std::to_string(k) + ": vertex " + std::to_string(v) +
                               " is not finite");
      }
    }
  }
  return samples;
}

}  // namespace

std::vector<Positions> read_animation(const fs::path& source, Eigen::Index points) {
  const std::string text = source.string();
  const auto colon = text.rfind(".h5:");
  if (colon != std::string::npos) return read_array(text.substr(0, colon + 3), text.substr(colon + 4), points);
  if (source.extension() == ".h5" || source.extension() == ".hdf5") return read_array(source, "/positions", points);
  if (source.extension() != ".pc2") throw_invalid_argument(text + ": animations are read from .pc2 and .h5");
  const PointCache cache(source);
  check_points(text, points, static_cast<std::uint64_t>(cache.point_count()));
  check_size(text, cache.sample_count(), points);
  std::vector<Positions> samples;
  for (std::size_t k = 0; k < cache.sample_count(); ++k) samples.push_back(cache.sample(k));
  return samples;
}

}  // namespace pleat::presentation
