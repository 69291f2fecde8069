#include "services/presentation/report/upsampling.hpp"

namespace pleat::presentation {

std::optional<Subdivision> find_upsampling(const Topology& coarse, const Topology& fine) {
  Eigen::Index faces = coarse.face_count();
  for (int rounds = 1; rounds <= 4 && faces > 0; ++rounds) {
    faces *= 4;
    if (faces != fine.face_count()) continue;
    Subdivision subdivision = subdivide(coarse, rounds);
    if (subdivision.fine.vertex_count() == fine.vertex_count() && subdivision.fine.faces == fine.faces) {
      return subdivision;
    }
  }
  return std::nullopt;
}

}  // namespace pleat::presentation
