// How vertex features are made.
#pragma once

#include <cmath>

namespace pleat::conversion {

/// How a rotation is written down.
enum class RotationCode {
  kLogarithm,   ///< three numbers v with exp(v) = R: (angle + 2 pi k) axis for any integer k
  kQuaternion,  ///< four numbers: q or -q. Bounded, and continuous for every continuous motion
};

/// What a network answers for a fine vertex.
enum class AnswerKind {
  kGradients,      ///< its offset from the upsampled coarse surface, and what its gradient has more than that surface's
  kFeatures,       ///< the same offset, and rotation and stretch of its one-ring
  kFeaturesAlone,  ///< rotation and stretch: the centroid of the coarse mesh places the fine one
};

inline constexpr int kDefaultPasses = 2, kMostPasses = 8;
inline constexpr double kDefaultAnchorWeight = 0.1;

struct VertexFeatureSpec {
  RotationCode rotation = RotationCode::kLogarithm;
  bool fixed_axes = false;      ///< values in the scene's axes, not turned with the cloth about the vertical one
  int passes = kDefaultPasses;  ///< corrections of an answer's positions by its gradients, 0 to kMostPasses
  double anchor_weight = kDefaultAnchorWeight;  ///< of the coarse vertices meanwhile (Anchors::weight), > 0
  AnswerKind answer = AnswerKind::kGradients;
  bool obstacles = false;  ///< the network reads where obstacles are, too
};

/// Fine vertices in a coarse face whose edges were halved `rounds` times, those on its edges included.
inline int patch_vertices(int rounds) {
  const int n = 1 << rounds;
  return (n + 1) * (n + 2) / 2;
}

/// Side of the smallest square that has a place for each of them.
inline int patch_side(int rounds) { return static_cast<int>(std::ceil(std::sqrt(patch_vertices(rounds)))); }

}  // namespace pleat::conversion
