#include "services/refinement/self_intersection_finder.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <string>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/triangle_intersection.hpp"
#include "services/refinement/for_ranges.hpp"

namespace pleat::refinement {
namespace {

// How far from zero, relative to the lengths, an orientation in float arithmetic is trusted: the rounding error is
// below 1e-6.
constexpr float kOrientationMargin = 1e-5f;
// The search is cut into about 140 parts of the tree, and patches by the hundred.
constexpr int kTreeLevels = 4;
constexpr std::size_t kPatchesPerPart = 128;
constexpr std::size_t kFacesPerRange = 2048;
// A search of moved patches alone pays if they are fewer than one in this many.
constexpr std::size_t kMovedShare = 3;

// The corners are floats, so that their box needs no rounding.
Box face_box(const Positions& positions, const Faces& faces, std::uint32_t face) {
  const float* a = positions.data() + 3 * static_cast<std::size_t>(faces(face, 0));
  const float* b = positions.data() + 3 * static_cast<std::size_t>(faces(face, 1));
  const float* c = positions.data() + 3 * static_cast<std::size_t>(faces(face, 2));
  Box box;
  for (int k = 0; k < 3; ++k) {
    box.lower[k] = std::min(std::min(a[k], b[k]), c[k]);
    box.upper[k] = std::max(std::max(a[k], b[k]), c[k]);
  }
  return box;
}

// Whether the edges opposite to a vertex in its faces form one simple path or one simple cycle, so that the faces form
// a disk.
bool is_disk(std::vector<std::array<std::uint32_t, 2>> ring) {
  const auto start_less = [](const auto& a, const auto& b) { return a[0] < b[0]; };
  std::sort(ring.begin(), ring.end(), start_less);
  std::vector<std::uint32_t> ends;
  ends.reserve(ring.size());
  for (const auto& edge : ring) ends.push_back(edge[1]);
  std::sort(ends.begin(), ends.end());
  if (std::adjacent_find(ends.begin(), ends.end()) != ends.end()) return false;
  for (std::size_t i = 1; i < ring.size(); ++i) {
    if (ring[i][0] == ring[i - 1][0]) return false;
  }
  const auto first = std::find_if(ring.begin(), ring.end(), [&](const auto& edge) {
    return !std::binary_search(ends.begin(), ends.end(), edge[0]);
  });
  std::array<std::uint32_t, 2> edge = first == ring.end() ? ring.front() : *first;
  const std::uint32_t start = edge[0];
  std::size_t length = 1;
  while (edge[1] != start) {
    const auto next = std::lower_bound(ring.begin(), ring.end(), std::array<std::uint32_t, 2>{edge[1], 0}, start_less);
    if (next == ring.end() || (*next)[0] != edge[1]) break;
    edge = *next;
    ++length;
  }
  return length == ring.size();
}

}  // namespace

SelfIntersectionFinder::SelfIntersectionFinder(const Faces& faces, Eigen::Index vertex_count,
                                               const Faces& patch_corners, ThreadPool* pool)
    : pool_(pool), faces_(faces), patch_corners_(patch_corners) {
  if (patch_corners.rows() == 0 || faces.rows() == 0 || faces.rows() % patch_corners.rows() != 0) {
    throw_invalid_argument("self-intersections: " + std::to_string(faces.rows()) + " faces in " +
                           std::to_string(patch_corners.rows()) + " patches");
  }
  if (static_cast<Eigen::Index>(std::max(faces.maxCoeff(), patch_corners.maxCoeff())) >= vertex_count) {
    throw_invalid_argument("self-intersections: a face names a vertex that does not exist");
  }
  patch_size_ = static_cast<std::uint32_t>(faces.rows() / patch_corners.rows());
  boxes_.resize(static_cast<std::size_t>(faces.rows()));
  patch_boxes_.resize(static_cast<std::size_t>(patch_corners.rows()));
  normals_.resize(boxes_.size());
  build_incidence(vertex_count);
  build_umbrellas(vertex_count);
  injective_.resize(umbrellas_.size());
  is_moved_.assign(patch_boxes_.size(), 0);
  corner_used_.assign(umbrellas_.size(), 0);
}

void SelfIntersectionFinder::build_umbrellas(Eigen::Index vertex_count) {
  std::vector<std::vector<std::uint32_t>> patches_at(static_cast<std::size_t>(vertex_count));
  for (Eigen::Index p = 0; p < patch_corners_.rows(); ++p) {
    for (int k = 0; k < 3; ++k) patches_at[patch_corners_(p, k)].push_back(static_cast<std::uint32_t>(p));
  }
  umbrellas_.resize(patches_at.size(), {0, 0, 0, 0});
  std::vector<std::array<std::uint32_t, 2>> ring, edges;
  for (std::size_t v = 0; v < patches_at.size(); ++v) {
    if (patches_at[v].empty()) continue;
    ring.clear();
    edges.clear();
    for (const std::uint32_t p : patches_at[v]) {
      for (int k = 0; k < 3; ++k) {
        if (patch_corners_(p, k) == v) ring.push_back({patch_corners_(p, (k + 1) % 3), patch_corners_(p, (k + 2) % 3)});
      }
      for (std::uint32_t f = p * patch_size_; f < (p + 1) * patch_size_; ++f) {
        for (int k = 0; k < 3; ++k) edges.push_back({faces_(f, k), faces_(f, (k + 1) % 3)});
      }
    }
    if (ring.size() != patches_at[v].size() || !is_disk(ring)) continue;
    std::sort(edges.begin(), edges.end());
    Umbrella& umbrella = umbrellas_[v];
    umbrella.first_patch = static_cast<std::uint32_t>(umbrella_patches_.size());
    umbrella.patch_count = static_cast<std::uint32_t>(patches_at[v].size());
    umbrella.first_edge = static_cast<std::uint32_t>(outlines_.size());
    umbrella_patches_.insert(umbrella_patches_.end(), patches_at[v].begin(), patches_at[v].end());
    for (const auto& edge : edges) {
      if (!std::binary_search(edges.begin(), edges.end(), std::array<std::uint32_t, 2>{edge[1], edge[0]})) {
        outlines_.push_back(edge);
      }
    }
    umbrella.edge_count = static_cast<std::uint32_t>(outlines_.size()) - umbrella.first_edge;
  }
}

void SelfIntersectionFinder::fit_patch(std::uint32_t patch) {
  Box box = boxes_[patch * patch_size_];
  for (std::uint32_t f = patch * patch_size_ + 1; f < (patch + 1) * patch_size_; ++f) box.extend(boxes_[f]);
  patch_boxes_[patch] = box;
}

void SelfIntersectionFinder::refit() {
  if (tree_.empty()) {
    tree_ = Bvh(patch_boxes_);
    tree_parts_ = tree_.self_pair_parts(kTreeLevels);
    parts_.resize(tree_parts_.size() + (patch_boxes_.size() + kPatchesPerPart - 1) / kPatchesPerPart);
    for (Part& part : parts_) part.near.reserve(patch_size_);
    near_.reserve(patch_size_);
  } else {
    tree_.refit(patch_boxes_);
  }
}

void SelfIntersectionFinder::update(const Positions& positions) {
  for_ranges(pool_, patch_boxes_.size(), std::max<std::size_t>(1, kFacesPerRange / patch_size_),
             [&](std::size_t begin, std::size_t end) {
               for (std::size_t f = begin * patch_size_; f < end * patch_size_; ++f) {
                 boxes_[f] = face_box(positions, faces_, static_cast<std::uint32_t>(f));
               }
               for (std::size_t p = begin; p < end; ++p) fit_patch(static_cast<std::uint32_t>(p));
             });
  refit();
}

void SelfIntersectionFinder::build_incidence(Eigen::Index vertex_count) {
  std::vector<std::vector<std::uint32_t>> at(static_cast<std::size_t>(vertex_count));
  for (std::uint32_t f = 0; f < boxes_.size(); ++f) {
    for (int k = 0; k < 3; ++k) {
      auto& list = at[faces_(f, k)];
      if (list.empty() || list.back() != patch_of(f)) list.push_back(patch_of(f));
    }
  }
  vertex_patch_offsets_.push_back(0);
  for (const auto& list : at) {
    vertex_patches_.insert(vertex_patches_.end(), list.begin(), list.end());
    vertex_patch_offsets_.push_back(static_cast<std::uint32_t>(vertex_patches_.size()));
  }
}

void SelfIntersectionFinder::update_patches(const Positions& positions, std::span<const std::uint32_t> patches) {
  for (const std::uint32_t p : patches) {
    const auto [first, last] = patch_faces(p);
    for (std::uint32_t f = first; f < last; ++f) boxes_[f] = face_box(positions, faces_, f);
    measure_normals(positions, first, last);
    fit_patch(p);
  }
  tree_.refit(patch_boxes_);
  corners_.clear();
  for (const std::uint32_t p : patches) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t corner = patch_corners_(p, k);
      if (corner_used_[corner] != 0) continue;
      corner_used_[corner] = 1;
      corners_.push_back(corner);
    }
  }
  for (const std::uint32_t corner : corners_) {
    corner_used_[corner] = 0;
    injective_[corner] = is_injective(umbrellas_[corner], positions);
  }
}

bool SelfIntersectionFinder::is_injective(const Umbrella& umbrella, const Positions& positions) const {
  if (umbrella.edge_count == 0) return false;
  const std::span patches(umbrella_patches_.data() + umbrella.first_patch, umbrella.patch_count);
  Eigen::Vector3f direction = Eigen::Vector3f::Zero();
  for (const std::uint32_t p : patches) {
    for (std::uint32_t f = p * patch_size_; f < (p + 1) * patch_size_; ++f) {
      direction += Eigen::Vector3f(normals_[f][0], normals_[f][1], normals_[f][2]);
    }
  }
  const float length = direction.norm();
  if (!(length > 0)) return false;
  direction /= length;
  for (const std::uint32_t p : patches) {
    for (std::uint32_t f = p * patch_size_; f < (p + 1) * patch_size_; ++f) {
      const auto& n = normals_[f];
      if (!(n[0] * direction.x() + n[1] * direction.y() + n[2] * direction.z() > kOrientationMargin * n[3]))
        return false;
    }
  }
  // The outline is star-shaped about its mean point if all its edges turn the same way around it, once.
  const std::span outline(outlines_.data() + umbrella.first_edge, umbrella.edge_count);
  Eigen::Vector3f center = Eigen::Vector3f::Zero();
  for (const auto& edge : outline) center += positions.row(edge[0]).transpose();
  center /= static_cast<float>(outline.size());
  const Eigen::Vector3f across = direction.unitOrthogonal();
  int turns = 0;
  for (const auto& edge : outline) {
    const Eigen::Vector3f a = positions.row(edge[0]).transpose() - center,
                          b = positions.row(edge[1]).transpose() - center;
    if (!(a.cross(b).dot(direction) > kOrientationMargin * (a.squaredNorm() + b.squaredNorm()))) return false;
    turns += a.dot(across) < 0 && b.dot(across) >= 0;
  }
  return turns == 1;
}

bool SelfIntersectionFinder::excluded(std::uint32_t patch_a, std::uint32_t patch_b) const {
  for (int i = 0; i < 3; ++i) {
    const std::uint32_t corner = patch_corners_(patch_a, i);
    if (injective_[corner] == 0) continue;
    for (int j = 0; j < 3; ++j) {
      if (corner == patch_corners_(patch_b, j)) return true;
    }
  }
  return false;
}

void SelfIntersectionFinder::measure_normals(const Positions& positions, std::size_t first, std::size_t last) {
  for (std::size_t f = first; f < last; ++f) {
    const auto row = static_cast<Eigen::Index>(f);
    const Eigen::Vector3f a = positions.row(faces_(row, 0)), b = positions.row(faces_(row, 1)),
                          c = positions.row(faces_(row, 2));
    const Eigen::Vector3f u = b - a, v = c - a;
    const Eigen::Vector3f n = u.cross(v);
    normals_[f] = {n.x(), n.y(), n.z(), u.squaredNorm() + v.squaredNorm()};
  }
}

// Collects the pairs of one part of the mesh; all searches of one find() stop together at the limit.
class SelfIntersectionFinder::Search {
 public:
  Search(const SelfIntersectionFinder& finder, const Positions& positions, std::size_t limit,
         std::atomic<std::size_t>& count, std::vector<FacePair>& pairs, std::vector<std::uint32_t>& near)
      : finder_(finder), positions_(positions), limit_(limit), count_(count), pairs_(pairs), near_(near) {}

  // Returns false once there are more pairs than the limit.
  bool inside_patch(std::uint32_t patch) {
    if (finder_.patch_size_ == 1 || finder_.excluded(patch, patch)) return true;
    const auto [first, last] = finder_.patch_faces(patch);
    for (std::uint32_t a = first; a < last; ++a) {
      for (std::uint32_t b = a + 1; b < last; ++b) {
        if (!test(a, b)) return false;
      }
    }
    return true;
  }

  bool between_patches(std::uint32_t p, std::uint32_t q) {
    if (finder_.excluded(p, q)) return true;
    const auto [first_p, last_p] = finder_.patch_faces(p);
    const auto [first_q, last_q] = finder_.patch_faces(q);
    near_.clear();
    for (std::uint32_t b = first_q; b < last_q; ++b) {
      if (finder_.boxes_[b].overlaps(finder_.patch_boxes_[p])) near_.push_back(b);
    }
    if (near_.empty()) return true;
    for (std::uint32_t a = first_p; a < last_p; ++a) {
      if (!finder_.boxes_[a].overlaps(finder_.patch_boxes_[q])) continue;
      for (const std::uint32_t b : near_) {
        if (!test(a, b)) return false;
      }
    }
    return true;
  }

 private:
  bool test(std::uint32_t a, std::uint32_t b) {
    if (!finder_.boxes_[a].overlaps(finder_.boxes_[b]) || !faces_intersect(positions_, finder_.faces_, a, b)) {
      return true;
    }
    if (count_.fetch_add(1) >= limit_) return false;
    pairs_.push_back({std::min(a, b), std::max(a, b)});
    return true;
  }

  const SelfIntersectionFinder& finder_;
  const Positions& positions_;
  std::size_t limit_;
  std::atomic<std::size_t>& count_;
  std::vector<FacePair>& pairs_;
  std::vector<std::uint32_t>& near_;
};

bool SelfIntersectionFinder::find(const Positions& positions, std::size_t limit, std::vector<FacePair>& pairs) {
  for_ranges(pool_, boxes_.size(), kFacesPerRange,
             [&](std::size_t begin, std::size_t end) { measure_normals(positions, begin, end); });
  for_ranges(pool_, umbrellas_.size(), 256, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) injective_[v] = is_injective(umbrellas_[v], positions);
  });
  std::atomic<std::size_t> count{0};
  for_ranges(pool_, parts_.size(), 4, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Part& part = parts_[i];
      part.pairs.clear();
      if (count.load() > limit) continue;
      Search search(*this, positions, limit, count, part.pairs, part.near);
      if (i < tree_parts_.size()) {
        tree_.visit_self_pairs(tree_parts_[i], part.stack,
                               [&](std::uint32_t p, std::uint32_t q) { return search.between_patches(p, q); });
        continue;
      }
      const std::size_t first = (i - tree_parts_.size()) * kPatchesPerPart;
      const std::size_t last = std::min(first + kPatchesPerPart, patch_boxes_.size());
      for (std::size_t p = first; p < last; ++p) {
        if (!search.inside_patch(static_cast<std::uint32_t>(p))) break;
      }
    }
  });
  pairs.clear();
  for (const Part& part : parts_) pairs.insert(pairs.end(), part.pairs.begin(), part.pairs.end());
  std::sort(pairs.begin(), pairs.end());
  return count.load() <= limit;
}

bool SelfIntersectionFinder::find_again(const Positions& positions, std::span<const std::uint32_t> moved,
                                        std::size_t limit, std::vector<FacePair>& pairs) {
  if (kMovedShare * moved.size() > patch_boxes_.size()) {
    update(positions);
    return find(positions, limit, pairs);
  }
  update_patches(positions, moved);
  for (const std::uint32_t p : moved) is_moved_[p] = 1;
  std::erase_if(
      pairs, [&](const FacePair& pair) { return (is_moved_[patch_of(pair[0])] | is_moved_[patch_of(pair[1])]) != 0; });
  std::atomic<std::size_t> count{pairs.size()};
  Search search(*this, positions, limit, count, pairs, near_);
  bool complete = true;
  for (const std::uint32_t p : moved) {
    complete = complete && search.inside_patch(p);
    tree_.query(patch_boxes_[p], [&](std::uint32_t q) {
      if (is_moved_[q] == 0 || p < q) complete = complete && search.between_patches(p, q);
    });
  }
  for (const std::uint32_t p : moved) is_moved_[p] = 0;
  std::sort(pairs.begin(), pairs.end());
  return complete && pairs.size() <= limit;
}

}  // namespace pleat::refinement
