#include "services/presentation/report/upsampling.hpp"

namespace pleat::presentation {

std::optional<Subdivision> find_upsampling(const Topology& coarse, const Topology& fine) {
  if (const auto spec = find_subdivision(coarse, fine)) return subdivide(coarse, *spec);
  return std::nullopt;
}

}  // namespace pleat::presentation
