// In the place of dressed_sets.cpp in a build without assimp, which can't read bodies.
#include "common/base/error.hpp"
#include "services/dataset/dressed_sets.hpp"

namespace pleat::dataset {

std::vector<SequencePlan> plan_dressed(const SceneOptions& options, const Topology&, std::vector<std::string>&) {
  throw_invalid_argument("data set '" + options.set + "': this build reads no bodies, it was made without assimp");
}

void put_body(simulation::Scene&, const BodyMotion& motion) {
  throw_invalid_argument(motion.body.string() + ": this build reads no bodies, it was made without assimp");
}

}  // namespace pleat::dataset
