// Layers that change an image's size, on float32 images of features, and their gradients.
#pragma once

#include "services/superres/kernels/forward.hpp"

namespace pleat::superres::kernels {

/// One pixel of such a layer. source: floats of the input; target: (channels padded).
void resample_pixel(const Layer& layer, const Geometry& from, const Geometry& to, const float* source, int stride,
                    int channels, int y, int x, float* target);

/// Adds the gradient of a pixel of the output, target (channels), to that of the input, in `source`.
void resample_gradient(const Layer& layer, const Geometry& from, const Geometry& to, float* source, int stride,
                       int channels, int y, int x, const float* target);

}  // namespace pleat::superres::kernels
