#include "services/dataset/poses.hpp"

#include <algorithm>
#include <cstdio>
#include <limits>

#include "services/simulation/dress/bones.hpp"

namespace pleat::dataset {
namespace {

using Eigen::Vector3d;

constexpr double kInside = 0.2;  // share of a joint's skin within the radius of its bones

double distance_to_segment(const Vector3d& x, const Vector3d& a, const Vector3d& b) {
  const Vector3d along = b - a;
  const double length = along.squaredNorm();
  const double t = length > 0 ? std::clamp((x - a).dot(along) / length, 0.0, 1.0) : 0.0;
  return (x - a - t * along).norm();
}

double distance_of_segments(const Vector3d& p, const Vector3d& q, const Vector3d& r, const Vector3d& s) {
  const Vector3d u = q - p, v = s - r, w = p - r;
  const double uu = u.squaredNorm(), uv = u.dot(v), vv = v.squaredNorm(), uw = u.dot(w), vw = v.dot(w);
  const double determinant = uu * vv - uv * uv;
  // Inside both if the lines' nearest points are; else at an end of one.
  if (determinant > 1e-12 * uu * vv) {
    const double a = (uv * vw - vv * uw) / determinant, b = (uu * vw - uv * uw) / determinant;
    if (a >= 0 && a <= 1 && b >= 0 && b <= 1) return (w + a * u - b * v).norm();
  }
  return std::min(std::min(distance_to_segment(p, r, s), distance_to_segment(q, r, s)),
                  std::min(distance_to_segment(r, p, q), distance_to_segment(s, p, q)));
}

std::string millimetres(double metres) {
  char text[32];
  std::snprintf(text, sizeof text, "%.0f mm", 1e3 * metres);
  return text;
}

Vector3d row(const Positions& positions, Eigen::Index i) { return positions.row(i).transpose().cast<double>(); }

}  // namespace

PoseJudge::PoseJudge(const body::SkinnedMesh& body, const Positions& garment) : skeleton_(body.skeleton) {
  const std::vector<body::RigidTransform> rest = body::world_transforms(body.skeleton, body::rest_pose(body.skeleton));
  const std::vector<dress::Bone> bones = dress::bones_of(body);
  std::vector<std::vector<double>> skin(body.skeleton.size());
  for (Eigen::Index v = 0; v < body.mesh.vertex_count(); ++v) {
    Eigen::Index strongest = 0;
    body.weights.row(v).maxCoeff(&strongest);
    const int joint = body.joints(v, strongest);
    double distance = std::numeric_limits<double>::infinity();
    for (const dress::Bone& bone : bones) {
      if (bone.joint != joint) continue;
      distance = std::min(distance, distance_to_segment(row(body.mesh.rest_positions, v), bone.from, bone.to));
    }
    skin[static_cast<std::size_t>(joint)].push_back(distance);
  }
  for (const dress::Bone& bone : bones) {
    const auto joint = static_cast<std::size_t>(bone.joint);
    std::vector<double>& distances = skin[joint];
    if (distances.empty()) continue;
    const auto place = distances.begin() + static_cast<std::ptrdiff_t>(kInside * static_cast<double>(distances.size()));
    std::nth_element(distances.begin(), place, distances.end());
    Bone kept{joint, rest[joint].inverse() * bone.from, rest[joint].inverse() * bone.to, *place, false};
    for (Eigen::Index v = 0; v < garment.rows() && !kept.near; ++v) {
      kept.near = distance_to_segment(row(garment, v), bone.from, bone.to) < kept.radius + kNear;
    }
    bones_.push_back(kept);
  }
  const auto at_rest = [&](const Bone& bone, const Vector3d& x) { return rest[bone.joint] * x; };
  const auto parent = [&](const Bone& bone) { return skeleton_.joints[bone.joint].parent; };
  for (std::size_t i = 0; i < bones_.size(); ++i) {
    for (std::size_t j = i + 1; j < bones_.size(); ++j) {
      const Bone &a = bones_[i], &b = bones_[j];
      const int joint_a = static_cast<int>(a.joint), joint_b = static_cast<int>(b.joint);
      if (joint_a == joint_b || parent(a) == joint_b || parent(b) == joint_a || !(a.near || b.near)) continue;
      const double apart =
          distance_of_segments(at_rest(a, a.from), at_rest(a, a.to), at_rest(b, b.from), at_rest(b, b.to));
      if (apart > a.radius + b.radius) pairs_.emplace_back(i, j);
    }
  }
}

std::vector<std::string> PoseJudge::faults(const body::Motion& motion) const {
  std::vector<std::string> faults(motion.frames.size());
  for (std::size_t k = 0; k < motion.frames.size(); ++k) {
    if (k + 1 < motion.frames.size()) {
      const auto fast =
          body::find_fast({motion.skeleton, motion.frame_time_s, {motion.frames[k], motion.frames[k + 1]}}, kMostSpeed);
      if (!fast.empty()) {
        const std::string text = body::describe(fast.front(), kMostSpeed);
        faults[k] = text.substr(text.find(": ") + 2);
        continue;
      }
    }
    const std::vector<body::RigidTransform> world = body::world_transforms(motion.skeleton, motion.frames[k]);
    double deepest = kMostOverlap;
    for (const auto& [i, j] : pairs_) {
      const Bone &a = bones_[i], &b = bones_[j];
      const body::RigidTransform &at = world[a.joint], &bt = world[b.joint];
      const double overlap = a.radius + b.radius - distance_of_segments(at * a.from, at * a.to, bt * b.from, bt * b.to);
      if (overlap <= deepest) continue;
      deepest = overlap;
      faults[k] = skeleton_.joints[a.joint].name + " and " + skeleton_.joints[b.joint].name + " are " +
                  millimetres(overlap) + " inside each other";
    }
  }
  return faults;
}

WornJudge::WornJudge(const Positions& garment, const Positions& body) {
  for (Eigen::Index v = 0; v < garment.rows(); ++v) {
    Eigen::Index nearest = 0;
    (body.rowwise() - garment.row(v)).rowwise().squaredNorm().minCoeff(&nearest);
    nearest_.push_back(nearest);
  }
  at_first_ = slip(garment, body);
}

Vector3d WornJudge::slip(const Positions& garment, const Positions& body) const {
  Vector3d sum = Vector3d::Zero();
  for (std::size_t v = 0; v < nearest_.size(); ++v) {
    sum += row(garment, static_cast<Eigen::Index>(v)) - row(body, nearest_[v]);
  }
  return sum / static_cast<double>(nearest_.size());
}

std::string WornJudge::why_not(const Positions& garment, const Positions& body, double lag_m, std::uint64_t cut_steps,
                               int steps) const {
  if (lag_m > kMostLag) return "the body is " + millimetres(lag_m) + " behind its motion, for cloth that it pinches";
  if (cut_steps >= static_cast<std::uint64_t>(steps)) {
    return std::to_string(cut_steps) + " steps had to be cut, the cloth has no room between parts of the body";
  }
  const double slipped = (slip(garment, body) - at_first_).norm();
  if (slipped > kMostSlip) return "the garment is " + millimetres(slipped) + " from where it was worn";
  return {};
}

}  // namespace pleat::dataset
