// Animations of obstacles on their way: a scene that only says how many samples there are, and the samples in parts.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "pleat/v1/scene.pb.h"

namespace pleat {

/// All animations of a scene together, bytes of positions.
inline constexpr std::uint64_t kMaxAnimationBytes = std::uint64_t{1} << 30;
/// Up to here the samples of all animations stay in the scene's own message.
inline constexpr std::uint64_t kInlineAnimationBytes = 16u << 20;

/// How many points an obstacle's animation moves: a mesh's vertices, two for a capsule, one for a sphere.
std::size_t animated_points(const v1::Obstacle& obstacle);

/// Where the animations of the scene hold more than `inline_bytes`: takes the positions out of it, says in `samples`
/// how many there are, and returns them in parts of whole samples and about 4 MiB. Otherwise leaves the scene as it is
/// and returns nothing. An animation that holds no whole number of samples stays where it is, for a receiver to refuse.
std::vector<v1::AnimationPart> take_animations(v1::Scene& scene, std::uint64_t inline_bytes = kInlineAnimationBytes);

/// The reverse: puts parts where the scene announces them. The scene must outlive it.
class AnimationAssembly {
 public:
  /// Throws kInvalidArgument (an animation that has both positions and `samples`; obstacles that share a name, or have
  /// no points), kResourceExhausted above kMaxAnimationBytes.
  AnimationAssembly(v1::Scene& scene, const std::string& field);

  /// Whether nothing is missing; the scene is as if it had never been taken apart then.
  bool complete() const { return missing_.empty(); }
  /// Throws kInvalidArgument: an obstacle that misses nothing, no whole number of samples, more than were announced.
  void add(const v1::AnimationPart& part);
  /// "obstacle 'body' misses 12 samples of its animation", of the first that does.
  std::string describe_missing() const;

 private:
  struct Missing {
    v1::Animation* animation = nullptr;
    std::size_t row = 0;       ///< values of a sample
    std::uint64_t values = 0;  ///< of all samples
  };
  std::map<std::string, Missing> missing_;  // by name
};

}  // namespace pleat
