// Mirrored copies of a flat sheet: what its pairs look like in a mirror. Inside services/superres only: this header
// needs LibTorch.
#pragma once

#include <torch/torch.h>

#include <cstdint>
#include <vector>

#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// Three reflections: along u (bit 0) and v (bit 1), which reverse the images, and across the sheet (bit 2). Vectors in
/// the alignment's axes are reflected, normals turned round where the order of u and v stays; values in the cloth's own
/// axes change their sign or don't. Each is its own inverse. Where all is in the cloth's own axes any garment has such
/// copies, and they are those of its mirror image with u or v counted the other way.
class Mirror {
 public:
  /// Throws kInvalidArgument for channels whose mirror image is not known, and those in the alignment's axes unless the
  /// rest mesh is flat.
  explicit Mirror(const PairData& data);

  /// image: (T C + K, h, w) normalised, or a part of it.
  torch::Tensor input(const torch::Tensor& image, std::uint64_t bits) const;
  /// answer: (C, H, W) normalised. Differentiable.
  torch::Tensor answer(const torch::Tensor& answer, std::uint64_t bits) const;

 private:
  /// y = M x + o for the channels of one frame, at each texel.
  struct Map {
    torch::Tensor matrix, offset;
  };
  std::vector<Map> inputs_, answers_;  ///< by bits
  int window_, constants_;
};

}  // namespace pleat::superres
