#include "common/mesh/animated_mesh.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "common/base/error.hpp"
#include "common/base/limits.hpp"
#include "common/mesh/alembic.hpp"
#include "common/mesh/fbx.hpp"
#include "common/mesh/gltf.hpp"
#include "common/mesh/mesh_file.hpp"
#include "common/mesh/usd_text.hpp"

namespace pleat {
namespace {

bool is_gltf(const std::string& extension) { return extension == ".gltf" || extension == ".glb"; }
bool is_usd(const std::string& extension) { return extension == ".usda" || extension == ".usd"; }

}  // namespace

bool is_animated_mesh_file(const std::filesystem::path& path) {
  const std::string extension = lower_extension(path);
  return is_gltf(extension) || is_usd(extension) || extension == ".abc" || extension == ".fbx";
}

std::unique_ptr<AnimatedMesh> open_animated_mesh(const std::filesystem::path& path) {
  const std::string extension = lower_extension(path);
  if (is_gltf(extension)) return open_gltf(path);
  if (is_usd(extension)) return open_usd_text(path);
  if (extension == ".abc") return open_alembic(path);
  if (extension == ".fbx") return open_fbx(path);
  throw_invalid_argument(path.string() + ": meshes with frames are read from .gltf, .glb, .fbx, .abc, .usda and .usd");
}

std::vector<std::uint32_t> match_vertices(const PolygonMesh& mesh, const Topology& rest, const std::string& name) {
  const std::size_t vertices = mesh.positions.size() / 3;
  if (vertices != static_cast<std::size_t>(rest.vertex_count())) {
    throw_invalid_argument(name + " has " + std::to_string(vertices) + " vertices, the rest mesh " +
                           std::to_string(rest.vertex_count()));
  }
  std::vector<std::uint32_t> matched(vertices, 0xffffffffu);
  const std::vector<PolygonMesh::Corner> corners = triangle_corners(mesh, name);
  bool same = corners.size() == static_cast<std::size_t>(rest.faces.size());
  std::vector<char> taken(vertices, 0);
  for (std::size_t i = 0; same && i < corners.size(); ++i) {
    std::uint32_t& match = matched[rest.faces.data()[i]];
    const std::uint32_t vertex = corners[i].vertex;
    if (match == vertex) continue;
    same = match == 0xffffffffu && taken[vertex] == 0;
    match = vertex;
    taken[vertex] = 1;
  }
  if (!same || std::find(matched.begin(), matched.end(), 0xffffffffu) != matched.end()) {
    std::iota(matched.begin(), matched.end(), 0u);
  }
  return matched;
}

MatchedFrames::MatchedFrames(const std::filesystem::path& path, const Topology& rest)
    : mesh_(open_animated_mesh(path)), vertices_(match_vertices(mesh_->mesh(), rest, path.string())) {}

Positions MatchedFrames::positions(std::size_t frame) const {
  const Positions theirs = mesh_->positions(frame);
  Positions ours(theirs.rows(), 3);
  for (std::size_t v = 0; v < vertices_.size(); ++v) ours.row(static_cast<Eigen::Index>(v)) = theirs.row(vertices_[v]);
  return ours;
}

namespace detail {

void PointWelder::add(const float* place, std::uint32_t part, std::uint64_t motion) {
  const auto bits = [&](int axis) { return std::uint64_t{std::bit_cast<std::uint32_t>(place[axis] + 0.0F)}; };
  const std::array<std::uint64_t, 3> key = {bits(0) | bits(1) << 32, bits(2) | std::uint64_t{part} << 32, motion};
  const auto [found, is_new] = number_.try_emplace(key, static_cast<std::uint32_t>(first_point_.size()));
  if (is_new) first_point_.push_back(vertex_.size());
  vertex_.push_back(found->second);
}

FrameTimes even_times(std::vector<double> keys, const std::string& name) {
  constexpr double kTolerance = 0.02;  // of a frame
  std::sort(keys.begin(), keys.end());
  if (keys.empty()) return {};
  FrameTimes times;
  times.first = keys.front();
  const double span = keys.back() - keys.front();
  if (!(span > 0)) return times;
  // Keys that are nearly one are one: exporters round.
  double step = span;
  for (std::size_t i = 1; i < keys.size(); ++i) {
    const double gap = keys[i] - keys[i - 1];
    if (gap > 1e-7 * span) step = std::min(step, gap);
  }
  const double frames = std::round(span / step);
  if (frames >= static_cast<double>(kMaxFrames)) {
    throw Error(ErrorCode::kResourceExhausted, name + ": more than " + std::to_string(kMaxFrames) + " frames");
  }
  times.step = span / frames;
  times.count = static_cast<std::size_t>(frames) + 1;
  for (const double key : keys) {
    const double place = (key - times.first) / times.step;
    if (std::abs(place - std::round(place)) > kTolerance) {
      throw_invalid_argument(name + ": its key frames are not evenly spaced; bake one for each frame");
    }
  }
  return times;
}

}  // namespace detail

}  // namespace pleat
