// A coordinator before stages that do simple arithmetic.
#pragma once

#include "services/coordinator/coordinator_options.hpp"
#include "tests/support/fake_stages.hpp"

namespace pleat::testing {

inline coordinator::CoordinatorOptions coordinator_options(FakeStages& stages) {
  coordinator::CoordinatorOptions options;
  options.simulation = stages.simulation().address();
  options.conversion = stages.conversion().address();
  options.superres = stages.superres().address();
  options.fold = stages.fold().address();
  options.refinement = stages.refinement().address();
  options.data = (stages.folder() / "data").string();
  return options;
}

}  // namespace pleat::testing
