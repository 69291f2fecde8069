#include "services/superres/training/mirror.hpp"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <string>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

constexpr std::uint64_t kVariants = 8;

using Matrix = Eigen::Matrix3d;

Matrix reflection(const Eigen::Vector3d& normal) {
  return Matrix::Identity() - 2 * normal * normal.transpose() / normal.squaredNorm();
}

/// What the reflections do to vectors in the alignment's axes.
Matrix reflection_of(std::uint64_t bits, const std::vector<std::array<float, 3>>& axes) {
  const auto vector = [](const std::array<float, 3>& a) { return Eigen::Vector3d(a[0], a[1], a[2]); };
  const Eigen::Vector3d u = vector(axes[0]), v = vector(axes[1]);
  Matrix matrix = Matrix::Identity();
  if ((bits & 1) != 0) matrix = reflection(u) * matrix;
  if ((bits & 2) != 0) matrix = reflection(v) * matrix;
  if ((bits & 4) != 0) matrix = reflection(u.cross(v)) * matrix;
  return matrix;
}

bool has(const std::string& text, const char* part) { return text.find(part) != std::string::npos; }

/// The sign of a value in the cloth's own axes (services/conversion/geometry_image/cloth_axes.hpp): a difference along
/// u changes it with u's reversal, and so does the axis itself, which is that difference; the axis across is that of v,
/// and the third one changes with the reflection across the sheet. 0 for another channel.
double sign_of(const std::string& name, std::uint64_t bits) {
  const bool u = (bits & 1) != 0, v = (bits & 2) != 0, across = (bits & 4) != 0;
  bool odd = false;
  if (has(name, "_along")) {
    odd = u;
  } else if (has(name, "_across")) {
    odd = v;
  } else if (has(name, "_normal")) {
    odd = across;
  } else if (!has(name, "strain_")) {
    return 0;
  }
  if (has(name, "_uv")) odd ^= u != v;
  // The mesh's normal keeps to its own side of the sheet.
  if (name.rfind("normal_", 0) == 0) odd ^= across;
  return odd ? -1 : 1;
}

/// The mirror's matrix for physical values of the channels.
Eigen::MatrixXd physical_matrix(const std::vector<std::string>& channels, std::uint64_t bits,
                                const std::vector<std::array<float, 3>>& axes) {
  const auto count = static_cast<Eigen::Index>(channels.size());
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(count, count);
  for (Eigen::Index c = 0; c < count; ++c) {
    const std::string& name = channels[static_cast<std::size_t>(c)];
    if (const double sign = sign_of(name, bits); sign != 0) {
      matrix(c, c) = sign;
      continue;
    }
    const bool vector =
        name.ends_with("_x") && c + 2 < count && channels[static_cast<std::size_t>(c + 2)].ends_with("_z");
    if (!vector || name.rfind("position", 0) == 0) {
      throw_invalid_argument("key 'mirror': what channel '" + name + "' is in a mirror is not known");
    }
    if (axes.size() != 2) {
      throw_invalid_argument("key 'mirror': the rest mesh is not flat, its mirror image is another garment");
    }
    const bool turned = name.rfind("normal", 0) == 0 && (bits & 4) != 0;
    matrix.block<3, 3>(c, c) = (turned ? -1.0 : 1.0) * reflection_of(bits, axes);
    c += 2;
  }
  return matrix;
}

torch::Tensor flip(torch::Tensor image, std::uint64_t bits) {
  if ((bits & 1) != 0) image = image.flip({2});
  if ((bits & 2) != 0) image = image.flip({1});
  return image;
}

}  // namespace

Mirror::Mirror(const PairData& data) : window_(data.representation.window), constants_(data.constant_channels()) {
  const auto map_of = [&](const std::vector<std::string>& channels, const ChannelRanges& ranges, std::uint64_t bits) {
    // x' = (P (x s + b) - b) / s
    const Eigen::MatrixXd physical = physical_matrix(channels, bits, data.meshes.front().sheet_axes);
    const auto count = static_cast<std::int64_t>(channels.size());
    Map map{torch::zeros({count, count}), torch::zeros({count, 1, 1})};
    auto matrix = map.matrix.accessor<float, 2>();
    auto offset = map.offset.accessor<float, 3>();
    for (std::int64_t i = 0; i < count; ++i) {
      const auto at = [](const std::vector<float>& values, std::int64_t k) {
        return static_cast<double>(values[static_cast<std::size_t>(k)]);
      };
      const double scale = at(ranges.scale, i);
      if (scale == 0) continue;
      double shift = -at(ranges.offset, i);
      for (std::int64_t k = 0; k < count; ++k) {
        matrix[i][k] = static_cast<float>(physical(i, k) * at(ranges.scale, k) / scale);
        shift += physical(i, k) * at(ranges.offset, k);
      }
      offset[i][0][0] = static_cast<float>(shift / scale);
    }
    return map;
  };
  for (std::uint64_t bits = 0; bits < kVariants; ++bits) {
    inputs_.push_back(map_of(data.input_channels, data.input_ranges, bits));
    answers_.push_back(map_of(data.answer_channels, data.output_ranges, bits));
  }
}

torch::Tensor Mirror::input(const torch::Tensor& image, std::uint64_t bits) const {
  bits %= kVariants;
  if (bits == 0) return image;
  const Map& map = inputs_[bits];
  const std::int64_t channels = map.matrix.size(0), frames = window_ * channels;
  const auto turned = flip(image, bits);
  std::vector<torch::Tensor> parts;
  for (int t = 0; t < window_; ++t) {
    parts.push_back(torch::einsum("ij,jhw->ihw", {map.matrix, turned.slice(0, t * channels, (t + 1) * channels)}) +
                    map.offset);
  }
  if (constants_ > 0) {
    // A block of values of each texel's own, finer texels, which turn round with it.
    const auto side = static_cast<std::int64_t>(std::lround(std::sqrt(constants_ / 2.0)));
    const auto fine = torch::pixel_shuffle(image.slice(0, frames).unsqueeze(0), side)[0];
    parts.push_back(torch::pixel_unshuffle(flip(fine, bits).unsqueeze(0), side)[0]);
  }
  return torch::cat(parts, 0);
}

torch::Tensor Mirror::answer(const torch::Tensor& answer, std::uint64_t bits) const {
  bits %= kVariants;
  if (bits == 0) return answer;
  const Map& map = answers_[bits];
  const auto turned = flip(answer, bits);
  const auto matrix = map.matrix.to(turned.device());
  return torch::einsum("ij,jhw->ihw", {matrix, turned}) + map.offset.to(turned.device());
}

}  // namespace pleat::superres
