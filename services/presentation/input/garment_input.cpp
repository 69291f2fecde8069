#include "services/presentation/input/garment_input.hpp"

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/garment.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

// Of the width of what lies there: charts of different meshes don't touch.
constexpr float kGapBetween = 0.02f;

template <typename Rows>
void append(Rows& rows, const Rows& more) {
  const Eigen::Index before = rows.rows();
  rows.conservativeResize(before + more.rows(), Eigen::NoChange);
  rows.bottomRows(more.rows()) = more;
}

}  // namespace

Topology join_garments(const std::vector<Topology>& garments) {
  Topology joined = garments.at(0);
  for (std::size_t g = 1; g < garments.size(); ++g) {
    Topology next = garments[g];
    next.faces.array() += static_cast<std::uint32_t>(joined.vertex_count());
    next.uv_faces.array() += static_cast<std::uint32_t>(joined.uv.rows());
    const float low = joined.uv.col(0).minCoeff(), high = joined.uv.col(0).maxCoeff();
    next.uv.col(0).array() += high + kGapBetween * (high - low) - next.uv.col(0).minCoeff();
    append(joined.rest_positions, next.rest_positions);
    append(joined.faces, next.faces);
    append(joined.uv, next.uv);
    append(joined.uv_faces, next.uv_faces);
  }
  return joined;
}

void inline_garments(v1::Scene& scene, const fs::path& folder, const std::string& name, double scale,
                     std::vector<std::string>& notes) {
  std::vector<Topology> garments;
  const auto read = [&](const std::string& path, const std::string& key) {
    const fs::path file = folder / path;
    std::error_code ignored;
    if (!fs::is_regular_file(file, ignored))
      throw_not_found(name + ": " + key + " " + file.string() + ": no such file");
    garments.push_back(read_garment(file, notes, scale));
    require_rest_lengths(garments.back(), file.string());
  };
  read(scene.garment_file(), "garment_file");
  for (int g = 0; g < scene.further_garment_files_size(); ++g) {
    read(scene.further_garment_files(g), "further_garment_files[" + std::to_string(g) + "]");
  }
  scene.clear_further_garment_files();
  const Topology joined = join_garments(garments);
  *scene.mutable_garment_mesh() = to_message(joined);
  scene.mutable_garment_mesh()->set_hash(topology_hash(joined));
}

}  // namespace pleat::presentation
