#include "services/simulation/body/skinned_mesh.hpp"

#include <cmath>

#include "common/base/error.hpp"

namespace pleat::body {
namespace {

using Eigen::Matrix3f;
using Eigen::Quaterniond;
using Eigen::Quaternionf;
using Eigen::Vector3f;

/// What a joint does to a point of the rest pose: its transform now after the inverse of that at rest.
std::vector<RigidTransform> rest_to_now(const SkinnedMesh& body, const std::vector<RigidTransform>& world) {
  std::vector<RigidTransform> moves = world_transforms(body.skeleton, rest_pose(body.skeleton));
  for (std::size_t j = 0; j < moves.size(); ++j) moves[j] = world[j] * moves[j].inverse();
  return moves;
}

Positions skin_linear(const SkinnedMesh& body, const std::vector<RigidTransform>& moves) {
  std::vector<Eigen::Matrix<float, 3, 4>> matrices(moves.size());
  for (std::size_t j = 0; j < moves.size(); ++j) {
    matrices[j].leftCols<3>() = moves[j].rotation.toRotationMatrix().cast<float>();
    matrices[j].col(3) = moves[j].translation.cast<float>();
  }
  Positions result(body.mesh.vertex_count(), 3);
  for (Eigen::Index v = 0; v < result.rows(); ++v) {
    Eigen::Matrix<float, 3, 4> blend = body.weights(v, 0) * matrices[body.joints(v, 0)];
    for (int k = 1; k < kInfluences; ++k)
      if (body.weights(v, k) != 0) blend += body.weights(v, k) * matrices[body.joints(v, k)];
    result.row(v) = (blend.leftCols<3>() * body.mesh.rest_positions.row(v).transpose() + blend.col(3)).transpose();
  }
  return result;
}

struct DualQuaternion {
  Eigen::Vector4f real, dual;  // x y z w
};

Positions skin_dual_quaternion(const SkinnedMesh& body, const std::vector<RigidTransform>& moves) {
  std::vector<DualQuaternion> duals;
  for (const RigidTransform& move : moves) {
    const Quaterniond shift(0, move.translation.x(), move.translation.y(), move.translation.z());
    const Quaterniond dual = shift * move.rotation;
    duals.push_back({move.rotation.coeffs().cast<float>(), 0.5F * dual.coeffs().cast<float>()});
  }
  Positions result(body.mesh.vertex_count(), 3);
  for (Eigen::Index v = 0; v < result.rows(); ++v) {
    const DualQuaternion& first = duals[body.joints(v, 0)];
    Eigen::Vector4f real = Eigen::Vector4f::Zero(), dual = Eigen::Vector4f::Zero();
    for (int k = 0; k < kInfluences; ++k) {
      const DualQuaternion& q = duals[body.joints(v, k)];
      // q and -q are one rotation: the sum takes the one on the first joint's side.
      const float weight = q.real.dot(first.real) < 0 ? -body.weights(v, k) : body.weights(v, k);
      real += weight * q.real;
      dual += weight * q.dual;
    }
    const float length = real.norm();
    real /= length;
    dual /= length;
    const Vector3f axis = real.head<3>(), moved = dual.head<3>();
    const Vector3f x = body.mesh.rest_positions.row(v).transpose();
    const Vector3f turned = x + 2 * axis.cross(axis.cross(x) + real.w() * x);
    result.row(v) = (turned + 2 * (real.w() * moved - dual.w() * axis + axis.cross(moved))).transpose();
  }
  return result;
}

}  // namespace

void validate_skinned_mesh(const SkinnedMesh& body, const std::string& source) {
  if (body.mesh.face_count() == 0) throw_invalid_argument(source + ": no mesh");
  validate_skeleton(body.skeleton, source);
  validate_topology(body.mesh, source);
  const Eigen::Index vertices = body.mesh.vertex_count();
  if (body.joints.rows() != vertices || body.weights.rows() != vertices)
    throw_invalid_argument(source + ": " + std::to_string(body.weights.rows()) + " rows of skinning weights for " +
                           std::to_string(vertices) + " vertices");
  for (Eigen::Index v = 0; v < vertices; ++v) {
    const std::string which = source + ": vertex " + std::to_string(v);
    for (int k = 0; k < kInfluences; ++k) {
      if (body.joints(v, k) >= body.skeleton.size())
        throw_invalid_argument(which + " follows joint " + std::to_string(body.joints(v, k)) + ", there are " +
                               std::to_string(body.skeleton.size()));
      if (!(body.weights(v, k) >= 0)) throw_invalid_argument(which + " has a skinning weight below 0");
    }
    if (!(std::abs(body.weights.row(v).sum() - 1) < 1e-3))
      throw_invalid_argument(which + ": its skinning weights do not sum to 1");
  }
}

Positions skin(const SkinnedMesh& body, const std::vector<RigidTransform>& world, Skinning skinning) {
  const std::vector<RigidTransform> moves = rest_to_now(body, world);
  return skinning == Skinning::kLinear ? skin_linear(body, moves) : skin_dual_quaternion(body, moves);
}

}  // namespace pleat::body
