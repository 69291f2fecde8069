#include "common/frame/scene_json.hpp"

#include <google/protobuf/util/json_util.h>

#include "common/base/error.hpp"

namespace pleat {

std::string scene_json(v1::Scene scene) {
  scene.clear_garment();
  for (v1::Obstacle& obstacle : *scene.mutable_obstacles()) {
    if (obstacle.has_mesh()) obstacle.clear_shape();
    if (!obstacle.has_animation()) continue;
    obstacle.mutable_animation()->clear_positions();
    obstacle.mutable_animation()->clear_samples();
  }
  google::protobuf::util::JsonPrintOptions options;
  options.preserve_proto_field_names = true;
  std::string json;
  const auto status = google::protobuf::util::MessageToJsonString(scene, &json, options);
  if (!status.ok()) throw_internal("scene: " + status.ToString());
  return json;
}

}  // namespace pleat
