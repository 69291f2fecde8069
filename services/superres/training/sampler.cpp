#include "services/superres/training/sampler.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
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

using Matrix = std::array<std::array<double, 3>, 3>;

Matrix reflection(const std::array<float, 3>& normal) {
  double length = 0;
  for (const float n : normal) length += static_cast<double>(n) * n;
  Matrix m{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) m[i][j] = (i == j ? 1.0 : 0.0) - 2.0 * normal[i] * normal[j] / length;
  }
  return m;
}

Matrix multiply(const Matrix& a, const Matrix& b) {
  Matrix m{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t k = 0; k < 3; ++k) m[i][j] += a[i][k] * b[k][j];
    }
  }
  return m;
}

/// How a mirrored copy of a flat sheet is made: images reversed along u or v, vectors reflected, normals turned when
/// the reflection goes across the sheet (then du x dv keeps its sense while space does not).
struct Mirror {
  bool reverse_u = false, reverse_v = false, across = false;
  Matrix matrix{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  bool any() const { return reverse_u || reverse_v || across; }
};

Mirror make_mirror(std::uint64_t bits, const std::vector<std::array<float, 3>>& axes) {
  Mirror mirror;
  mirror.reverse_u = (bits & 1) != 0, mirror.reverse_v = (bits & 2) != 0, mirror.across = (bits & 4) != 0;
  const auto& u = axes[0];
  const auto& v = axes[1];
  const std::array<float, 3> normal{u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
  if (mirror.reverse_u) mirror.matrix = multiply(reflection(u), mirror.matrix);
  if (mirror.reverse_v) mirror.matrix = multiply(reflection(v), mirror.matrix);
  if (mirror.across) mirror.matrix = multiply(reflection(normal), mirror.matrix);
  return mirror;
}

torch::Tensor to_tensor(const Matrix& m) {
  const auto result = torch::empty({3, 3});
  for (std::int64_t i = 0; i < 9; ++i) {
    result[i / 3][i % 3] = m[static_cast<std::size_t>(i / 3)][static_cast<std::size_t>(i % 3)];
  }
  return result;
}

torch::Tensor mirror_image(const torch::Tensor& image, const Mirror& mirror, const Normalization& normalization) {
  torch::Tensor result = image;
  if (mirror.reverse_u) result = result.flip({2});
  if (mirror.reverse_v) result = result.flip({1});
  // t' = (S (t range + minimum) - minimum) / range, with S the reflection of each of the three vectors.
  const auto scale = torch::zeros({kChannels, kChannels}), offset = torch::zeros({kChannels, 1, 1});
  auto s = scale.accessor<float, 2>();
  auto o = offset.accessor<float, 3>();
  for (std::size_t c = 0; c < kChannels; ++c) {
    const std::size_t vector = c / 3;
    const double sign = vector == 1 && mirror.across ? -1.0 : 1.0;
    const double range = static_cast<double>(normalization.maximum[c]) - normalization.minimum[c];
    double shift = -normalization.minimum[c];
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t from = 3 * vector + k;
      const double factor = sign * mirror.matrix[c % 3][k];
      const double from_range = static_cast<double>(normalization.maximum[from]) - normalization.minimum[from];
      s[static_cast<std::int64_t>(c)][static_cast<std::int64_t>(from)] =
          static_cast<float>(factor * from_range / range);
      shift += factor * normalization.minimum[from];
    }
    o[static_cast<std::int64_t>(c)][0][0] = static_cast<float>(shift / range);
  }
  return torch::einsum("ij,jhw->ihw", {scale, result}) + offset;
}

}  // namespace

Sampler::Sampler(const TrainConfig& config, const PairData& data) : config_(config), data_(data) {
  data.check();
  frames_ = config.losses.kinematic > 0 ? config.losses.frames + 1 : 1;
  const int height = data.coarse_height(), width = data.coarse_width();
  patch_height_ = config.patch == 0 ? height : std::min(config.patch, height);
  patch_width_ = config.patch == 0 ? width : std::min(config.patch, width);
  for (std::size_t s = 0; s < data.sequences.size(); ++s) {
    const std::size_t length = data.sequences[s].coarse.size();
    if (data.sequences[s].validation) continue;
    for (std::size_t f = 0; f + static_cast<std::size_t>(frames_) <= length; ++f) windows_.push_back({s, f});
  }
  if (windows_.empty()) {
    throw_invalid_argument("data set: no training sequence has " + std::to_string(frames_) + " frames");
  }
  if (config.mirror && data.sheet_axes.size() != 2) {
    throw_invalid_argument("key 'mirror': the rest mesh is not flat, its mirror image is another garment");
  }
  if (config.architecture.residual == "mesh") {
    if (data.mesh_base.structure.size() != static_cast<std::size_t>(kStructureChannels * height * width)) {
      throw_invalid_argument("data set: no mesh base, which residual 'mesh' needs");
    }
    mesh_ = std::make_shared<cpu::UpsampledMesh>(data.mesh_base, height, width);
    // As a fine image, whose parts and mirror images are easy to take.
    structure_ = torch::pixel_shuffle(
        torch::tensor(data.mesh_base.structure).view({1, kStructureChannels, height, width}), kScale);
  }
  if (config.losses.needs_vertices()) {
    const MeshRead& read = data.mesh_read;
    if (read.rest.empty()) throw_invalid_argument("data set: no vertex reads, which losses on vertices need");
    vertex_rest_ = torch::tensor(read.rest).view({3, -1});
    for (int bits = 0; bits < 4; ++bits) {
      std::vector<std::int64_t> texels = read.texels;
      const std::int64_t w = kScale * width, h = kScale * height;
      for (std::int64_t& t : texels) {
        const std::int64_t row = t / w, column = t % w;
        t = ((bits & 2) != 0 ? h - 1 - row : row) * w + ((bits & 1) != 0 ? w - 1 - column : column);
      }
      vertex_texels_.push_back(torch::tensor(texels, torch::kInt64));
    }
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
  return result;
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
  cut.row = static_cast<int>(random.below(static_cast<std::size_t>(data_.coarse_height() - patch_height_) + 1));
  cut.column = static_cast<int>(random.below(static_cast<std::size_t>(data_.coarse_width() - patch_width_) + 1));
  cut.mirror = config_.mirror ? random.next() : 0;
  return cut;
}

double Sampler::valid_texels(int epoch, int step) const {
  const std::size_t stride = static_cast<std::size_t>(kScale) * static_cast<std::size_t>(data_.coarse_width());
  double count = 0;
  for (int window = 0; window < config_.batch; ++window) {
    const Cut cut = cut_of(epoch, step, window);
    for (int r = kScale * cut.row; r < kScale * (cut.row + patch_height_); ++r) {
      const auto row = data_.fine_mask.begin() + static_cast<std::ptrdiff_t>(static_cast<std::size_t>(r) * stride);
      count += static_cast<double>(std::count_if(row + kScale * cut.column, row + kScale * (cut.column + patch_width_),
                                                 [](std::uint8_t m) { return m != 0; }));
    }
  }
  return count * frames_;
}

Batch Sampler::batch(int epoch, int step, int first_window, int last_window) const {
  const auto windows = windows_of(epoch, step);
  const auto images = static_cast<std::int64_t>(last_window - first_window) * frames_;
  const int h = patch_height_, w = patch_width_, fine_h = kScale * h, fine_w = kScale * w;
  Batch batch;
  batch.frames = frames_;
  batch.coarse = torch::empty({images, kChannels, h, w});
  batch.fine = torch::empty({images, kChannels, fine_h, fine_w});
  batch.mask = torch::empty({images, 1, fine_h, fine_w});
  batch.rotations = torch::empty({images, 3, 3});
  const bool mesh = config_.architecture.residual == "mesh";
  if (mesh) {
    batch.base = torch::empty_like(batch.fine);
    batch.structure = torch::empty({images, kStructureChannels, h, w});
  }
  const bool vertices = vertex_rest_.defined();
  if (vertices) {
    batch.vertex_texels = torch::empty({images, vertex_texels_[0].size(0)}, torch::kInt64);
    batch.vertex_rest = torch::empty({images, 3, vertex_rest_.size(1)});
  }
  std::int64_t n = 0;
  for (int index = first_window; index < last_window; ++index) {
    const Window& window = windows[static_cast<std::size_t>(index)];
    const PairSequence& sequence = data_.sequences[window.sequence];
    const auto [row, column, bits] = cut_of(epoch, step, index);
    const Mirror mirror = config_.mirror ? make_mirror(bits, data_.sheet_axes) : Mirror{};
    for (int f = 0; f < frames_; ++f, ++n) {
      const std::size_t frame = window.first + static_cast<std::size_t>(f);
      auto coarse = batch.coarse[n], fine = batch.fine[n], mask = batch.mask[n];
      sequence.coarse.read(frame, row, column, h, w, coarse.data_ptr<float>());
      sequence.fine.read(frame, kScale * row, kScale * column, fine_h, fine_w, fine.data_ptr<float>());
      float* m = mask.data_ptr<float>();
      for (int r = 0; r < fine_h; ++r) {
        const auto* source =
            data_.fine_mask.data() + (kScale * row + r) * kScale * data_.coarse_width() + kScale * column;
        for (int c = 0; c < fine_w; ++c) *m++ = source[c] != 0 ? 1.0F : 0.0F;
      }
      float* rotation = batch.rotations[n].data_ptr<float>();
      const auto& own = sequence.rotations[frame];
      for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = 0; j < 3; ++j) {
          double sum = 0;
          for (std::size_t k = 0; k < 3; ++k) sum += mirror.matrix[i][k] * own[3 * k + j];
          rotation[3 * i + j] = static_cast<float>(sum);
        }
      }
      if (vertices) {
        const auto place = static_cast<std::size_t>((mirror.reverse_u ? 1 : 0) + (mirror.reverse_v ? 2 : 0));
        batch.vertex_texels[n].copy_(vertex_texels_[place]);
        batch.vertex_rest[n].copy_(torch::matmul(to_tensor(mirror.matrix), vertex_rest_));
      }
      if (mesh) {
        const int height = data_.coarse_height(), width = data_.coarse_width();
        const auto whole = torch::empty({kChannels, height, width});
        const auto upsampled = torch::empty({kChannels, kScale * height, kScale * width});
        sequence.coarse.read(frame, 0, 0, height, width, whole.data_ptr<float>());
        mesh_->image({whole.data_ptr<float>(), height, width}, upsampled.data_ptr<float>());
        auto base =
            upsampled.slice(1, kScale * row, kScale * row + fine_h).slice(2, kScale * column, kScale * column + fine_w);
        if (mirror.any()) base = mirror_image(base, mirror, data_.normalization);
        batch.base[n].copy_(base);
        auto structure = structure_.slice(2, kScale * row, kScale * row + fine_h)
                             .slice(3, kScale * column, kScale * column + fine_w);
        if (mirror.reverse_u) structure = structure.flip({3});
        if (mirror.reverse_v) structure = structure.flip({2});
        batch.structure[n].copy_(torch::pixel_unshuffle(structure, kScale)[0]);
      }
      if (mirror.any()) {
        coarse.copy_(mirror_image(coarse.clone(), mirror, data_.normalization));
        fine.copy_(mirror_image(fine.clone(), mirror, data_.normalization));
        if (mirror.reverse_u) mask.copy_(mask.flip({2}).clone());
        if (mirror.reverse_v) mask.copy_(mask.flip({1}).clone());
      }
    }
  }
  return batch;
}

}  // namespace pleat::superres
