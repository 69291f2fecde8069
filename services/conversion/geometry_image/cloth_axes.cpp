#include "services/conversion/geometry_image/cloth_axes.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <optional>

#include "common/base/simd.hpp"
#include "common/mesh/connectivity.hpp"

namespace pleat::conversion {
namespace {

constexpr float kSmallestLength = 1e-9F;
constexpr float kSmallestStep = 1e-14F;  ///< squared, m^2
constexpr float kSmallestVolume = 1e-3F;
constexpr int kLanes = 8;

struct Vector8 {
  Float8 x, y, z;
};
Vector8 operator+(const Vector8& a, const Vector8& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector8 operator-(const Vector8& a, const Vector8& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vector8 operator*(Float8 s, const Vector8& a) { return {s * a.x, s * a.y, s * a.z}; }
Vector8 operator*(float s, const Vector8& a) { return broadcast8(s) * a; }
Float8 dot(const Vector8& a, const Vector8& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vector8 cross(const Vector8& a, const Vector8& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
Vector8 unit(const Vector8& a) { return (1 / max(sqrt(dot(a, a)), broadcast8(kSmallestLength))) * a; }

/// Positions around eight texels: rows from above to below, columns from left to right.
using Neighbourhood = std::array<std::array<Vector8, 3>, 3>;

/// Differences of positions around eight texels.
struct Steps {
  Vector8 u, v, uu, uv, vv;
};

Steps steps_of(const Neighbourhood& p) {
  const Vector8 &here = p[1][1], &left = p[1][0], &right = p[1][2], &above = p[0][1], &below = p[2][1];
  return {0.5F * (right - left), 0.5F * (below - above), right - 2.0F * here + left,
          0.25F * (p[2][2] - p[2][0] - p[0][2] + p[0][0]), below - 2.0F * here + above};
}

/// positions: the texel's place in three extended planes; row: values from one row to the next, plane: to the next
/// plane.
Steps steps_at(const float* positions, std::size_t row, std::size_t plane) {
  Neighbourhood around;
  for (std::size_t y = 0; y < 3; ++y) {
    for (std::size_t x = 0; x < 3; ++x) {
      const float* p = positions + (y * row + x) - (row + 1);
      around[y][x] = {load_as<Float8>(p), load_as<Float8>(p + plane), load_as<Float8>(p + 2 * plane)};
    }
  }
  return steps_of(around);
}

/// The axes of eight texels.
struct Axes {
  Vector8 first, second, normal;
};
Axes axes_of(const Steps& s) {
  const Vector8 normal = unit(cross(s.u, s.v)), first = unit(s.u);
  return {first, cross(normal, first), normal};
}

using Features = std::array<Float8, kClothChannels>;

/// n, v: normal and velocity at the texels; iu, iv: 1 / squared length of their steps in the rest mesh.
Features features_of(const Steps& s, const Axes& a, const Vector8& n, const Vector8& v, Float8 iu, Float8 iv) {
  const auto strain = [](Float8 squared, Float8 inverse) {
    return select(inverse > 0, squared * inverse - 1, Float8{});
  };
  return {strain(dot(s.u, s.u), iu), strain(dot(s.v, s.v), iv), dot(s.u, s.v) * sqrt(iu * iv),
          dot(s.uu, a.first),        dot(s.uu, a.second),       dot(s.uu, a.normal),
          dot(s.uv, a.first),        dot(s.uv, a.second),       dot(s.uv, a.normal),
          dot(s.vv, a.first),        dot(s.vv, a.second),       dot(s.vv, a.normal),
          dot(n, a.first),           dot(n, a.second),          dot(v, a.first),
          dot(v, a.second),          dot(v, a.normal)};
}

Float8 inverse_square(const Vector8& step) {
  const Float8 squared = dot(step, step);
  return select(squared > broadcast8(kSmallestStep), 1 / squared, Float8{});
}

/// Up to eight values of a dense row.
Float8 load_some(const float* from, int count) {
  if (count >= kLanes) return load_as<Float8>(from);
  Float8 v{};
  for (int i = 0; i < count; ++i) v[i] = from[i];
  return v;
}
void store_some(float* to, const Float8& v, int count) {
  if (count >= kLanes) {
    store_to(to, v);
    return;
  }
  for (int i = 0; i < count; ++i) to[i] = v[i];
}

/// The positions around one texel, in a lane; what is not of its chart continues linearly from the other side.
void gather(const std::array<bool, 9>& of_chart, const float* positions, std::size_t row, std::size_t plane, int lane,
            Neighbourhood& around) {
  std::array<Eigen::Vector3f, 9> p;
  const auto at = [&](std::size_t k) {
    const float* from = positions + (k / 3 * row + k % 3) - (row + 1);
    return Eigen::Vector3f(from[0], from[plane], from[2 * plane]);
  };
  p[4] = at(4);
  for (const std::size_t k : {1U, 3U, 5U, 7U}) {
    const std::size_t opposite = 8 - k;
    p[k] = of_chart[k] ? at(k) : of_chart[opposite] ? Eigen::Vector3f(2 * p[4] - at(opposite)) : p[4];
  }
  for (const std::size_t k : {0U, 2U, 6U, 8U}) {
    // Its neighbours beside and above or below the middle, and those across from it.
    const std::size_t beside = 3 + k % 3, above = k / 3 * 3 + 1, opposite = 8 - k;
    const std::size_t across_row = 2 * beside - k, across_column = 2 * above - k;
    if (of_chart[k]) {
      p[k] = at(k);
    } else if (of_chart[across_row]) {
      p[k] = 2 * p[beside] - at(across_row);
    } else if (of_chart[across_column]) {
      p[k] = 2 * p[above] - at(across_column);
    } else if (of_chart[opposite]) {
      p[k] = 2 * p[beside] + 2 * p[above] - 4 * p[4] + at(opposite);
    } else {
      p[k] = p[beside] + p[above] - p[4];
    }
  }
  for (std::size_t k = 0; k < 9; ++k) {
    Vector8& to = around[k / 3][k % 3];
    to.x[lane] = p[k].x(), to.y[lane] = p[k].y(), to.z[lane] = p[k].z();
  }
}

}  // namespace

const std::vector<std::string>& cloth_channel_names() {
  static const std::vector<std::string> names{
      "strain_uu",           "strain_vv",           "strain_uv",           "curvature_uu_along",  "curvature_uu_across",
      "curvature_uu_normal", "curvature_uv_along",  "curvature_uv_across", "curvature_uv_normal", "curvature_vv_along",
      "curvature_vv_across", "curvature_vv_normal", "normal_along",        "normal_across",       "velocity_along",
      "velocity_across",     "velocity_normal"};
  return names;
}

ClothAxes::ClothAxes(const std::vector<float>& rest, int height, int width, const TexelCharts& charts)
    : height_(height), width_(width), row_((static_cast<std::size_t>(width) + 2 + 2 * kLanes - 1) / kLanes * kLanes) {
  // Positions that do not move show the rest mesh.
  rest_.assign(rest.size(), 0.0F);
  Scratch positions(3 * row_ * static_cast<std::size_t>(height + 2));
  extend(rest.data(), positions.data());
  rest_ = rest;
  const std::size_t plane = row_ * static_cast<std::size_t>(height + 2);
  inverse_u_.assign(row_ * static_cast<std::size_t>(height), 0.0F);
  inverse_v_ = inverse_u_;
  for (std::size_t y = 0; y < static_cast<std::size_t>(height); ++y) {
    for (int x = 0; x < width; x += kLanes) {
      const Steps r = steps_at(positions.data() + (y + 1) * row_ + static_cast<std::size_t>(x) + 1, row_, plane);
      store_to(inverse_u_.data() + y * row_ + x, inverse_square(r.u));
      store_to(inverse_v_.data() + y * row_ + x, inverse_square(r.v));
    }
  }
  if (charts.of.empty()) return;
  find_rims(charts.of, positions.data());
  if (!charts.beyond_seams.empty()) take_material_steps(charts);
  for (std::size_t i = 0; i < charts.of.size(); ++i) {
    if (charts.of[i] != kNone) continue;
    const std::size_t shown = charts.shown[i];
    padding_.push_back({i, shown, !between_charts(charts.of, i, charts.of[shown])});
  }
}

/// Where a texel or a neighbour of its chart is beyond a seam.
void ClothAxes::take_material_steps(const TexelCharts& charts) {
  const auto near_seam = [&](std::size_t texel) {
    const auto y = static_cast<int>(texel) / width_, x = static_cast<int>(texel) % width_;
    for (int ny = std::max(y - 1, 0); ny <= std::min(y + 1, height_ - 1); ++ny) {
      for (int nx = std::max(x - 1, 0); nx <= std::min(x + 1, width_ - 1); ++nx) {
        const auto other = static_cast<std::size_t>(ny * width_ + nx);
        if (charts.beyond_seams[other] != 0 && charts.of[other] == charts.of[texel]) return true;
      }
    }
    return false;
  };
  const float u = 1 / (charts.step[0] * charts.step[0]), v = 1 / (charts.step[1] * charts.step[1]);
  for (std::size_t texel = 0; texel < charts.of.size(); ++texel) {
    if (charts.of[texel] == kNone || !near_seam(texel)) continue;
    const std::size_t place =
        texel / static_cast<std::size_t>(width_) * row_ + texel % static_cast<std::size_t>(width_);
    inverse_u_[place] = u;
    inverse_v_[place] = v;
  }
  for (RimTexel& rim : rims_) {
    if (!near_seam(rim.texel)) continue;
    rim.inverse_u = u;
    rim.inverse_v = v;
  }
}

/// Whether a texel has a neighbour of another chart than this one.
bool ClothAxes::between_charts(const std::vector<std::uint32_t>& charts, std::size_t texel, std::uint32_t chart) const {
  const auto y = static_cast<int>(texel) / width_, x = static_cast<int>(texel) % width_;
  for (int ny = std::max(y - 1, 0); ny <= std::min(y + 1, height_ - 1); ++ny) {
    for (int nx = std::max(x - 1, 0); nx <= std::min(x + 1, width_ - 1); ++nx) {
      const std::uint32_t other = charts[static_cast<std::size_t>(ny * width_ + nx)];
      if (other != kNone && other != chart) return true;
    }
  }
  return false;
}

/// Texels at the tips of charts, without a neighbour along u or v, borrow from the nearest texel of their chart that
/// has both.
void ClothAxes::lend(const std::vector<std::uint32_t>& charts) {
  constexpr int kReach = 4;
  std::vector<std::uint8_t> whole(charts.size(), 1);
  for (const RimTexel& rim : rims_) {
    const auto& of = rim.of_chart;
    whole[rim.texel] = (of[3] || of[5]) && (of[1] || of[7]);
  }
  for (const RimTexel& rim : rims_) {
    if (whole[rim.texel] != 0) continue;
    const int y = static_cast<int>(rim.texel) / width_, x = static_cast<int>(rim.texel) % width_;
    std::optional<std::size_t> nearest;
    int least = 2 * kReach * kReach + 1;
    for (int ny = std::max(y - kReach, 0); ny <= std::min(y + kReach, height_ - 1); ++ny) {
      for (int nx = std::max(x - kReach, 0); nx <= std::min(x + kReach, width_ - 1); ++nx) {
        const auto other = static_cast<std::size_t>(ny * width_ + nx);
        const int distance = (ny - y) * (ny - y) + (nx - x) * (nx - x);
        if (charts[other] != charts[rim.texel] || whole[other] == 0 || distance >= least) continue;
        nearest = other;
        least = distance;
      }
    }
    if (nearest) borrowed_.push_back({rim.texel, *nearest});
  }
}

/// positions: of the rest mesh.
void ClothAxes::find_rims(const std::vector<std::uint32_t>& charts, const float* positions) {
  const std::size_t plane = row_ * static_cast<std::size_t>(height_ + 2);
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      const auto texel = static_cast<std::size_t>(y * width_ + x);
      if (charts[texel] == kNone) continue;
      RimTexel rim{texel, static_cast<std::size_t>(y + 1) * row_ + static_cast<std::size_t>(x + 1), {}, 0, 0};
      bool is_rim = false;
      for (int k = 0; k < 9; ++k) {
        const int ny = y + k / 3 - 1, nx = x + k % 3 - 1;
        const bool inside = ny >= 0 && ny < height_ && nx >= 0 && nx < width_;
        const bool same = inside && charts[static_cast<std::size_t>(ny * width_ + nx)] == charts[texel];
        rim.of_chart[static_cast<std::size_t>(k)] = same;
        is_rim = is_rim || (inside && !same);
      }
      if (is_rim) rims_.push_back(rim);
    }
  }
  lend(charts);
  for (RimTexel& rim : rims_) {
    Neighbourhood around{};
    gather(rim.of_chart, positions + rim.place, row_, plane, 0, around);
    const Steps r = steps_of(around);
    rim.inverse_u = inverse_square(r.u)[0];
    rim.inverse_v = inverse_square(r.v)[0];
  }
}

void ClothAxes::extend(const float* displacement, float* positions) const {
  const auto h = static_cast<std::size_t>(height_), w = static_cast<std::size_t>(width_);
  const std::size_t plane = row_ * (h + 2);
  for (std::size_t c = 0; c < 3; ++c) {
    float* out = positions + c * plane;
    for (std::size_t y = 0; y < h; ++y) {
      const float* d = displacement + (c * h + y) * w;
      const float* r = rest_.data() + (c * h + y) * w;
      float* row = out + (y + 1) * row_;
      for (std::size_t x = 0; x < w; ++x) row[x + 1] = d[x] + r[x];
      row[0] = w > 1 ? 2 * row[1] - row[2] : row[1];
      row[w + 1] = w > 1 ? 2 * row[w] - row[w - 1] : row[w];
    }
    const std::size_t inside = h > 1 ? 2 : 1, last = h > 1 ? h - 1 : 1;
    for (std::size_t x = 0; x < w + 2; ++x) {
      out[x] = 2 * out[row_ + x] - out[inside * row_ + x];
      out[(h + 1) * row_ + x] = 2 * out[h * row_ + x] - out[last * row_ + x];
    }
  }
}

void ClothAxes::compute(const float* image, Scratch& scratch, float* features, float* axes) const {
  const auto h = static_cast<std::size_t>(height_), w = static_cast<std::size_t>(width_), size = h * w;
  const std::size_t plane = row_ * (h + 2);
  scratch.resize(3 * plane);
  extend(image + static_cast<std::size_t>(kDisplacementChannel) * size, scratch.data());
  for (std::size_t y = 0; y < h; ++y) {
    for (std::size_t x = 0; x < w; x += kLanes) {
      const int count = static_cast<int>(std::min<std::size_t>(kLanes, w - x));
      const std::size_t texel = y * w + x;
      const Steps s = steps_at(scratch.data() + (y + 1) * row_ + x + 1, row_, plane);
      const Axes a = axes_of(s);
      if (axes != nullptr) {
        const Vector8* const all[] = {&a.first, &a.second, &a.normal};
        for (std::size_t k = 0; k < 3; ++k) {
          store_some(axes + 3 * k * size + texel, all[k]->x, count);
          store_some(axes + (3 * k + 1) * size + texel, all[k]->y, count);
          store_some(axes + (3 * k + 2) * size + texel, all[k]->z, count);
        }
      }
      if (features == nullptr) continue;
      const auto seen = [&](int channel) {
        const float* from = image + static_cast<std::size_t>(channel) * size + texel;
        return Vector8{load_some(from, count), load_some(from + size, count), load_some(from + 2 * size, count)};
      };
      const Features values = features_of(s, a, seen(kNormalChannel), seen(kVelocityChannel),
                                          load_as<Float8>(inverse_u_.data() + y * row_ + x),
                                          load_as<Float8>(inverse_v_.data() + y * row_ + x));
      for (std::size_t c = 0; c < kClothChannels; ++c) store_some(features + c * size + texel, values[c], count);
    }
  }
  if (!rims_.empty()) compute_rims(image, scratch.data(), features, axes);
  for (const Borrowed& borrowed : borrowed_) {
    for (std::size_t c = 0; features != nullptr && c < kClothChannels; ++c) {
      features[c * size + borrowed.texel] = features[c * size + borrowed.from];
    }
    for (std::size_t k = 0; axes != nullptr && k < 9; ++k) {
      axes[k * size + borrowed.texel] = axes[k * size + borrowed.from];
    }
  }
  for (const Padding& pad : padding_) {
    for (std::size_t c = 0; features != nullptr && c < kClothChannels; ++c) features[c * size + pad.texel] = 0;
    for (std::size_t k = 0; axes != nullptr && k < 9; ++k) {
      axes[k * size + pad.texel] = pad.has_axes ? axes[k * size + pad.shown] : 0;
    }
  }
}

void ClothAxes::compute_rims(const float* image, const float* positions, float* features, float* axes) const {
  const std::size_t size = static_cast<std::size_t>(height_) * static_cast<std::size_t>(width_);
  const std::size_t plane = row_ * static_cast<std::size_t>(height_ + 2);
  for (std::size_t begin = 0; begin < rims_.size(); begin += kLanes) {
    const int count = static_cast<int>(std::min<std::size_t>(kLanes, rims_.size() - begin));
    Neighbourhood around{};
    Vector8 n{}, v{};
    Float8 iu{}, iv{};
    for (int lane = 0; lane < count; ++lane) {
      const RimTexel& rim = rims_[begin + static_cast<std::size_t>(lane)];
      gather(rim.of_chart, positions + rim.place, row_, plane, lane, around);
      const float* const normal = image + static_cast<std::size_t>(kNormalChannel) * size + rim.texel;
      const float* const velocity = image + static_cast<std::size_t>(kVelocityChannel) * size + rim.texel;
      n.x[lane] = normal[0], n.y[lane] = normal[size], n.z[lane] = normal[2 * size];
      v.x[lane] = velocity[0], v.y[lane] = velocity[size], v.z[lane] = velocity[2 * size];
      iu[lane] = rim.inverse_u, iv[lane] = rim.inverse_v;
    }
    const Steps s = steps_of(around);
    const Axes a = axes_of(s);
    const Features values = features_of(s, a, n, v, iu, iv);
    const Float8* const vectors[] = {&a.first.x,  &a.first.y,  &a.first.z,  &a.second.x, &a.second.y,
                                     &a.second.z, &a.normal.x, &a.normal.y, &a.normal.z};
    for (int lane = 0; lane < count; ++lane) {
      const std::size_t texel = rims_[begin + static_cast<std::size_t>(lane)].texel;
      for (std::size_t c = 0; features != nullptr && c < kClothChannels; ++c)
        features[c * size + texel] = values[c][lane];
      for (std::size_t k = 0; axes != nullptr && k < 9; ++k) axes[k * size + texel] = (*vectors[k])[lane];
    }
  }
}

std::vector<EnlargedAxes::Between> EnlargedAxes::places(int count, int scale) {
  std::vector<Between> places;
  for (int i = 0; i < count * scale; ++i) {
    const float place = (static_cast<float>(i) + 0.5F) / static_cast<float>(scale) - 0.5F;
    const int first = static_cast<int>(std::floor(place));
    places.push_back({static_cast<std::size_t>(std::clamp(first, 0, count - 1)),
                      static_cast<std::size_t>(std::clamp(first + 1, 0, count - 1)),
                      place - static_cast<float>(first)});
  }
  return places;
}

EnlargedAxes::EnlargedAxes(int height, int width, int scale)
    : height_(static_cast<std::size_t>(height)),
      width_(static_cast<std::size_t>(width)),
      rows_(places(height, scale)),
      columns_(places(width, scale)) {}

void EnlargedAxes::turn(const float* axes, const float* values, Scratch& scratch, float* turned) const {
  const std::size_t size = height_ * width_, fine_width = columns_.size(), fine_size = fine_width * rows_.size();
  // One row of axes between two coarse rows: (w, 3, 4), each axis in a vector of its own.
  scratch.resize(12 * width_);
  for (std::size_t j = 0; j < rows_.size(); ++j) {
    const Between& row = rows_[j];
    for (std::size_t k = 0; k < 9; ++k) {
      const float* a = axes + k * size + row.first * width_;
      const float* b = axes + k * size + row.second * width_;
      float* to = scratch.data() + 4 * (k / 3) + k % 3;
      for (std::size_t x = 0; x < width_; ++x) to[12 * x] = a[x] + row.weight * (b[x] - a[x]);
    }
    const float* value = values + j * fine_width;
    float* out = turned + 4 * j * fine_width;
    // Between two coarse columns the axes change linearly.
    std::size_t first = width_, second = width_;
    Float4 axis[3]{}, step[3]{};
    for (std::size_t i = 0; i < fine_width; ++i) {
      const Between& column = columns_[i];
      if (column.first != first || column.second != second) {
        first = column.first, second = column.second;
        for (std::size_t k = 0; k < 3; ++k) {
          axis[k] = load_as<Float4>(scratch.data() + 12 * first + 4 * k);
          step[k] = load_as<Float4>(scratch.data() + 12 * second + 4 * k) - axis[k];
        }
      }
      const float w = column.weight;
      store_to(out + 4 * i, value[i] * (axis[0] + w * step[0]) + value[fine_size + i] * (axis[1] + w * step[1]) +
                                value[2 * fine_size + i] * (axis[2] + w * step[2]));
    }
  }
}

void EnlargedAxes::turn_back(const float* axes, float* values) const {
  const std::size_t size = height_ * width_, fine_size = columns_.size() * rows_.size();
  for (std::size_t j = 0; j < rows_.size(); ++j) {
    const Between& row = rows_[j];
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      const Between& column = columns_[i];
      Eigen::Matrix3f turn;  // its columns are the axes
      for (std::size_t k = 0; k < 9; ++k) {
        const auto along = [&](std::size_t y) {
          const float* at = axes + k * size + y * width_;
          return at[column.first] + column.weight * (at[column.second] - at[column.first]);
        };
        turn(static_cast<Eigen::Index>(k % 3), static_cast<Eigen::Index>(k / 3)) =
            along(row.first) + row.weight * (along(row.second) - along(row.first));
      }
      float* at = values + j * columns_.size() + i;
      const Eigen::Vector3f vector(at[0], at[fine_size], at[2 * fine_size]);
      const bool whole = std::abs(turn.determinant()) > kSmallestVolume;
      const Eigen::Matrix3f back = whole ? Eigen::Matrix3f(turn.inverse()) : Eigen::Matrix3f(turn.transpose());
      const Eigen::Vector3f seen = back * vector;
      for (std::size_t k = 0; k < 3; ++k) at[k * fine_size] = seen[static_cast<Eigen::Index>(k)];
    }
  }
}

}  // namespace pleat::conversion
