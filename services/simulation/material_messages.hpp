// Material messages -> materials.
#pragma once

#include <string>
#include <string_view>

#include "pleat/v1/scene.pb.h"
#include "services/simulation/material.hpp"

namespace pleat::simulation {

/// Throws kInvalidArgument, naming `field` and the constant.
Material material_from_message(const v1::IsotropicMaterial& message, const std::string& field);

/// With the message's scales in its tables. otherwise: the JSON of the material where the message has none. Throws
/// kInvalidArgument, naming `field`, for materials that can't be parsed and scales that are not finite, negative, or 0
/// where the cloth would lose its mass or its resistance to stretching.
Material material_from_message(const v1::ClothMaterial& message, std::string_view otherwise, const std::string& field);

}  // namespace pleat::simulation
