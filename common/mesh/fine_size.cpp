#include "common/mesh/fine_size.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat {

void check_fine_size(std::int64_t coarse_vertices, int rounds, std::int64_t limit, const std::string& field) {
  const double vertices =
      static_cast<double>(coarse_vertices) * std::pow(4.0, std::clamp(rounds, 0, kMaxSubdivisionRounds));
  if (vertices <= static_cast<double>(limit)) return;
  throw Error(ErrorCode::kResourceExhausted, field + ": about " + std::to_string(static_cast<std::int64_t>(vertices)) +
                                                 " fine vertices, more than this service's limit of " +
                                                 std::to_string(limit));
}

}  // namespace pleat
