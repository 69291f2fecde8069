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
  double texels = 0, patch_texels = 0;  // of all training frames, and of their patches
  const auto side = [&](int whole) { return config.patch == 0 ? whole : std::min(config.patch, whole); };
  for (std::size_t s = 0; s < data.sequences.size(); ++s) {
    const std::size_t length = data.sequences[s].input.size();
    if (data.sequences[s].validation) continue;
    const int height = data.sequences[s].input.height(), width = data.sequences[s].input.width();
    texels += static_cast<double>(length) * height * width;
    patch_texels += static_cast<double>(length) * side(height) * side(width);
    for (std::size_t f = 0; f + static_cast<std::size_t>(frames_) <= length; ++f) windows_.push_back({s, f});
  }
  if (windows_.empty()) {
    throw_invalid_argument("data set: no training sequence has " + std::to_string(frames_) + " frames");
  }
  if (config.mirror) mirror_.emplace(data);
  for (const PairMesh& mesh : data.meshes) {
    if (data.constant_channels() > 0) {
      constants_.push_back(torch::tensor(mesh.constants.values).view(mesh.constants.shape));
    }
    if (!config.losses.needs_vertices()) continue;
    if (mesh.mesh_read.rest.empty()) throw_invalid_argument("data set: no vertex reads, which losses on vertices need");
    rest_.push_back(torch::tensor(mesh.mesh_read.rest).view({3, -1}));
  }
  // Of the mean patch.
  const double step_texels =
      static_cast<double>(config.batch) * frames_ * patch_texels / static_cast<double>(data.training_frames());
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
  const auto mesh_of = [&](const Window& window) { return data_.sequences[window.sequence].mesh; };
  std::stable_sort(result.begin(), result.end(),
                   [&](const Window& a, const Window& b) { return mesh_of(a) < mesh_of(b); });
  return result;
}

std::vector<int> Sampler::passes(int epoch, int step, int first, int last, int most) const {
  const auto windows = windows_of(epoch, step);
  const auto mesh_of = [&](int index) {
    return data_.sequences[windows[static_cast<std::size_t>(index)].sequence].mesh;
  };
  std::vector<int> ends;
  for (int begin = first, at = first; at < last; ++at) {
    if (at + 1 < last && at + 1 - begin < most && mesh_of(at + 1) == mesh_of(begin)) continue;
    ends.push_back(at + 1);
    begin = at + 1;
  }
  return ends;
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
    sequence.answer.read(window.first - back, 0, 0, sequence.answer.height(), sequence.answer.width(),
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

Sampler::Cut Sampler::cut_of(int epoch, int step, int index, const Window& window) const {
  Random random(config_.seed, epoch, step, index, 2);
  const ImageStore& input = data_.sequences[window.sequence].input;
  const auto side = [&](int whole) { return config_.patch == 0 ? whole : std::min(config_.patch, whole); };
  Cut cut{};
  cut.height = side(input.height()), cut.width = side(input.width());
  cut.row = static_cast<int>(random.below(static_cast<std::size_t>(input.height() - cut.height) + 1));
  cut.column = static_cast<int>(random.below(static_cast<std::size_t>(input.width() - cut.width) + 1));
  cut.mirror = config_.mirror ? random.next() : 0;
  return cut;
}

double Sampler::valid_texels(int epoch, int step) const {
  double count = 0;
  const auto windows = windows_of(epoch, step);
  for (int index = 0; index < config_.batch; ++index) {
    const Window& window = windows[static_cast<std::size_t>(index)];
    const PairSequence& sequence = data_.sequences[window.sequence];
    const auto& mask = data_.mesh_of(sequence).answer_mask;
    const auto stride = static_cast<std::size_t>(sequence.answer.width());
    const Cut cut = cut_of(epoch, step, index, window);
    for (int r = scale_ * cut.row; r < scale_ * (cut.row + cut.height); ++r) {
      const auto row = mask.begin() + static_cast<std::ptrdiff_t>(static_cast<std::size_t>(r) * stride);
      count += static_cast<double>(std::count_if(row + scale_ * cut.column, row + scale_ * (cut.column + cut.width),
                                                 [](std::uint8_t m) { return m != 0; }));
    }
  }
  return count * frames_;
}

void Sampler::read_input(const PairSequence& sequence, std::size_t frame, const Cut& cut, torch::Tensor input) const {
  const int h = cut.height, w = cut.width;
  sequence.input.read(frame, cut.row, cut.column, h, w, input.data_ptr<float>());
  if (!constants_.empty()) {
    const torch::Tensor& constants = constants_[sequence.mesh];
    input.slice(0, sequence.input.channels())
        .copy_(constants.slice(1, cut.row, cut.row + h).slice(2, cut.column, cut.column + w));
  }
}

void Sampler::read_lead(const Window& window, std::size_t frames, Batch& batch, std::int64_t n) const {
  const auto lead = static_cast<std::size_t>(config_.history.lead);
  for (std::size_t l = 0; l < frames; ++l) {
    const auto place = static_cast<std::int64_t>(lead - frames + l);
    const PairSequence& sequence = data_.sequences[window.sequence];
    const Cut whole{0, 0, sequence.input.height(), sequence.input.width(), 0};
    read_input(sequence, window.first - frames + l, whole, batch.lead[n][place]);
    batch.lead_known[n][place] = 1.0F;
  }
}

void Sampler::read_image(const PairSequence& sequence, std::size_t frame, const Cut& cut, Batch& batch,
                         std::int64_t n) const {
  const int h = cut.height, w = cut.width;
  auto input = batch.input[n], answer = batch.answer[n];
  read_input(sequence, frame, cut, input);
  if (mirror_) input.copy_(mirror_->input(input.clone(), cut.mirror));
  sequence.answer.read(frame, scale_ * cut.row, scale_ * cut.column, scale_ * h, scale_ * w, answer.data_ptr<float>());
  const auto& mask = data_.mesh_of(sequence).answer_mask;
  float* m = batch.mask[n].data_ptr<float>();
  for (int r = scale_ * cut.row; r < scale_ * (cut.row + h); ++r) {
    const auto* source = mask.data() + r * sequence.answer.width() + scale_ * cut.column;
    for (int c = 0; c < scale_ * w; ++c) *m++ = source[c] != 0 ? 1.0F : 0.0F;
  }
  std::copy(sequence.rotations[frame].begin(), sequence.rotations[frame].end(), batch.rotations[n].data_ptr<float>());
}

void Sampler::read_vertices(std::size_t sequence, std::size_t frame, Batch& batch, std::int64_t n) const {
  if (!data_.geometry) {
    batch.vertex_base[n].copy_(rest_[batch.mesh]);
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
  const Window& leading = windows[static_cast<std::size_t>(first_window)];
  const PairSequence& any = data_.sequences[leading.sequence];
  const Cut like = cut_of(epoch, step, first_window, leading);
  const int h = like.height, w = like.width;
  Batch batch;
  batch.mesh = any.mesh;
  batch.frames = frames_;
  batch.input = torch::empty({images, any.input.channels() + data_.constant_channels(), h, w});
  batch.answer = torch::empty({images, any.answer.channels(), scale_ * h, scale_ * w});
  batch.mask = torch::empty({images, 1, scale_ * h, scale_ * w});
  batch.rotations = torch::empty({images, 3, 3});
  if (!rest_.empty()) {
    batch.vertex_base = torch::empty({images, 3, rest_[batch.mesh].size(1)});
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
    if (data_.sequences[window.sequence].mesh != batch.mesh) throw_internal("sampler: a batch of several meshes");
    if (remembered_ > 0) {
      const std::size_t lead =
          batch.lead.defined() ? std::min(window.first, static_cast<std::size_t>(config_.history.lead)) : 0;
      read_before({window.sequence, window.first - lead}, batch, index - first_window);
      read_lead(window, lead, batch, index - first_window);
    }
    const Cut cut = cut_of(epoch, step, index, window);
    for (int f = 0; f < frames_; ++f) {
      const auto n = static_cast<std::int64_t>(batch.mirrors.size());
      const std::size_t frame = window.first + static_cast<std::size_t>(f);
      batch.mirrors.push_back(cut.mirror);
      read_image(data_.sequences[window.sequence], frame, cut, batch, n);
      if (!rest_.empty()) read_vertices(window.sequence, frame, batch, n);
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
