#include "services/refinement/judge.hpp"

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/frame/obstacle_field.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat::refinement {
namespace {

void check(const Positions& positions, const Faces& faces) {
  if (!all_finite(positions)) throw_invalid_argument("judge: positions are not finite");
  if (faces.rows() != 0 && static_cast<Eigen::Index>(faces.maxCoeff()) >= positions.rows()) {
    throw_invalid_argument("judge: a face names vertex " + std::to_string(faces.maxCoeff()) + " of " +
                           std::to_string(positions.rows()));
  }
}

}  // namespace

std::vector<FacePair> find_self_intersections(const Positions& positions, const Faces& faces) {
  check(positions, faces);
  std::vector<FacePair> pairs;
  if (faces.rows() == 0) return pairs;
  SelfIntersectionFinder finder(faces, positions.rows());
  finder.update(positions);
  finder.find(positions, kMaxReportedPairs, pairs);
  return pairs;
}

std::size_t count_self_intersections(const Positions& positions, const Faces& faces) {
  return find_self_intersections(positions, faces).size();
}

std::vector<std::uint32_t> find_penetrations(const Positions& positions, const Faces& faces,
                                             std::span<const ObstacleShape> shapes,
                                             std::span<const ObstacleFrame> frames) {
  check(positions, faces);
  ObstacleField field(shapes);
  field.update(frames);
  return field.find(positions, faces);
}

std::size_t count_penetrations(const Positions& positions, const Faces& faces, std::span<const ObstacleShape> shapes,
                               std::span<const ObstacleFrame> frames) {
  return find_penetrations(positions, faces, shapes, frames).size();
}

}  // namespace pleat::refinement
