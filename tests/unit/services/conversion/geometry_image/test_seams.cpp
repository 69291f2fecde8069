#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <vector>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/conversion/geometry_image/detail_image.hpp"
#include "services/conversion/geometry_image/image_map.hpp"

namespace pleat::conversion {
namespace {

constexpr int kColumns = 12, kRows = 8;
constexpr double kStep = 0.05;  // m
constexpr int kCut = 5;         // columns of faces left of the seam
constexpr double kLength = kColumns * kStep, kWidth = kRows * kStep;

/// Where the right part of the sheet lies in material space.
struct Panel {
  const char* name;
  Eigen::Matrix2d turn;
  Eigen::Vector2d shift;
};

std::vector<Panel> panels() {
  const Eigen::Matrix2d quarter = Eigen::Rotation2Dd(std::numbers::pi / 2).toRotationMatrix();
  const Eigen::Matrix2d some = Eigen::Rotation2Dd(0.4).toRotationMatrix();
  const Eigen::Matrix2d mirrored = Eigen::Vector2d(1, -1).asDiagonal();
  return {{"shifted", Eigen::Matrix2d::Identity(), {0.3, 0}},
          {"turned by a right angle", quarter, {1.2, 0.1}},
          {"turned", some, {0.5, 0.05}},
          {"mirrored", mirrored, {0.3, 0.5}}};
}

/// A flat sheet in the plane of x and z whose right part is a chart of its own.
Topology two_panels(const Panel& panel) {
  Topology t;
  const auto vertex = [](int i, int j) { return static_cast<std::uint32_t>(j * (kColumns + 1) + i); };
  const int count = (kColumns + 1) * (kRows + 1), doubled = count + kRows + 1;
  t.rest_positions.resize(count, 3);
  t.uv.resize(doubled, 2);
  for (int j = 0; j <= kRows; ++j) {
    for (int i = 0; i <= kColumns; ++i) {
      const Eigen::Vector2d p(i * kStep, j * kStep);
      t.rest_positions.row(vertex(i, j)) << static_cast<float>(p.x()), 0, static_cast<float>(p.y());
      const Eigen::Vector2d there = panel.turn * p + panel.shift;
      t.uv.row(vertex(i, j)) = (i <= kCut ? p : there).cast<float>().transpose();
      if (i == kCut) t.uv.row(count + j) = there.cast<float>().transpose();
    }
  }
  t.faces.resize(2 * kColumns * kRows, 3);
  t.uv_faces.resize(2 * kColumns * kRows, 3);
  Eigen::Index f = 0;
  for (int j = 0; j < kRows; ++j) {
    for (int i = 0; i < kColumns; ++i) {
      for (const auto& face : {std::array{vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1)},
                               std::array{vertex(i, j), vertex(i + 1, j + 1), vertex(i, j + 1)}}) {
        for (int k = 0; k < 3; ++k) {
          const std::uint32_t v = face[static_cast<std::size_t>(k)];
          const bool on_seam = v % (kColumns + 1) == kCut;
          t.faces(f, k) = v;
          t.uv_faces(f, k) = i >= kCut && on_seam ? static_cast<std::uint32_t>(count) + v / (kColumns + 1) : v;
        }
        ++f;
      }
    }
  }
  return t;
}

/// The material coordinates of a coarse texel, as the header says.
Eigen::Vector2d center(const ImageMap& map, const Topology& t, std::size_t texel, const Eigen::Vector2i& margin) {
  const auto w = static_cast<std::size_t>(map.coarse_width());
  const Eigen::Vector2d low = t.uv.colwise().minCoeff().cast<double>().transpose();
  const Eigen::Vector2d place(static_cast<double>(texel % w) - margin.x(), static_cast<double>(texel / w) - margin.y());
  const double middle = 0.5 * (map.spec().scale - 1) / map.spec().scale;
  return low + (place.array() + middle).matrix().cwiseProduct(map.coarse_step());
}

Eigen::Vector3d shown(const ImageMap& map, const Topology& t, std::size_t texel) {
  const TexelTaps& tap = map.coarse_taps()[texel];
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < 3; ++k) {
    sum += static_cast<double>(tap.weight[k]) * t.rest_positions.row(tap.vertex[k]).cast<double>().transpose();
  }
  return sum;
}

ImageSpec looking(int reach) {
  ImageSpec spec;
  spec.texels_per_fine_vertex = 30;
  spec.seam_reach = reach;
  return spec;
}

bool in_sheet(const Eigen::Vector2d& p, double inside) {
  return p.x() > inside && p.x() < kLength - inside && p.y() > inside && p.y() < kWidth - inside;
}

TEST(Seams, TexelsBeyondThemShowTheSheetAsItWasBeforeItWasCut) {
  for (const Panel& panel : panels()) {
    SCOPED_TRACE(panel.name);
    const Topology t = two_panels(panel);
    const ImageMap map(t, t, looking(3)), without(t, t, looking(0));
    // No seam is at a side of the box: the images have one size.
    ASSERT_EQ(map.coarse_mask().size(), without.coarse_mask().size());
    int left = 0, right = 0;
    for (std::size_t i = 0; i < map.coarse_mask().size(); ++i) {
      const Eigen::Vector2d p = center(map, t, i, {0, 0});
      // The place in the whole sheet, seen from the nearest part.
      const bool from_left = without.coarse_charts()[without.coarse_shown()[i]] == 0;
      const Eigen::Vector2d place = from_left ? p : panel.turn.transpose() * (p - panel.shift);
      if (map.coarse_beyond_seams()[i] != 0) {
        EXPECT_EQ(without.coarse_mask()[i], 0);
        EXPECT_EQ(map.coarse_charts()[i], without.coarse_charts()[without.coarse_shown()[i]]);
        ++(from_left ? left : right);
      }
      if (map.coarse_mask()[i] == 0) {
        const auto w = static_cast<std::size_t>(map.coarse_width());
        const std::size_t near = without.coarse_shown()[i];
        const double columns = static_cast<double>(i % w) - static_cast<double>(near % w);
        const double rows = static_cast<double>(i / w) - static_cast<double>(near / w);
        EXPECT_FALSE(std::hypot(columns, rows) <= 3 && in_sheet(place, 1e-6)) << i << " is beyond the seam, and near";
        continue;
      }
      const Eigen::Vector3d x = shown(map, t, i);
      EXPECT_NEAR(x.x(), place.x(), 1e-6) << i;
      EXPECT_NEAR(x.z(), place.y(), 1e-6) << i;
    }
    EXPECT_GT(left, 10);
    EXPECT_GT(right, 10);
  }
}

/// A detail layout and what it sees of a frame.
struct Seen {
  DetailImage image;
  Tensor input;

  Seen(const Topology& t, int reach, const Positions& positions) : image(t, subdivide(t, subdivision()), spec(reach)) {
    Frame frame;
    frame.positions = positions;
    image.encode({&frame, 1}, RigidTransform{}, input, nullptr);
  }
  double value(int channel, std::size_t texel) const {
    const std::size_t size = image.map().coarse_mask().size();
    return static_cast<double>(input.values[static_cast<std::size_t>(channel) * size + texel]);
  }

 private:
  static SubdivisionSpec subdivision() { return {1, SubdivisionRule::kMidpoint}; }
  static RepresentationSpec spec(int reach) {
    GeometryImageSpec kind;
    kind.layout = ImageLayout::kDetail;
    kind.image = looking(reach);
    RepresentationSpec spec;
    spec.kind = kind;
    spec.subdivision = subdivision();
    return spec;
  }
};

// Rolled up along the seam, a coarse sheet turns at its columns of vertices by an angle each, and the seam is one of
// them. Along a row of texels second differences add up to the step times that angle, around every column.
TEST(Seams, CurvatureGoesOnOverThem) {
  constexpr double kTurn = 0.1;  // at a column
  const Topology t = two_panels(panels()[0]);
  Positions rolled = t.rest_positions;
  for (Eigen::Index v = 0; v < t.vertex_count(); ++v) {
    const double column = std::round(static_cast<double>(t.rest_positions(v, 0)) / kStep);
    Eigen::Vector2d p = Eigen::Vector2d::Zero();
    for (int i = 0; i < static_cast<int>(column); ++i)
      p += kStep * Eigen::Vector2d(std::cos(kTurn * i), std::sin(kTurn * i));
    rolled(v, 0) = static_cast<float>(p.x());
    rolled(v, 1) = static_cast<float>(p.y());
  }
  const auto turned_at = [&](const Seen& seen, int column) {
    const ImageMap& map = seen.image.map();
    const auto w = static_cast<std::size_t>(map.coarse_width());
    const std::size_t row = static_cast<std::size_t>(map.coarse_height()) / 2 * w;
    double sum = 0;
    for (std::size_t i = row; i < row + w; ++i) {
      if (map.coarse_charts()[i] != 0) continue;
      const double x = center(map, t, i, {0, 0}).x();
      if (std::abs(x - column * kStep) < kStep / 2) sum += seen.value(kCurvatureChannel + 2, i);
    }
    return std::abs(sum) / map.coarse_step().x();
  };
  const Seen seen(t, 4, rolled), without(t, 0, rolled);
  EXPECT_NEAR(turned_at(seen, kCut - 2), kTurn, 0.01 * kTurn);
  EXPECT_NEAR(turned_at(seen, kCut), kTurn, 0.01 * kTurn);
  EXPECT_LT(turned_at(without, kCut), 0.1 * kTurn);
}

/// A tube around the axis of y, with one seam, in a chart that fills its box.
Topology tube(int around, int along, double radius, double step) {
  Topology t;
  const auto vertex = [around](int i, int j) { return static_cast<std::uint32_t>(j * around + i % around); };
  const auto place = [around](int i, int j) { return static_cast<std::uint32_t>(j * (around + 1) + i); };
  t.rest_positions.resize(around * (along + 1), 3);
  t.uv.resize((around + 1) * (along + 1), 2);
  const double chord = 2 * radius * std::sin(std::numbers::pi / around);
  for (int j = 0; j <= along; ++j) {
    for (int i = 0; i <= around; ++i) {
      const double angle = 2 * std::numbers::pi * i / around;
      if (i < around) {
        t.rest_positions.row(vertex(i, j)) << static_cast<float>(radius * std::cos(angle)),
            static_cast<float>(j * step), static_cast<float>(-radius * std::sin(angle));
      }
      t.uv.row(place(i, j)) << static_cast<float>(i * chord), static_cast<float>(j * step);
    }
  }
  t.faces.resize(2 * around * along, 3);
  t.uv_faces.resize(2 * around * along, 3);
  Eigen::Index f = 0;
  for (int j = 0; j < along; ++j) {
    for (int i = 0; i < around; ++i) {
      t.faces.row(f) << vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1);
      t.uv_faces.row(f++) << place(i, j), place(i + 1, j), place(i + 1, j + 1);
      t.faces.row(f) << vertex(i, j), vertex(i + 1, j + 1), vertex(i, j + 1);
      t.uv_faces.row(f++) << place(i, j), place(i + 1, j + 1), place(i, j + 1);
    }
  }
  return t;
}

TEST(Seams, ATubeGoesRound) {
  constexpr int kAround = 20;
  constexpr double kRadius = 0.2;
  const Topology t = tube(kAround, 6, kRadius, 0.06);
  const ImageMap map(t, t, looking(4)), without(t, t, looking(0));
  // Four more on the left and on the right of a box that the seam bounds there; none above or below.
  ASSERT_EQ(map.coarse_width(), without.coarse_width() + 8);
  ASSERT_EQ(map.coarse_height(), without.coarse_height());
  const double circumference = 2 * kRadius * std::sin(std::numbers::pi / kAround) * kAround;
  const auto w = static_cast<std::size_t>(map.coarse_width());
  for (std::size_t i = 0; i < map.coarse_mask().size(); ++i) {
    const Eigen::Vector2d p = center(map, t, i, {4, 0});
    EXPECT_EQ(map.coarse_mask()[i], 1) << "beyond both sides lies the other one";
    EXPECT_EQ(map.coarse_beyond_seams()[i], i % w < 4 || i % w >= w - 4 ? 1 : 0);
    const Eigen::Vector3d x = shown(map, t, i);
    // On the polygon at the angle that the place has around it.
    const double angle = 2 * std::numbers::pi * p.x() / circumference;
    EXPECT_NEAR(std::remainder(std::atan2(-x.z(), x.x()) - angle, 2 * std::numbers::pi), 0, 2e-3) << i;
    EXPECT_NEAR(x.y(), p.y(), 1e-6);
  }
}

TEST(Seams, WhatATubeShowsOfItselfIsTheSameAllAround) {
  constexpr int kAround = 20;
  const Topology t = tube(kAround, 6, 0.2, 0.06);
  const Seen seen(t, 4, t.rest_positions);
  const ImageMap& map = seen.image.map();
  const auto w = static_cast<std::size_t>(map.coarse_width()), h = map.coarse_mask().size() / w;
  for (std::size_t i = w; i < (h - 1) * w; ++i) {
    if (map.coarse_beyond_seams()[i] != 0) continue;
    // A step over one of the edges along the axis is a little shorter than in the material.
    for (const int strain : {0, 1, 2}) EXPECT_NEAR(seen.value(strain, i), 0, 0.03) << i;
  }
  EXPECT_FALSE(map.fine_beyond_seams().empty());
  for (const SeamTexel& texel : map.fine_beyond_seams()) {
    EXPECT_EQ(map.fine_mask()[texel.texel], 0) << "a vertex reads it";
    EXPECT_NEAR(texel.weight[0] + texel.weight[1] + texel.weight[2], 1, 1e-5);
  }
}

TEST(Seams, AReachOutOfRangeIsRefused) {
  const Topology t = tube(8, 2, 0.2, 0.06);
  for (const int reach : {-1, kMostSeamReach + 1}) {
    try {
      const ImageMap map(t, t, looking(reach));
      FAIL() << reach;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
    }
  }
}

}  // namespace
}  // namespace pleat::conversion
