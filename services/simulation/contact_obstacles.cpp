// What the contact of spheres and capsules needs besides that of meshes.
#include <algorithm>

#include "services/simulation/contact.hpp"
#include "services/simulation/obstacles.hpp"

namespace pleat::simulation {

Points ContactSystem::obstacle_particles(double time_s) const {
  Points particles;
  obstacle_particles(time_s, particles);
  return particles;
}

void ContactSystem::obstacle_particles(double time_s, Points& particles) const {
  particles.resize(particle_count_ - cloth_count_);
  for (std::size_t o = 0; o < scene_.obstacles.size(); ++o) {
    const std::size_t first = first_particle_[o] - cloth_count_, last = first_particle_[o + 1] - cloth_count_;
    points_at(scene_.obstacles[o], time_s, std::span(particles).subspan(first, last - first));
  }
}

// The distance of a segment from a face, while it does not pass through it, is that of an end from the face or that of
// the segment from an edge. So a capsule is two spheres, and an edge that keeps its radius.
void ContactSystem::add_round_pairs(const Points& start, const Points& end, double margin) {
  for (const Round& round : rounds_) {
    const auto radius = static_cast<float>(round.radius);
    SweptBox box;
    for (const std::uint32_t p : {round.a, round.b}) {
      if (p != kNone) box.extend(SweptBox(start[p], end[p], round.radius + margin));
    }
    const std::vector<std::uint32_t> near = cloth_bvh_.query(box);
    for (const std::uint32_t p : {round.a, round.b}) {
      if (p == kNone) continue;
      for (const std::uint32_t f : near) {
        keep_if_close({{p, faces_[f][0], faces_[f][1], faces_[f][2]}, Kind::kSphereFace, radius}, start, end, pairs_);
      }
    }
    if (round.b == kNone) continue;
    for (const std::uint32_t f : near) {
      for (const std::uint32_t e : own_edges_[f]) {
        if (e == kNone) continue;
        keep_if_close({{edges_[e][0], edges_[e][1], round.a, round.b}, Kind::kEdgeEdge, radius}, start, end, pairs_);
      }
    }
  }
}

std::uint32_t ContactSystem::obstacle_of(std::uint32_t particle) const {
  if (particle < cloth_count_) return kNone;
  const auto after = std::upper_bound(first_particle_.begin(), first_particle_.end(), particle);
  return static_cast<std::uint32_t>(after - first_particle_.begin()) - 1;
}

}  // namespace pleat::simulation
