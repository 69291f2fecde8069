#include "services/superres/training/conditioning.hpp"

#include <torch/torch.h>

#include <optional>

#include "services/superres/cpu/texels.hpp"

namespace pleat::superres {
namespace {

constexpr std::size_t kConditioningFrames = 256;

/// Mean and deviation per channel, gathered image by image.
class Statistics {
 public:
  explicit Statistics(int channels) : sum_(torch::zeros({channels}, torch::kFloat64)), squares_(sum_.clone()) {}

  /// values: (1, C, h, w); mask: (1, 1, h, w) of 0 and 1.
  void add(const torch::Tensor& values, const torch::Tensor& mask) {
    const auto weighted = values.to(torch::kFloat64) * mask;
    sum_ += weighted.sum(torch::IntArrayRef{0, 2, 3});
    squares_ += weighted.square().sum(torch::IntArrayRef{0, 2, 3});
    count_ += mask.sum().item<double>();
  }
  std::vector<float> mean() const { return to_vector(sum_ / count_); }
  std::vector<float> deviation() const {
    return to_vector((squares_ / count_ - (sum_ / count_).square()).clamp_min(0).sqrt().clamp_min(1e-6));
  }

 private:
  static std::vector<float> to_vector(const torch::Tensor& t) {
    const auto values = t.to(torch::kFloat32).contiguous();
    return {values.data_ptr<float>(), values.data_ptr<float>() + values.numel()};
  }
  torch::Tensor sum_, squares_;
  double count_ = 0;
};

}  // namespace

Conditioning measure_conditioning(const PairData& data, const Architecture& architecture) {
  const bool local = architecture.axes == "local";
  std::optional<cpu::UpsampledMesh> mesh;
  if (architecture.residual == "mesh") mesh.emplace(data.mesh_base, data.coarse_height(), data.coarse_width());
  const torch::NoGradGuard no_grad;
  const int h = data.coarse_height(), w = data.coarse_width();
  const std::size_t stride = std::max<std::size_t>(1, data.training_frames() / kConditioningFrames);
  const auto all = torch::ones({1, 1, h, w}, torch::kFloat64);
  const auto mask =
      torch::from_blob(const_cast<std::uint8_t*>(data.fine_mask.data()), {1, 1, kScale * h, kScale * w}, torch::kUInt8)
          .to(torch::kFloat64);
  torch::Tensor minimum, range, rest;
  if (local) {
    minimum = torch::tensor(std::vector<float>(data.normalization.minimum.begin(), data.normalization.minimum.end()));
    range = torch::tensor(std::vector<float>(data.normalization.maximum.begin(), data.normalization.maximum.end()));
    minimum = minimum.view({1, kChannels, 1, 1});
    range = range.view({1, kChannels, 1, 1}) - minimum;
    rest = torch::tensor(data.mesh_base.rest).view({1, 3, h, w});
  }
  Statistics input(kChannels), detail(kChannels), output(kChannels), features(kLocalChannels), local_output(kChannels);
  std::size_t index = 0;
  for (const auto& sequence : data.sequences) {
    if (sequence.validation) continue;
    for (std::size_t f = 0; f < sequence.coarse.size(); ++f, ++index) {
      if (index % stride != 0) continue;
      const auto coarse = torch::empty({1, kChannels, h, w}),
                 fine = torch::empty({1, kChannels, kScale * h, kScale * w});
      sequence.coarse.read(f, 0, 0, h, w, coarse.data_ptr<float>());
      sequence.fine.read(f, 0, 0, kScale * h, kScale * w, fine.data_ptr<float>());
      auto base = upsample_bilinear(coarse);
      if (mesh) mesh->image({coarse.data_ptr<float>(), h, w}, base.data_ptr<float>());
      input.add(coarse, all);
      detail.add(local_detail(coarse), all);
      output.add(fine - base, mask);
      if (local) {
        const auto frame = local_frame(coarse, minimum, range, rest);
        features.add(frame.features, all);
        local_output.add(to_local((fine - base) * range, upsample_bilinear(frame.axes)), mask);
      }
    }
  }
  Conditioning result;
  result.input_mean = input.mean(), result.input_deviation = input.deviation();
  result.detail_deviation = detail.deviation();
  result.output_deviation = output.deviation();
  if (local) {
    result.local_mean = features.mean(), result.local_deviation = features.deviation();
    result.local_output = local_output.deviation();
  }
  return result;
}

}  // namespace pleat::superres
