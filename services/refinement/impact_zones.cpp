#include "services/refinement/impact_zones.hpp"

#include <algorithm>

namespace pleat::refinement {
namespace {

// Rings over which the weights rise to 1.
constexpr int kRings = 4;

// The share of a ring: 1 in the middle (ring 0), 0 beyond the last ring, smooth at both ends.
float share_of_ring(int ring) {
  const float t = 1 - static_cast<float>(ring) / static_cast<float>(kRings + 1);
  return t * t * (3 - 2 * t);
}

}  // namespace

Neighbourhood build_neighbourhood(const Faces& faces, Eigen::Index vertex_count) {
  Neighbourhood n;
  std::vector<std::vector<std::uint32_t>> around(static_cast<std::size_t>(vertex_count));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      around[faces(f, k)].push_back(faces(f, (k + 1) % 3));
      around[faces(f, k)].push_back(faces(f, (k + 2) % 3));
    }
  }
  n.offsets.push_back(0);
  for (auto& list : around) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    n.vertices.insert(n.vertices.end(), list.begin(), list.end());
    n.offsets.push_back(static_cast<std::uint32_t>(n.vertices.size()));
  }
  return n;
}

ImpactZones::ImpactZones(const Faces& faces, Eigen::Index vertex_count)
    : faces_(faces),
      neighbourhood_(build_neighbourhood(faces, vertex_count)),
      blend_(static_cast<std::size_t>(vertex_count), 0.f),
      is_changed_(blend_.size(), 0),
      is_moved_(static_cast<std::size_t>(faces.rows()), 0),
      stamps_(blend_.size(), 0) {}

void ImpactZones::begin(const Positions& safe, const Positions& wanted, const SelfIntersectionFinder& finder) {
  safe_ = &safe;
  wanted_ = &wanted;
  finder_ = &finder;
  std::fill(blend_.begin(), blend_.end(), 0.f);
  touched_.clear();
}

void ImpactZones::begin_collecting() {
  if (++stamp_ != 0) return;
  std::fill(stamps_.begin(), stamps_.end(), 0u);
  stamp_ = 1;
}

bool ImpactZones::collect(std::uint32_t v, std::vector<std::uint32_t>& out) {
  if (stamps_[v] == stamp_) return false;
  stamps_[v] = stamp_;
  out.push_back(v);
  return true;
}

void ImpactZones::mark_changed(std::uint32_t v) {
  if (is_changed_[v] != 0) return;
  is_changed_[v] = 1;
  changed_.push_back(v);
}

// `depth` at v, and shares of it around.
void ImpactZones::hollow(std::uint32_t v, float depth) {
  begin_collecting();
  around_.clear();
  collect(v, around_);
  std::size_t begin = 0;
  for (int r = 0; r <= kRings; ++r) {
    const float blend = depth * share_of_ring(r);
    const std::size_t end = around_.size();
    for (std::size_t i = begin; i < end; ++i) {
      const std::uint32_t w = around_[i];
      if (blend_[w] < blend) {
        if (blend_[w] == 0) touched_.push_back(w);
        blend_[w] = blend;
        mark_changed(w);
      }
      if (r == kRings) continue;
      for (const std::uint32_t n : ring(w)) collect(n, around_);
    }
    begin = end;
  }
}

// Places the changed vertices and names their patches.
void ImpactZones::finish_change(Positions& positions) {
  moved_.clear();
  for (const std::uint32_t v : changed_) {
    is_changed_[v] = 0;
    const float blend = blend_[v];
    if (blend == 0) {
      positions.row(v) = wanted_->row(v);
    } else if (blend == 1) {
      positions.row(v) = safe_->row(v);
    } else {
      positions.row(v) = wanted_->row(v) + blend * (safe_->row(v) - wanted_->row(v));
    }
    for (const std::uint32_t p : finder_->patches_at(v)) {
      if (is_moved_[p] != 0) continue;
      is_moved_[p] = 1;
      moved_.push_back(p);
    }
  }
  changed_.clear();
  for (const std::uint32_t p : moved_) is_moved_[p] = 0;
  std::sort(moved_.begin(), moved_.end());
}

bool ImpactZones::lower(std::span<const std::uint32_t> offending_faces, float step, Positions& positions) {
  begin_collecting();
  corners_.clear();
  for (const std::uint32_t f : offending_faces) {
    for (int k = 0; k < 3; ++k) collect(faces_(f, k), corners_);
  }
  // All depths first: the order of the faces must not matter.
  std::erase_if(corners_, [&](std::uint32_t v) { return blend_[v] == 1; });
  depths_.clear();
  for (const std::uint32_t v : corners_) depths_.push_back(std::min(1.f, blend_[v] + step));
  for (std::size_t i = 0; i < corners_.size(); ++i) hollow(corners_[i], depths_[i]);
  finish_change(positions);
  return !corners_.empty();
}

void ImpactZones::set_all(float weight, Positions& positions) {
  touched_.clear();
  for (std::uint32_t v = 0; v < blend_.size(); ++v) {
    blend_[v] = 1 - weight;
    if (weight < 1) touched_.push_back(v);
    mark_changed(v);
  }
  finish_change(positions);
}

std::size_t ImpactZones::count() {
  begin_collecting();
  around_.clear();
  std::size_t zones = 0;
  for (const std::uint32_t v : touched_) {
    if (blend_[v] == 0 || !collect(v, around_)) continue;
    ++zones;
    while (!around_.empty()) {
      const std::uint32_t w = around_.back();
      around_.pop_back();
      for (const std::uint32_t n : ring(w)) {
        if (blend_[n] > 0) collect(n, around_);
      }
    }
  }
  return zones;
}

}  // namespace pleat::refinement
