// The barycentrically upsampled coarse mesh as a function of the coarse image.
#pragma once

#include <cstdint>
#include <vector>

namespace pleat::superres {

inline constexpr int kStructureChannels = 32;
inline constexpr int kLocalChannels = 17;

/// The coarse image is a linear function of the coarse vertices with more values than unknowns, so it can be undone;
/// the fine image of the barycentrically upsampled mesh follows. One for a mesh and an image size, in texels h w and H
/// W.
struct MeshBase {
  std::int64_t vertices = 0;
  std::vector<std::int64_t> vertex_texels;  ///< (V_coarse x K): texels near a vertex
  std::vector<float> vertex_weights;        ///< (V_coarse x K): the vertex's value is their weighted sum, exactly
  std::vector<std::int64_t> corners;        ///< (3 x H W): coarse vertices around a fine texel
  std::vector<float> weights;               ///< (3 x H W): barycentric, sum 1
  std::vector<float> rest;                  ///< (3 x h w): rest positions at the coarse texels, metres
  std::vector<float> structure;             ///< (32 x h x w): the two largest weights of each of the 4 x 4 fine texels
};

}  // namespace pleat::superres
