// A live session, with a model bundle, the fold step or both, as a method to evaluate.
#pragma once

#include <memory>
#include <string>

#include "common/client/cpp/client.hpp"
#include "services/evaluation/evaluation.hpp"

namespace pleat::evaluation {

struct SessionMethodOptions {
  std::string model;                       ///< bundle; not of DETAIL_FOLD
  v1::Detail detail = v1::DETAIL_NETWORK;  ///< not DETAIL_UNSPECIFIED
  bool refine = true;
};

/// "pleat:MODEL", "fold" or "both:MODEL": a live session with the coordinator per sequence. Refinement also hides
/// errors: a mesh that is far off intersects itself and goes back to the upsampled coarse one. The fold step gets
/// material, held vertices and wind of the sequence's scene. Throws what the session throws, a frame's error, and
/// kDataLoss for a scene that is none.
Method session_method(std::shared_ptr<const client::Client> client, const SessionMethodOptions& options);

}  // namespace pleat::evaluation
