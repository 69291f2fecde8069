// Limits of the sessions under test: low, so that an input takes milliseconds and its memory is bounded.
#pragma once

#include <spdlog/spdlog.h>

#include "services/conversion/session.hpp"
#include "services/fold/session.hpp"
#include "services/refinement/session.hpp"

namespace pleat::fuzz {

inline conversion::SessionLimits conversion_limits() {
  spdlog::set_level(spdlog::level::off);
  return {.max_vertices = 5000, .max_texels = 20000};
}

inline fold::SessionOptions fold_limits() {
  spdlog::set_level(spdlog::level::off);
  return {.max_vertices = 500};
}

inline refinement::SessionOptions refinement_limits() {
  spdlog::set_level(spdlog::level::off);
  return {.max_vertices = 3000, .bisections = 5, .threads = 1};
}

}  // namespace pleat::fuzz
