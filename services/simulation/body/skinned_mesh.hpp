// A mesh that follows a skeleton.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/simulation/body/skeleton.hpp"

namespace pleat::body {

inline constexpr int kInfluences = 4;

using JointIndices = Eigen::Matrix<std::uint16_t, Eigen::Dynamic, kInfluences, Eigen::RowMajor>;  ///< (V x 4)
using JointWeights = Eigen::Matrix<float, Eigen::Dynamic, kInfluences, Eigen::RowMajor>;          ///< (V x 4)

/// A mesh at the skeleton's rest pose, and the joints that each vertex follows. Weights of a vertex sum to 1; unused
/// places have weight 0 and joint 0.
struct SkinnedMesh {
  Topology mesh;
  Skeleton skeleton;
  JointIndices joints;
  JointWeights weights;
};

/// Throws kInvalidArgument, naming `source` and vertex or joint: validate_skeleton and validate_topology, no faces,
/// another number of rows than vertices, a joint that does not exist, weights that are negative, not finite or do not
/// sum to 1 within 1e-3.
void validate_skinned_mesh(const SkinnedMesh& body, const std::string& source);

enum class Skinning {
  kLinear,          ///< x -> sum_j w_j T_j x: what every tool does; wrists that twist and raised shoulders get thin
  kDualQuaternion,  ///< Kavan et al. 2007, the normalised sum of dual quaternions: keeps volume, bulges at joints
};

/// Where the vertices are when the joints are there. O(V). Returns (V x 3) metres.
Positions skin(const SkinnedMesh& body, const std::vector<RigidTransform>& world, Skinning skinning);

}  // namespace pleat::body
