// Small networks with all their constants, for tests.
#pragma once

#include <torch/torch.h>

#include <cmath>
#include <string>

#include "services/superres/network.hpp"

namespace pleat::superres {

inline constexpr int kMeshHeight = 5, kMeshWidth = 6, kNear = 4;

inline Architecture small(const std::string& upsampling, const std::string& residual, bool conditioned,
                          const std::string& axes = "aligned", const std::string& kind = "mfsr") {
  return {2, 3, 4, 6, upsampling, residual, axes, conditioned, kind};
}

/// A made-up mesh of ten vertices; only its sizes are those of a real one.
inline MeshBase example_base(int height = kMeshHeight, int width = kMeshWidth) {
  const auto texels = static_cast<std::size_t>(height * width), fine = 16 * texels;
  MeshBase base;
  base.vertices = 10;
  for (std::size_t i = 0; i < 10 * kNear; ++i) {
    base.vertex_texels.push_back(static_cast<std::int64_t>(i * 11 % texels));
    base.vertex_weights.push_back(0.3F * std::sin(static_cast<float>(i)));
  }
  for (std::size_t i = 0; i < 3 * fine; ++i) {
    base.corners.push_back(static_cast<std::int64_t>(i * 7 % 10));
    base.weights.push_back(0.2F + 0.1F * static_cast<float>(i % 3));
  }
  for (std::size_t i = 0; i < kStructureChannels * texels; ++i) {
    base.structure.push_back(std::cos(static_cast<float>(i)));
  }
  for (std::size_t i = 0; i < 3 * texels; ++i) {
    const auto columns = static_cast<std::size_t>(width);
    const std::size_t axis = i / texels, row = i % texels / columns, column = i % columns;
    base.rest.push_back(axis == 0   ? 0.1F * static_cast<float>(column)
                        : axis == 2 ? -0.1F * static_cast<float>(row)
                                    : 0);
  }
  return base;
}

inline Normalization example_normalization() {
  Normalization normalization;
  for (std::size_t c = 0; c < kChannels; ++c) {
    normalization.minimum[c] = -0.5F - 0.1F * static_cast<float>(c);
    normalization.maximum[c] = 0.7F + 0.2F * static_cast<float>(c);
  }
  return normalization;
}

/// Values per channel that differ from each other.
inline std::vector<float> channel_ramp(int channels, float first, float step) {
  std::vector<float> values;
  for (int c = 0; c < channels; ++c) values.push_back(first + step * static_cast<float>(c));
  return values;
}

inline Network make_network(const Architecture& architecture, int height = kMeshHeight, int width = kMeshWidth) {
  Network network(architecture, 5);
  network.set_conditioning({channel_ramp(kChannels, 0.4F, 0.01F), channel_ramp(kChannels, 0.5F, 0.1F),
                            channel_ramp(kChannels, 0.2F, 0.1F), channel_ramp(kChannels, 0.3F, 0.1F),
                            channel_ramp(kLocalChannels, -0.1F, 0.02F), channel_ramp(kLocalChannels, 0.5F, 0.1F),
                            channel_ramp(kChannels, 0.3F, 0.1F)});
  network.set_mesh_base(example_base(height, width), example_normalization(), height, width);
  // Heads of a residual network begin at zero: give them values, or they would hide everything before them.
  const torch::NoGradGuard no_grad;
  for (auto [name, value] : network.parameters()) {
    if (name.rfind("head_", 0) == 0) value.copy_(torch::linspace(-0.2, 0.3, value.numel()).view(value.sizes()));
  }
  return network;
}

inline torch::Tensor example_input(std::int64_t batch, std::int64_t height, std::int64_t width) {
  const auto ramp = torch::arange(batch * kChannels * height * width, torch::kFloat32);
  return (0.5 + 0.45 * torch::sin(ramp * 0.37)).view({batch, kChannels, height, width});
}

}  // namespace pleat::superres
