#include "services/conversion/geometry_image/cloth_axes.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "common/mesh/connectivity.hpp"

namespace pleat::conversion {
namespace {

/// Features by the letter, texel by texel, in double precision.
class Plain {
 public:
  Plain(const std::vector<float>& rest, const std::vector<float>& image, int height, int width)
      : rest_(rest), image_(image), height_(height), width_(width) {}

  Eigen::Matrix3d axes(int y, int x) const {  // columns: along, across, normal
    const Eigen::Vector3d n = u(y, x, true).cross(v(y, x, true)).normalized(), t = u(y, x, true).normalized();
    return (Eigen::Matrix3d() << t, n.cross(t), n).finished();
  }

  std::vector<double> features(int y, int x) const {
    const Eigen::Matrix3d a = axes(y, x);
    const Eigen::Vector3d du = u(y, x, true), dv = v(y, x, true), ru = u(y, x, false), rv = v(y, x, false);
    std::vector<double> result{du.squaredNorm() / ru.squaredNorm() - 1, dv.squaredNorm() / rv.squaredNorm() - 1,
                               du.dot(dv) / (ru.norm() * rv.norm())};
    const auto p = [&](int dy, int dx) { return position(y + dy, x + dx, true); };
    const Eigen::Vector3d bends[] = {p(0, 1) - 2 * p(0, 0) + p(0, -1), (p(1, 1) - p(1, -1) - p(-1, 1) + p(-1, -1)) / 4,
                                     p(1, 0) - 2 * p(0, 0) + p(-1, 0)};
    for (const Eigen::Vector3d& bend : bends) {
      for (int k = 0; k < 3; ++k) result.push_back(bend.dot(a.col(k)));
    }
    for (int k = 0; k < 2; ++k) result.push_back(seen(kNormalChannel, y, x).dot(a.col(k)));
    for (int k = 0; k < 3; ++k) result.push_back(seen(kVelocityChannel, y, x).dot(a.col(k)));
    return result;
  }

 private:
  Eigen::Vector3d seen(int channel, int y, int x) const {
    Eigen::Vector3d value;
    for (int c = 0; c < 3; ++c) value[c] = image_[static_cast<std::size_t>(((channel + c) * height_ + y) * width_ + x)];
    return value;
  }
  Eigen::Vector3d position(int y, int x, bool moved) const {
    if (y < 0) return 2 * position(0, x, moved) - position(1, x, moved);
    if (y >= height_) return 2 * position(height_ - 1, x, moved) - position(height_ - 2, x, moved);
    if (x < 0) return 2 * position(y, 0, moved) - position(y, 1, moved);
    if (x >= width_) return 2 * position(y, width_ - 1, moved) - position(y, width_ - 2, moved);
    Eigen::Vector3d value = moved ? seen(kDisplacementChannel, y, x) : Eigen::Vector3d(Eigen::Vector3d::Zero());
    for (int c = 0; c < 3; ++c) value[c] += rest_[static_cast<std::size_t>((c * height_ + y) * width_ + x)];
    return value;
  }
  Eigen::Vector3d u(int y, int x, bool moved) const {
    return (position(y, x + 1, moved) - position(y, x - 1, moved)) / 2;
  }
  Eigen::Vector3d v(int y, int x, bool moved) const {
    return (position(y + 1, x, moved) - position(y - 1, x, moved)) / 2;
  }

  const std::vector<float>&rest_, &image_;
  int height_, width_;
};

struct Sample {
  int height, width;
  std::vector<float> rest, image;
  Sample(int h, int w) : height(h), width(w) {
    std::mt19937 random(static_cast<unsigned>(h * 100 + w));
    std::uniform_real_distribution<float> uniform(-1, 1);
    for (int c = 0; c < 3; ++c) {
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) {
          rest.push_back((c == 0   ? 0.02f * static_cast<float>(x)
                          : c == 2 ? -0.03f * static_cast<float>(y)
                                   : 0.0f) +
                         0.001f * uniform(random));
        }
      }
    }
    for (int i = 0; i < 9 * h * w; ++i) image.push_back((i < 3 * h * w ? 0.004f : 1.0f) * uniform(random));
  }
};

TEST(ClothAxes, FollowTheirDefinitions) {
  // Widths around the length of a vector, and the smallest image.
  for (const auto& [h, w] : {std::pair{5, 7}, {4, 8}, {3, 17}, {2, 2}}) {
    const Sample sample(h, w);
    const ClothAxes cloth(sample.rest, h, w);
    const auto size = static_cast<std::size_t>(h * w);
    std::vector<float> features(kClothChannels * size), axes(9 * size);
    ClothAxes::Scratch scratch;
    cloth.compute(sample.image.data(), scratch, features.data(), axes.data());
    const Plain plain(sample.rest, sample.image, h, w);
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        const auto texel = static_cast<std::size_t>(y * w + x);
        const std::vector<double> expected = plain.features(y, x);
        ASSERT_EQ(expected.size(), static_cast<std::size_t>(kClothChannels));
        for (std::size_t c = 0; c < expected.size(); ++c) {
          EXPECT_NEAR(features[c * size + texel], expected[c], 2e-5 * std::max(1.0, std::abs(expected[c])))
              << cloth_channel_names()[c] << " at " << y << ", " << x << " of " << h << " x " << w;
        }
        for (std::size_t k = 0; k < 9; ++k) {
          EXPECT_NEAR(axes[k * size + texel],
                      plain.axes(y, x)(static_cast<Eigen::Index>(k % 3), static_cast<Eigen::Index>(k / 3)), 1e-5);
        }
      }
    }
  }
}

TEST(ClothAxes, PaddingWithoutExtentIsFinite) {
  Sample sample(4, 6);
  std::fill(sample.rest.begin(), sample.rest.end(), 0.5f);
  std::fill(sample.image.begin(), sample.image.end(), 0.1f);
  const ClothAxes cloth(sample.rest, 4, 6);
  std::vector<float> features(kClothChannels * 24), axes(9 * 24);
  ClothAxes::Scratch scratch;
  cloth.compute(sample.image.data(), scratch, features.data(), axes.data());
  for (const float value : features) EXPECT_TRUE(std::isfinite(value));
  for (const float value : axes) EXPECT_TRUE(std::isfinite(value));
  for (std::size_t i = 0; i < 3 * 24; ++i) EXPECT_EQ(features[i], 0) << "strain where there is no cloth";
}

/// The same vector as enlarging all nine planes first.
TEST(EnlargedAxes, TurnByTheBilinearAxes) {
  for (const int scale : {2, 4, 8}) {
    const int h = 3, w = 5;
    const Sample sample(h, w);
    std::vector<float> axes(9 * 15);
    ClothAxes::Scratch positions;
    ClothAxes(sample.rest, h, w).compute(sample.image.data(), positions, nullptr, axes.data());
    const auto fine = static_cast<std::size_t>(h * w * scale * scale);
    std::vector<float> values(3 * fine), turned(4 * fine), scratch;
    std::mt19937 random(3);
    std::uniform_real_distribution<float> uniform(-1, 1);
    for (float& v : values) v = uniform(random);
    const EnlargedAxes enlarged(h, w, scale);
    enlarged.turn(axes.data(), values.data(), scratch, turned.data());
    for (int j = 0; j < h * scale; ++j) {
      for (int i = 0; i < w * scale; ++i) {
        const double fy = std::clamp((j + 0.5) / scale - 0.5, 0.0, h - 1.0);
        const double fx = std::clamp((i + 0.5) / scale - 0.5, 0.0, w - 1.0);
        const int y = std::min(static_cast<int>(fy), h - 2), x = std::min(static_cast<int>(fx), w - 2);
        const auto texel = static_cast<std::size_t>(j * w * scale + i);
        for (std::size_t c = 0; c < 3; ++c) {
          double expected = 0;
          for (std::size_t k = 0; k < 3; ++k) {
            const auto at = [&](int dy, int dx) -> double {
              return axes[(3 * k + c) * 15 + static_cast<std::size_t>((y + dy) * w + x + dx)];
            };
            const double axis = (1 - fy + y) * ((1 - fx + x) * at(0, 0) + (fx - x) * at(0, 1)) +
                                (fy - y) * ((1 - fx + x) * at(1, 0) + (fx - x) * at(1, 1));
            expected += static_cast<double>(values[k * fine + texel]) * axis;
          }
          EXPECT_NEAR(turned[4 * texel + c], expected, 1e-5);
        }
      }
    }
    std::vector<float> back(3 * fine);
    for (std::size_t t = 0; t < fine; ++t) {
      for (std::size_t c = 0; c < 3; ++c) back[c * fine + t] = turned[4 * t + c];
    }
    enlarged.turn_back(axes.data(), back.data());
    for (std::size_t i = 0; i < back.size(); ++i) EXPECT_NEAR(back[i], values[i], 1e-3);
  }
}

/// A chart in the middle of an image is seen as if it were the whole of one.
TEST(ClothAxes, RimsOfChartsAreLikeThoseOfTheImage) {
  constexpr int kSmall = 9, kLarge = 14, kAt = 3;
  const Sample chart(kSmall, kSmall);
  Sample image(kLarge, kLarge);
  std::vector<std::uint32_t> charts(kLarge * kLarge, kNone), shown(charts.size());
  const auto inside = [&](std::size_t y, std::size_t x) {
    return y >= kAt && y < kAt + kSmall && x >= kAt && x < kAt + kSmall;
  };
  const auto small_of = [&](std::size_t y, std::size_t x) { return (y - kAt) * kSmall + x - kAt; };
  for (std::size_t y = 0; y < kLarge; ++y) {
    for (std::size_t x = 0; x < kLarge; ++x) {
      const std::size_t texel = y * kLarge + x;
      const std::size_t ny = std::clamp<std::size_t>(y, kAt, kAt + kSmall - 1),
                        nx = std::clamp<std::size_t>(x, kAt, kAt + kSmall - 1);
      shown[texel] = static_cast<std::uint32_t>(ny * kLarge + nx);
      if (!inside(y, x)) continue;
      charts[texel] = 5;
      for (std::size_t c = 0; c < 3; ++c) {
        image.rest[c * kLarge * kLarge + texel] = chart.rest[c * kSmall * kSmall + small_of(y, x)];
      }
      for (std::size_t c = 0; c < kFrameChannels; ++c) {
        image.image[c * kLarge * kLarge + texel] = chart.image[c * kSmall * kSmall + small_of(y, x)];
      }
    }
  }
  std::vector<float> expected(kClothChannels * kSmall * kSmall), expected_axes(9 * kSmall * kSmall),
      features(kClothChannels * kLarge * kLarge), axes(9 * kLarge * kLarge);
  ClothAxes::Scratch scratch;
  ClothAxes(chart.rest, kSmall, kSmall).compute(chart.image.data(), scratch, expected.data(), expected_axes.data());
  ClothAxes(image.rest, kLarge, kLarge, {charts, shown, {}, {}})
      .compute(image.image.data(), scratch, features.data(), axes.data());
  for (std::size_t y = 0; y < kLarge; ++y) {
    for (std::size_t x = 0; x < kLarge; ++x) {
      const std::size_t texel = y * kLarge + x;
      for (std::size_t c = 0; c < kClothChannels; ++c) {
        const float value = features[c * kLarge * kLarge + texel];
        if (inside(y, x)) {
          EXPECT_NEAR(value, expected[c * kSmall * kSmall + small_of(y, x)], 2e-4) << y << " " << x << " " << c;
        } else {
          EXPECT_EQ(value, 0);
        }
      }
      for (std::size_t k = 0; k < 9; ++k) {
        EXPECT_EQ(axes[k * kLarge * kLarge + texel], axes[k * kLarge * kLarge + shown[texel]]);
        if (inside(y, x)) {
          EXPECT_NEAR(axes[k * kLarge * kLarge + texel], expected_axes[k * kSmall * kSmall + small_of(y, x)], 1e-4);
        }
      }
    }
  }
}

}  // namespace
}  // namespace pleat::conversion
