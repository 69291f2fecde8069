#include "services/presentation/input/garment_input.hpp"

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/garment.hpp"

namespace pleat::presentation {

namespace fs = std::filesystem;

void inline_garments(v1::Scene& scene, const fs::path& folder, const std::string& name, double scale,
                     std::vector<std::string>& notes) {
  std::vector<Topology> garments;
  scene.clear_garment_layers();
  const auto read = [&](const std::string& path, const std::string& key) {
    const fs::path file = folder / path;
    std::error_code ignored;
    if (!fs::is_regular_file(file, ignored))
      throw_not_found(name + ": " + key + " " + file.string() + ": no such file");
    garments.push_back(read_garment(file, notes, scale));
    require_rest_lengths(garments.back(), file.string());
    v1::GarmentLayer& layer = *scene.add_garment_layers();
    layer.set_name(file.stem().string());
    layer.set_faces(static_cast<std::uint32_t>(garments.back().face_count()));
  };
  read(scene.garment_file(), "garment_file");
  for (int g = 0; g < scene.further_garment_files_size(); ++g) {
    read(scene.further_garment_files(g), "further_garment_files[" + std::to_string(g) + "]");
  }
  scene.clear_further_garment_files();
  if (garments.size() == 1) scene.clear_garment_layers();
  const Topology joined = join_garments(garments);
  *scene.mutable_garment_mesh() = to_message(joined);
  scene.mutable_garment_mesh()->set_hash(topology_hash(joined));
}

}  // namespace pleat::presentation
