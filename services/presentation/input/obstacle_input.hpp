// Obstacles named on the command line, for frames that bring none.
#pragma once

#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "services/presentation/input/axes_and_unit.hpp"
#include "services/presentation/input/sequence_input.hpp"

namespace pleat::presentation {

/// Obstacles in every frame.
class ObstacleInput {
 public:
  /// Each text is one of
  ///   sphere:X,Y,Z,RADIUS   metres, at rest
  ///   capsule:X,Y,Z,X,Y,Z,RADIUS   metres, from end to end, at rest
  ///   MESH.obj              a mesh at rest; what is open gets lids (close_holes)
  ///   MESH.obj@FRAMES       the same, moved: FRAMES as open_frame_sequence, the last frame stays
  /// Names are the files' or sphere, sphere2, ..., capsule, ... Throws kInvalidArgument, kNotFound; the text is named.
  /// `files` is what meshes and their frames are in; spheres and capsules are in metres with Y up.
  explicit ObstacleInput(const std::vector<std::string>& texts, const AxesAndUnit& files = {});

  /// What was changed, a line each.
  const std::vector<std::string>& notes() const { return notes_; }

  std::vector<ObstacleShape> shapes() const;
  std::vector<ObstacleFrame> at(std::size_t frame) const;

 private:
  struct Obstacle {
    ObstacleShape shape;
    ObstacleFrame rest;
    std::shared_ptr<FrameSequence> motion;
  };
  AxesAndUnit files_;
  std::vector<Obstacle> obstacles_;
  std::vector<std::string> notes_;
};

}  // namespace pleat::presentation
