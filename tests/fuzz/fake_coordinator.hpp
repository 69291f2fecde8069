// A coordinator before stages that do simple arithmetic (tests/support/fake_stages.hpp).
#pragma once

#include "services/coordinator/coordinator_options.hpp"
#include "tests/support/fake_stages.hpp"

namespace pleat::fuzz {

inline coordinator::CoordinatorOptions coordinator_options(testing::FakeStages& stages) {
  coordinator::CoordinatorOptions options;
  options.simulation = stages.simulation().address();
  options.conversion = stages.conversion().address();
  options.superres = stages.superres().address();
  options.fold = stages.fold().address();
  options.refinement = stages.refinement().address();
  options.data = (stages.folder() / "data").string();
  options.live.max_vertices = 2000;
  return options;
}

}  // namespace pleat::fuzz
