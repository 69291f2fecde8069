#include "services/superres/training/sampler.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/base/error.hpp"
#include "common/base/random.hpp"

namespace pleat::superres {
namespace {

/// splitmix64, seeded by several words.
class Random {
 public:
  template <typename... Words>
  explicit Random(Words... words) {
    ((state_ = next() ^ static_cast<std::uint64_t>(words)), ...);
  }
  std::uint64_t next() { return split_mix(state_); }
  /// Below `bound`; its bias of bound / 2^64 does not matter here.
  std::size_t below(std::size_t bound) { return static_cast<std::size_t>(next() % bound); }

 private:
  std::uint64_t state_ = 0;
};

}  // namespace

Sampler::Sampler(const TrainConfig& config, const PairData& data, int remembered)
    : config_(config), data_(data), remembered_(remembered) {
  data.check();
  frames_ = config.losses.kinematic > 0 ? config.losses.frames + 1 : 1;
  if (remembered > 0) {
    check_remembering(config);
    frames_ = config.history.frames;
  }
  scale_ = data.scale();
  const int height = data.height(), width = data.width();
  patch_height_ = config.patch == 0 ? height : std::min(config.patch, height);
  patch_width_ = config.patch == 0 ? width : std::min(config.patch, width);
  for (std::size_t s = 0; s < data.sequences.size(); ++s) {
    const std::size_t length = data.sequences[s].input.size();
    if (data.sequences[s].validation) continue;
    for (std::size_t f = 0; f + static_cast<std::size_t>(frames_) <= length; ++f) windows_.push_back({s, f});
  }
  if (windows_.empty()) {
    throw_invalid_argument("data set: no training sequence has " + std::to_string(frames_) + " frames");
  }
  if (config.mirror) mirror_.emplace(data);
  if (data.constant_channels() > 0) {
    constants_ = torch::tensor(data.constants.values).view({data.constant_channels(), height, width});
  }
  if (config.losses.needs_vertices()) {
    if (data.mesh_read.rest.empty()) throw_invalid_argument("data set: no vertex reads, which losses on vertices need");
    rest_ = torch::tensor(data.mesh_read.rest).view({3, -1});
  }
  const double texels = static_cast<double>(data.training_frames()) * height * width;
  const double step_texels = static_cast<double>(config.batch) * frames_ * patch_height_ * patch_width_;
  steps_ = config.steps_per_epoch > 0 ? config.steps_per_epoch
                                      : std::max(1, static_cast<int>(std::ceil(texels / step_texels)));
}

std::vector<Sampler::Window> Sampler::windows_of(int epoch, int step) const {
  const std::size_t count = windows_.size();
  const auto batch = static_cast<std::size_t>(config_.batch);
  std::vector<std::size_t> order(count);
  std::vector<Window> result;
  std::size_t shuffled_round = count;  // none yet
  for (std::size_t i = static_cast<std::size_t>(step) * batch; result.size() < batch; ++i) {
    const std::size_t round = i / count;
    if (shuffled_round != round || result.empty()) {
      std::iota(order.begin(), order.end(), std::size_t{0});
      Random random(config_.seed, epoch, round, 1);
      for (std::size_t k = count; k > 1; --k) std::swap(order[k - 1], order[random.below(k)]);
      shuffled_round = round;
    }
    result.push_back(windows_[order[i % count]]);
  }
  for (std::size_t k = 0; remembered_ > 0 && k < result.size(); ++k) {
    Random random(config_.seed, epoch, step, k, 3);
    if (unit_interval(random.next()) < config_.history.starts) result[k].first = 0;
  }
  return result;
}

bool Sampler::is_free(int epoch, int step) const {
  Random random(config_.seed, epoch, step, 4);
  return unit_interval(random.next()) < config_.history.share;
}

torch::Tensor Sampler::noise(int epoch, int step, int first, const torch::Tensor& like) const {
  auto result = torch::empty(like.sizes(), torch::kFloat32);
  for (std::int64_t n = 0; n < like.size(0); ++n) {
    Random random(config_.seed, epoch, step, first + n, 5);
    auto row = result[n];
    float* values = row.data_ptr<float>();
    for (std::int64_t i = 0; i < row.numel(); ++i) {
      const double radius = std::sqrt(-2 * std::log(1 - unit_interval(random.next())));
      values[i] = static_cast<float>(radius * std::cos(6.283185307179586 * unit_interval(random.next())));
    }
  }
  return result.to(like.device());
}

void Sampler::read_before(const Window& window, Batch& batch, std::int64_t n) const {
  const PairSequence& sequence = data_.sequences[window.sequence];
  for (int k = 0; k < remembered_; ++k) {
    const auto back = static_cast<std::size_t>(remembered_ - k);
    if (back > window.first) continue;
    auto answer = batch.before[n][k];
    sequence.answer.read(window.first - back, 0, 0, scale_ * data_.height(), scale_ * data_.width(),
                         answer.data_ptr<float>());
    batch.known[n][k] = 1.0F;
  }
}

std::string Sampler::describe(int epoch, int step) const {
  std::string text;
  for (const Window& window : windows_of(epoch, step)) {
    text += (text.empty() ? "" : ", ") + data_.sequences[window.sequence].name + ":" + std::to_string(window.first);
  }
  return text;
}

Sampler::Cut Sampler::cut_of(int epoch, int step, int window) const {
  Random random(config_.seed, epoch, step, window, 2);
  Cut cut{};
  cut.row = static_cast<int>(random.below(static_cast<std::size_t>(data_.height() - patch_height_) + 1));
  cut.column = static_cast<int>(random.below(static_cast<std::size_t>(data_.width() - patch_width_) + 1));
  cut.mirror = config_.mirror ? random.next() : 0;
  return cut;
}

double Sampler::valid_texels(int epoch, int step) const {
  const std::size_t stride = static_cast<std::size_t>(scale_) * static_cast<std::size_t>(data_.width());
  double count = 0;
  for (int window = 0; window < config_.batch; ++window) {
    const Cut cut = cut_of(epoch, step, window);
    for (int r = scale_ * cut.row; r < scale_ * (cut.row + patch_height_); ++r) {
      const auto row = data_.answer_mask.begin() + static_cast<std::ptrdiff_t>(static_cast<std::size_t>(r) * stride);
      count += static_cast<double>(std::count_if(row + scale_ * cut.column, row + scale_ * (cut.column + patch_width_),
                                                 [](std::uint8_t m) { return m != 0; }));
    }
  }
  return count * frames_;
}

void Sampler::read_input(const PairSequence& sequence, std::size_t frame, const Cut& cut, torch::Tensor input) const {
  const int h = patch_height_, w = patch_width_;
  sequence.input.read(frame, cut.row, cut.column, h, w, input.data_ptr<float>());
  if (constants_.defined()) {
    input.slice(0, sequence.input.channels())
        .copy_(constants_.slice(1, cut.row, cut.row + h).slice(2, cut.column, cut.column + w));
  }
}

void Sampler::read_lead(const Window& window, std::size_t frames, Batch& batch, std::int64_t n) const {
  const auto lead = static_cast<std::size_t>(config_.history.lead);
  for (std::size_t l = 0; l < frames; ++l) {
    const auto place = static_cast<std::int64_t>(lead - frames + l);
    read_input(data_.sequences[window.sequence], window.first - frames + l, {}, batch.lead[n][place]);
    batch.lead_known[n][place] = 1.0F;
  }
}

void Sampler::read_image(const PairSequence& sequence, std::size_t frame, const Cut& cut, Batch& batch,
                         std::int64_t n) const {
  const int h = patch_height_, w = patch_width_;
  auto input = batch.input[n], answer = batch.answer[n];
  read_input(sequence, frame, cut, input);
  if (mirror_) input.copy_(mirror_->input(input.clone(), cut.mirror));
  sequence.answer.read(frame, scale_ * cut.row, scale_ * cut.column, scale_ * h, scale_ * w, answer.data_ptr<float>());
  float* m = batch.mask[n].data_ptr<float>();
  for (int r = scale_ * cut.row; r < scale_ * (cut.row + h); ++r) {
    const auto* source = data_.answer_mask.data() + r * scale_ * data_.width() + scale_ * cut.column;
    for (int c = 0; c < scale_ * w; ++c) *m++ = source[c] != 0 ? 1.0F : 0.0F;
  }
  std::copy(sequence.rotations[frame].begin(), sequence.rotations[frame].end(), batch.rotations[n].data_ptr<float>());
}

void Sampler::read_vertices(std::size_t sequence, std::size_t frame, Batch& batch, std::int64_t n) const {
  if (!data_.geometry) {
    batch.vertex_base[n].copy_(rest_);
    return;
  }
  Positions base;
  data_.geometry->base(sequence, frame, base);
  batch.vertex_base[n].copy_(torch::from_blob(base.data(), {base.rows(), 3}, torch::kFloat32).t());
  if (!batch.axes.defined()) return;
  Tensor axes;
  data_.geometry->axes(sequence, frame, axes);
  batch.axes[n].copy_(torch::from_blob(axes.values.data(), batch.axes[n].sizes(), torch::kFloat32));
}

Batch Sampler::batch(int epoch, int step, int first_window, int last_window) const {
  const auto windows = windows_of(epoch, step);
  const auto images = static_cast<std::int64_t>(last_window - first_window) * frames_;
  const PairSequence& any = data_.sequences.front();
  const int h = patch_height_, w = patch_width_;
  Batch batch;
  batch.frames = frames_;
  batch.input = torch::empty({images, any.input.channels() + data_.constant_channels(), h, w});
  batch.answer = torch::empty({images, any.answer.channels(), scale_ * h, scale_ * w});
  batch.mask = torch::empty({images, 1, scale_ * h, scale_ * w});
  batch.rotations = torch::empty({images, 3, 3});
  if (rest_.defined()) {
    batch.vertex_base = torch::empty({images, 3, rest_.size(1)});
    if (data_.geometry && data_.has_axes()) batch.axes = torch::empty({images, 3 * 3, h, w});
  }
  if (remembered_ > 0) {
    const std::int64_t count = last_window - first_window;
    batch.before = torch::zeros({count, remembered_, any.answer.channels(), scale_ * h, scale_ * w});
    batch.known = torch::zeros({count, remembered_});
    if (config_.history.lead > 0 && is_free(epoch, step)) {
      auto shape = batch.input.sizes().vec();
      shape[0] = config_.history.lead;
      shape.insert(shape.begin(), count);
      batch.lead = torch::zeros(shape);
      batch.lead_known = torch::zeros({count, config_.history.lead});
    }
  }
  for (int index = first_window; index < last_window; ++index) {
    const Window& window = windows[static_cast<std::size_t>(index)];
    if (remembered_ > 0) {
      const std::size_t lead =
          batch.lead.defined() ? std::min(window.first, static_cast<std::size_t>(config_.history.lead)) : 0;
      read_before({window.sequence, window.first - lead}, batch, index - first_window);
      read_lead(window, lead, batch, index - first_window);
    }
    const Cut cut = cut_of(epoch, step, index);
    for (int f = 0; f < frames_; ++f) {
      const auto n = static_cast<std::int64_t>(batch.mirrors.size());
      const std::size_t frame = window.first + static_cast<std::size_t>(f);
      batch.mirrors.push_back(cut.mirror);
      read_image(data_.sequences[window.sequence], frame, cut, batch, n);
      if (rest_.defined()) read_vertices(window.sequence, frame, batch, n);
    }
  }
  return batch;
}

torch::Tensor Sampler::unmirrored(const torch::Tensor& answers, const Batch& batch) const {
  if (!mirror_) return answers;
  std::vector<torch::Tensor> parts;
  for (std::size_t n = 0; n < batch.mirrors.size(); ++n) {
    parts.push_back(mirror_->answer(answers[static_cast<std::int64_t>(n)], batch.mirrors[n]));
  }
  return torch::stack(parts);
}

}  // namespace pleat::superres
