// In the place of scene_set.cpp in a build without gRPC, which has no protobuf to read scene files with.
#include "common/base/error.hpp"
#include "services/dataset/scene_set.hpp"

namespace pleat::dataset {

std::vector<SequencePlan> plan_own_scenes(const SceneOptions&, std::vector<std::string>&) {
  throw_invalid_argument("--scene: this build reads no scene files, it was made without gRPC");
}

}  // namespace pleat::dataset
