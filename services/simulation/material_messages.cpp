#include "services/simulation/material_messages.hpp"

#include <cmath>

#include "common/base/error.hpp"

namespace pleat::simulation {
namespace {

template <typename Table>
void scale(Table& table, double factor) {
  for (auto& row : table) {
    for (double& value : row) value *= factor;
  }
}

double checked(double factor, bool zero_allowed, const std::string& field) {
  if (std::isfinite(factor) && (zero_allowed ? factor >= 0 : factor > 0)) return factor;
  throw_invalid_argument(field + (zero_allowed ? ": must be 0 or more" : ": must be above 0"));
}

}  // namespace

Material material_from_message(const v1::IsotropicMaterial& m, const std::string& field) {
  return isotropic_material({m.density(), m.youngs_modulus(), m.poissons_ratio(), m.thickness()}, field);
}

Material material_from_message(const v1::ClothMaterial& message, std::string_view otherwise, const std::string& field) {
  Material material;
  switch (message.material_case()) {
    case v1::ClothMaterial::kJson:
      material = parse_material(message.json(), field + ".json");
      break;
    case v1::ClothMaterial::kIsotropic:
      material = material_from_message(message.isotropic(), field + ".isotropic");
      break;
    case v1::ClothMaterial::MATERIAL_NOT_SET:
      material = parse_material(otherwise, "the default material");
      break;
  }
  const v1::MaterialOptions& options = message.options();
  const std::string name = field + ".options.";
  if (options.has_density_scale()) {
    material.density *= checked(options.density_scale(), false, name + "density_scale");
  }
  if (options.has_stretching_scale()) {
    scale(material.stretching, checked(options.stretching_scale(), false, name + "stretching_scale"));
  }
  if (options.has_bending_scale()) {
    scale(material.bending, checked(options.bending_scale(), true, name + "bending_scale"));
  }
  return material;
}

}  // namespace pleat::simulation
