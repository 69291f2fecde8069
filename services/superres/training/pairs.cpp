#include "services/superres/training/pairs.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

constexpr float kSteps = 65536;

}  // namespace

void ImageStore::append(std::span<const float> image) {
  if (image.size() != image_values() || mapped_) throw_internal("image store: image of another size, or not its own");
  if (fixed_point_.used()) {
    const auto [low, span] = fixed_point_;
    std::transform(image.begin(), image.end(), std::back_inserter(fixed_), [&](float value) {
      return static_cast<std::uint16_t>(std::clamp(std::nearbyint((value - low) * (kSteps / span)), 0.0F, kSteps - 1));
    });
  } else {
    float_.insert(float_.end(), image.begin(), image.end());
  }
  ++count_;
}

const void* ImageStore::data() const {
  if (mapped_) return mapped_.get();
  if (fixed_point_.used()) return fixed_.data();
  return float_.data();
}

void ImageStore::read(std::size_t index, int row, int column, int height, int width, float* target) const {
  const auto stride = static_cast<std::size_t>(width_), channels = static_cast<std::size_t>(channels_);
  const std::size_t plane = stride * static_cast<std::size_t>(height_);
  const auto* fixed = static_cast<const std::uint16_t*>(data());
  const auto* exact = static_cast<const float*>(data());
  const float step = fixed_point_.span / kSteps;
  for (std::size_t c = 0; c < channels; ++c) {
    for (int r = 0; r < height; ++r) {
      const std::size_t first = (index * channels + c) * plane + static_cast<std::size_t>(row + r) * stride +
                                static_cast<std::size_t>(column);
      const std::size_t last = first + static_cast<std::size_t>(width);
      if (fixed_point_.used()) {
        for (std::size_t i = first; i < last; ++i) *target++ = static_cast<float>(fixed[i]) * step + fixed_point_.low;
      } else {
        target = std::copy(exact + first, exact + last, target);
      }
    }
  }
}

bool PairData::has_axes() const { return conversion::answer_form(representation).own_axes; }

bool PairData::detail() const { return conversion::answer_form(representation).detail; }

std::size_t PairData::training_frames() const {
  std::size_t frames = 0;
  for (const auto& sequence : sequences) frames += sequence.validation ? 0 : sequence.input.size();
  return frames;
}

namespace {

void check_mesh(const PairMesh& mesh, const PairSequence& sequence, int constants) {
  const ImageStore &input = sequence.input, &answer = sequence.answer;
  const auto& shape = mesh.constants.shape;
  if ((shape.empty() ? 0 : shape[0]) != constants ||
      (!shape.empty() && (shape[1] != input.height() || shape[2] != input.width()))) {
    throw_invalid_argument("data set: the constants have another size than the images");
  }
  if (mesh.answer_mask.size() != static_cast<std::size_t>(answer.height()) * static_cast<std::size_t>(answer.width())) {
    throw_invalid_argument("data set: the valid mask has another size than the answers");
  }
  if (std::none_of(mesh.answer_mask.begin(), mesh.answer_mask.end(), [](auto m) { return m != 0; })) {
    throw_invalid_argument("data set: no texel of the answers is valid");
  }
}

}  // namespace

void PairData::check() const {
  if (training_frames() == 0) throw_invalid_argument("data set: no training frames");
  const ImageStore &first = sequences.front().input, &answer = sequences.front().answer;
  const int factor = scale();
  std::vector<const PairSequence*> sizes(meshes.size(), nullptr);  // whose images are as large as its mesh's
  for (const auto& s : sequences) {
    if (s.input.size() == 0 || s.input.size() != s.answer.size() || s.input.size() != s.rotations.size()) {
      throw_invalid_argument("data set: sequence " + s.name + " has no frames, or not as many coarse as fine ones");
    }
    if (s.mesh >= meshes.size()) throw_internal("data set: sequence " + s.name + " has no mesh");
    if (sizes[s.mesh] == nullptr) sizes[s.mesh] = &s;
    const ImageStore& like = sizes[s.mesh]->input;
    if (factor < 1 || s.input.channels() != first.channels() || s.answer.channels() != answer.channels() ||
        s.input.height() != like.height() || s.input.width() != like.width() ||
        s.answer.height() != factor * s.input.height() || s.answer.width() != factor * s.input.width()) {
      throw_invalid_argument("data set: sequence " + s.name + " has images of another size");
    }
  }
  const auto frame = static_cast<int>(input_ranges.channels());
  if (first.channels() != frame * representation.window ||
      answer.channels() != static_cast<int>(output_ranges.channels()) ||
      input_channels.size() != input_ranges.channels() || answer_channels.size() != output_ranges.channels()) {
    throw_invalid_argument("data set: images, ranges and names have different numbers of channels");
  }
  for (std::size_t m = 0; m < meshes.size(); ++m) {
    if (sizes[m] != nullptr) check_mesh(meshes[m], *sizes[m], constant_channels());
  }
}

Ports ports_of(const PairData& data) {
  data.check();
  return {.inputs = data.sequences.front().input.channels() + data.constant_channels(),
          .outputs = data.sequences.front().answer.channels(),
          .scale = data.scale(),
          .detail = data.detail(),
          .window = data.representation.window,
          .constants = data.constant_channels(),
          .block = conversion::answer_form(data.representation).block,
          .mesh = data.mesh};
}

}  // namespace pleat::superres
