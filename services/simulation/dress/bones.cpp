#include "services/simulation/dress/bones.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "common/mesh/closest_points.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/triangle_intersection.hpp"

namespace pleat::dress {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr double kShortest = 1e-3;  // m: what is shorter has no direction
// A place is as good as the room between cloth and bones, up to kRoom, less a part of the way there.
constexpr double kRoom = 0.025;  // m
constexpr double kCostOfWay = 0.1;

Vector3d point(const Positions& positions, Eigen::Index v) { return positions.row(v).cast<double>().transpose(); }

Vector3d nearest_on(const Bone& bone, const Vector3d& p) {
  return bone.from + closest_on_segment(p, bone.from, bone.to) * (bone.to - bone.from);
}

}  // namespace

std::vector<Bone> bones_of(const body::SkinnedMesh& body) {
  const auto joints = body.skeleton.joints.size();
  const std::vector<body::RigidTransform> world = body::world_transforms(body.skeleton, body::rest_pose(body.skeleton));
  std::vector<char> followed(joints, 0), parent(joints, 0);
  std::vector<Vector3d> farthest(joints, Vector3d::Zero());
  std::vector<double> reach(joints, 0);
  for (Eigen::Index v = 0; v < body.mesh.vertex_count(); ++v) {
    Eigen::Index strongest = 0;
    body.weights.row(v).maxCoeff(&strongest);
    const std::size_t j = body.joints(v, strongest);
    const Vector3d p = point(body.mesh.rest_positions, v);
    followed[j] = 1;
    if ((p - world[j].translation).norm() <= reach[j]) continue;
    reach[j] = (p - world[j].translation).norm();
    farthest[j] = p;
  }
  std::vector<Bone> bones;
  const auto add = [&](std::size_t joint, const Vector3d& to) {
    const Vector3d from = world[joint].translation;
    if ((to - from).norm() > kShortest) bones.push_back({static_cast<int>(joint), from, to});
  };
  for (std::size_t j = 0; j < joints; ++j) {
    const int p = body.skeleton.joints[j].parent;
    if (p < 0) continue;
    parent[static_cast<std::size_t>(p)] = 1;
    if (followed[static_cast<std::size_t>(p)]) add(static_cast<std::size_t>(p), world[j].translation);
  }
  for (std::size_t j = 0; j < joints; ++j) {
    if (followed[j] && !parent[j]) add(j, farthest[j]);
  }
  return bones;
}

Shrunk::Shrunk(const body::SkinnedMesh& body) : full_(body.mesh.rest_positions), bones_(full_) {
  std::vector<std::vector<Bone>> of_joint(body.skeleton.joints.size());
  for (const Bone& bone : bones_of(body)) of_joint[static_cast<std::size_t>(bone.joint)].push_back(bone);
  for (Eigen::Index v = 0; v < full_.rows(); ++v) {
    const Vector3d p = point(full_, v);
    Vector3d sum = Vector3d::Zero();
    for (int k = 0; k < body::kInfluences; ++k) {
      const auto weight = static_cast<double>(body.weights(v, k));
      if (weight == 0) continue;
      Vector3d nearest = p;
      double least = std::numeric_limits<double>::infinity();
      for (const Bone& bone : of_joint[body.joints(v, k)]) {
        const Vector3d candidate = nearest_on(bone, p);
        if ((candidate - p).squaredNorm() >= least) continue;
        least = (candidate - p).squaredNorm();
        nearest = candidate;
      }
      sum += weight * nearest;
    }
    bones_.row(v) = sum.cast<float>().transpose();
  }
}

Positions Shrunk::at(double fullness) const {
  const auto share = static_cast<float>(fullness);
  return fullness >= 1 ? full_ : Positions((1 - share) * bones_ + share * full_);
}

std::vector<std::vector<std::uint32_t>> openings(const Faces& faces) {
  Eigen::Index vertices = 0;
  if (faces.size() > 0) vertices = static_cast<Eigen::Index>(faces.maxCoeff()) + 1;
  std::map<std::uint32_t, std::uint32_t> next;
  for (const Edge& edge : build_connectivity(vertices, faces).edges) {
    if (edge.f1 == kNone) next[edge.v0] = edge.v1;
  }
  std::vector<std::vector<std::uint32_t>> loops;
  while (!next.empty()) {
    std::vector<std::uint32_t>& loop = loops.emplace_back();
    auto at = next.begin();
    while (at != next.end()) {
      loop.push_back(at->first);
      const std::uint32_t to = at->second;
      next.erase(at);
      at = next.find(to);
    }
  }
  return loops;
}

Placement::Placement(const Positions& positions, const Faces& faces, std::vector<Bone> bones)
    : positions_(positions), faces_(faces), bones_(std::move(bones)), openings_(openings(faces)) {
  std::vector<Box> boxes(static_cast<std::size_t>(faces.rows()));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) boxes[static_cast<std::size_t>(f)].extend(point(positions_, faces_(f, k)));
  }
  tree_ = Bvh(boxes);
  for (const auto& loop : openings_) {
    Vector3d sum = Vector3d::Zero();
    for (const std::uint32_t v : loop) sum += point(positions_, v);
    centers_.push_back(sum / static_cast<double>(loop.size()));
  }
}

Enclosure Placement::enclosure(const Vector3d& translation) const {
  Enclosure result;
  result.pierced.assign(openings_.size(), 0);
  const auto corner = [&](std::uint32_t v) -> Vector3f { return positions_.row(v).transpose(); };
  for (const Bone& bone : bones_) {
    const Vector3d from = bone.from - translation, to = bone.to - translation;
    const Vector3f a = from.cast<float>(), b = to.cast<float>();
    Box box;
    box.extend(from);
    box.extend(to);
    bool crosses = false;
    tree_.query(box, [&](std::uint32_t f) {
      const Triangle3f face{corner(faces_(f, 0)), corner(faces_(f, 1)), corner(faces_(f, 2))};
      crosses = crosses || segment_intersects_triangle(a, b, face);
    });
    result.crossed += crosses ? 1 : 0;
    for (std::size_t o = 0; o < openings_.size(); ++o) {
      const auto& loop = openings_[o];
      const Vector3f center = centers_[o].cast<float>();
      for (std::size_t i = 0; i < loop.size() && !result.pierced[o]; ++i) {
        const Triangle3f fan{center, corner(loop[i]), corner(loop[(i + 1) % loop.size()])};
        if (segment_intersects_triangle(a, b, fan)) result.pierced[o] = 1;
      }
    }
  }
  result.pierced_count = static_cast<std::size_t>(std::count(result.pierced.begin(), result.pierced.end(), 1));
  return result;
}

std::optional<Vector3d> Placement::nearest_worn(double reach, double spacing) const {
  std::vector<Vector3d> places;
  const int most = static_cast<int>(reach / spacing);
  for (int x = -most; x <= most; ++x) {
    for (int y = -most; y <= most; ++y) {
      for (int z = -most; z <= most; ++z) {
        const Vector3d place = spacing * Vector3d(x, y, z);
        if (place.norm() <= reach) places.push_back(place);
      }
    }
  }
  std::stable_sort(places.begin(), places.end(),
                   [](const Vector3d& a, const Vector3d& b) { return a.squaredNorm() < b.squaredNorm(); });
  std::optional<Vector3d> best;
  // A body goes into a hat, but through everything else.
  std::size_t most_pierced = std::min<std::size_t>(2, openings_.size());
  double best_score = -std::numeric_limits<double>::infinity();
  for (const Vector3d& place : places) {
    const double cost = kCostOfWay * place.norm();
    // What comes is farther away: nothing beats a place with enough room.
    if (most_pierced == openings_.size() && kRoom - cost <= best_score) break;
    const Enclosure there = enclosure(place);
    if (there.crossed > 0 || there.pierced_count < most_pierced) continue;
    const double score = std::min(kRoom, clearance(place)) - cost;
    if (there.pierced_count == most_pierced && score <= best_score) continue;
    most_pierced = there.pierced_count;
    best_score = score;
    best = place;
  }
  return best;
}

double Placement::clearance(const Vector3d& translation) const {
  double least = std::numeric_limits<double>::infinity();
  const auto measure = [&](const Vector3d& p) {
    for (const Bone& bone : bones_) least = std::min(least, (p - nearest_on(bone, p)).squaredNorm());
  };
  for (Eigen::Index v = 0; v < positions_.rows(); ++v) measure(point(positions_, v) + translation);
  for (Eigen::Index f = 0; f < faces_.rows(); ++f) {
    measure((point(positions_, faces_(f, 0)) + point(positions_, faces_(f, 1)) + point(positions_, faces_(f, 2))) / 3 +
            translation);
  }
  return std::sqrt(least);
}

double Placement::outward_share(const Vector3d& translation) const {
  double outward = 0, all = 0;
  for (Eigen::Index f = 0; f < faces_.rows(); ++f) {
    const Vector3d a = point(positions_, faces_(f, 0)), b = point(positions_, faces_(f, 1)),
                   c = point(positions_, faces_(f, 2));
    const Vector3d center = (a + b + c) / 3 + translation, normal = (b - a).cross(c - a);
    Vector3d away = Vector3d::Zero();
    double least = std::numeric_limits<double>::infinity();
    for (const Bone& bone : bones_) {
      const Vector3d way = center - nearest_on(bone, center);
      if (way.squaredNorm() >= least) continue;
      least = way.squaredNorm();
      away = way;
    }
    all += normal.norm();
    if (normal.dot(away) > 0) outward += normal.norm();
  }
  return all > 0 ? outward / all : 0;
}

}  // namespace pleat::dress
