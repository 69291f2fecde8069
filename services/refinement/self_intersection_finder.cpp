#include "services/refinement/self_intersection_finder.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <string>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/triangle_intersection.hpp"

namespace pleat {
namespace {

// How far from zero, relative to the lengths, an orientation in float arithmetic is trusted: the rounding error is
// below 1e-6.
constexpr float kOrientationMargin = 1e-5f;

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
                                               const Faces& patch_corners)
    : faces_(faces), patch_corners_(patch_corners) {
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
  build_umbrellas(vertex_count);
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
  } else {
    tree_.refit(patch_boxes_);
  }
}

void SelfIntersectionFinder::update(const Positions& positions) {
  for (std::uint32_t f = 0; f < boxes_.size(); ++f) boxes_[f] = face_box(positions, faces_, f);
  for (std::uint32_t p = 0; p < patch_boxes_.size(); ++p) fit_patch(p);
  refit();
}

void SelfIntersectionFinder::update(const Positions& positions, std::span<const std::uint32_t> moved_faces) {
  for (const std::uint32_t f : moved_faces) boxes_[f] = face_box(positions, faces_, f);
  for (const std::uint32_t f : moved_faces) fit_patch(f / patch_size_);
  refit();
}

void SelfIntersectionFinder::update_swept(const Positions& start, const Positions& end,
                                          std::span<const std::uint32_t> moving_faces) {
  for (const std::uint32_t f : moving_faces) {
    boxes_[f] = face_box(start, faces_, f);
    boxes_[f].extend(face_box(end, faces_, f));
  }
  for (const std::uint32_t f : moving_faces) fit_patch(f / patch_size_);
  refit();
}

bool SelfIntersectionFinder::is_injective(const Umbrella& umbrella, const Positions& positions,
                                          const std::vector<std::array<float, 4>>& normals) const {
  if (umbrella.edge_count == 0) return false;
  const std::span patches(umbrella_patches_.data() + umbrella.first_patch, umbrella.patch_count);
  Eigen::Vector3f direction = Eigen::Vector3f::Zero();
  for (const std::uint32_t p : patches) {
    for (std::uint32_t f = p * patch_size_; f < (p + 1) * patch_size_; ++f) {
      direction += Eigen::Vector3f(normals[f][0], normals[f][1], normals[f][2]);
    }
  }
  const float length = direction.norm();
  if (!(length > 0)) return false;
  direction /= length;
  for (const std::uint32_t p : patches) {
    for (std::uint32_t f = p * patch_size_; f < (p + 1) * patch_size_; ++f) {
      const auto& n = normals[f];
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

bool SelfIntersectionFinder::excluded(std::uint32_t patch_a, std::uint32_t patch_b,
                                      const std::vector<std::uint8_t>& injective) const {
  for (int i = 0; i < 3; ++i) {
    const std::uint32_t corner = patch_corners_(patch_a, i);
    if (injective[corner] == 0) continue;
    for (int j = 0; j < 3; ++j) {
      if (corner == patch_corners_(patch_b, j)) return true;
    }
  }
  return false;
}

bool SelfIntersectionFinder::find(const Positions& positions, std::size_t limit, std::vector<FacePair>& out) const {
  const std::size_t first = out.size();
  // Normals of twice the area, and a bound of the product of the edge lengths that they come from.
  std::vector<std::array<float, 4>> normals(boxes_.size());
  for (std::size_t f = 0; f < normals.size(); ++f) {
    const auto row = static_cast<Eigen::Index>(f);
    const Eigen::Vector3f a = positions.row(faces_(row, 0)), b = positions.row(faces_(row, 1)),
                          c = positions.row(faces_(row, 2));
    const Eigen::Vector3f u = b - a, v = c - a;
    const Eigen::Vector3f n = u.cross(v);
    normals[f] = {n.x(), n.y(), n.z(), u.squaredNorm() + v.squaredNorm()};
  }
  std::vector<std::uint8_t> injective(umbrellas_.size());
  for (std::size_t v = 0; v < umbrellas_.size(); ++v) injective[v] = is_injective(umbrellas_[v], positions, normals);

  const auto test = [&](std::uint32_t a, std::uint32_t b) {
    if (!boxes_[a].overlaps(boxes_[b]) || !faces_intersect(positions, faces_, a, b)) return true;
    if (out.size() - first >= limit) return false;
    out.push_back({std::min(a, b), std::max(a, b)});
    return true;
  };
  const auto inside_patch = [&](std::uint32_t patch) {
    if (patch_size_ == 1 || excluded(patch, patch, injective)) return true;
    for (std::uint32_t a = patch * patch_size_; a < (patch + 1) * patch_size_; ++a) {
      for (std::uint32_t b = a + 1; b < (patch + 1) * patch_size_; ++b) {
        if (!test(a, b)) return false;
      }
    }
    return true;
  };
  bool complete = true;
  for (std::uint32_t p = 0; complete && p < patch_boxes_.size(); ++p) complete = inside_patch(p);
  complete = complete && tree_.visit_self_pairs([&](std::uint32_t p, std::uint32_t q) {
    if (excluded(p, q, injective)) return true;
    for (std::uint32_t a = p * patch_size_; a < (p + 1) * patch_size_; ++a) {
      if (!boxes_[a].overlaps(patch_boxes_[q])) continue;
      for (std::uint32_t b = q * patch_size_; b < (q + 1) * patch_size_; ++b) {
        if (!test(a, b)) return false;
      }
    }
    return true;
  });
  std::sort(out.begin() + static_cast<std::ptrdiff_t>(first), out.end());
  return complete;
}

}  // namespace pleat
