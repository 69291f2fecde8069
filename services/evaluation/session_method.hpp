// A model bundle as a method to evaluate.
#pragma once

#include <memory>
#include <string>

#include "common/client/cpp/client.hpp"
#include "services/evaluation/evaluation.hpp"

namespace pleat::evaluation {

/// "pleat:MODEL": a live session with the coordinator per sequence. Refinement also hides errors: a mesh that is far
/// off intersects itself and goes back to the upsampled coarse one. Throws what the session throws, and a frame's
/// error.
Method session_method(std::shared_ptr<const client::Client> client, const MeshPair& topology, const std::string& model,
                      bool refine = true);

}  // namespace pleat::evaluation
