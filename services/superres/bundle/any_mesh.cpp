#include "services/superres/bundle/any_mesh.hpp"

#include <filesystem>
#include <span>
#include <vector>

#include "common/base/error.hpp"
#include "common/mesh/garment.hpp"
#include "services/conversion/geometry_image/detail_image.hpp"
#include "services/superres/bundle/bundle.hpp"

namespace pleat::superres {
namespace {

/// From metres and m/s to the units of this mesh.
void change_units(ChannelRanges& ranges, std::span<const float> units) {
  for (std::size_t c = 0; c < ranges.channels(); ++c) {
    ranges.offset[c] /= units[c];
    ranges.scale[c] /= units[c];
  }
}

}  // namespace

void serve_any_mesh(const std::string& old_path, const std::string& mesh_file, const std::string& path) {
  Metadata metadata;
  const torch::jit::Module module = load_bundle(old_path, metadata);
  auto* image = std::get_if<conversion::GeometryImageSpec>(&metadata.representation.kind);
  if (image == nullptr || image->layout != conversion::ImageLayout::kDetail ||
      image->units != conversion::DetailUnits::kMetres) {
    throw_invalid_argument(old_path + ": no bundle of layout 'detail' in metres");
  }
  std::vector<std::string> notes;
  const Topology mesh = read_garment(mesh_file, notes);
  if (metadata.topology_hash != topology_hash(mesh)) {
    throw_invalid_argument(mesh_file + ": not the mesh that " + old_path + " was trained on");
  }
  image->units = conversion::DetailUnits::kCoarseEdges;
  forget_mesh(metadata);
  const conversion::DetailUnit unit = conversion::detail_unit(mesh, image->units);
  change_units(metadata.input, unit.inputs);
  change_units(metadata.output, unit.answers);
  metadata.name = std::filesystem::path(path).stem().string();
  save_bundle(module, metadata, path);
}

}  // namespace pleat::superres
