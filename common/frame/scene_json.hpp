// A scene as result files keep it.
#pragma once

#include <string>

#include "pleat/v1/scene.pb.h"

namespace pleat {

/// The JSON form of the message, without meshes and animations, which a result file holds as arrays.
std::string scene_json(v1::Scene scene);

}  // namespace pleat
