// Puts garments of about the right place onto a body: shrinks the body to its bones inside them and lets it grow.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/simulation/body/skinned_mesh.hpp"
#include "services/simulation/material.hpp"

namespace pleat::dress {

struct Garment {
  std::string name;  ///< for messages
  Topology mesh;     ///< about where it is to be worn, metres; its size is that of its material coordinates
};

struct DressOptions {
  simulation::Material material;
  double reach_m = 0.2;              ///< how far a garment is moved at most to get around the body; 0 to 1
  int grow_frames = 50;              ///< of 40 ms, in which the body grows from its bones
  int settle_frames = 25;            ///< of 40 ms, in which the garments come to rest under gravity
  std::vector<Positions> then = {};  ///< where the body's vertices are in further frames: into a pose
  int threads = 0;
};

struct Dressed {
  std::vector<Positions> garments;  ///< per garment, its vertices as they are worn
  std::vector<double> stretch;      ///< per garment: length over length in the material, exceeded by 2 % of the edges
  std::vector<std::string> notes;   ///< for people, a line each
};

/// Dresses the body, at rest, in the garments, the innermost first. Every garment is moved by at most reach_m to where
/// bones pierce its openings and don't cross it; around it the body grows from its bones, and pushes the cloth before
/// it; what crosses a garment worn before it is untangled, and all settle together. The result is free of
/// self-intersections and penetrations.
/// on_frame: called with the frames done, of grow_frames a garment, settle_frames and those of `then`;
/// may be empty. Throws kInvalidArgument, naming the garment: without an
/// opening, inside out, not around the body, in another unit, not to be untangled; kFailedPrecondition: stuck (too
/// tight, with the joint where the cloth is stretched most), or slipped off.
Dressed dress(const std::vector<Garment>& garments, const body::SkinnedMesh& body, const DressOptions& options,
              const std::function<void(std::size_t)>& on_frame = {});

}  // namespace pleat::dress
