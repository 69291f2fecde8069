// The cloth's own axes at each texel of a coarse image, and what is seen in them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "services/conversion/geometry_image/image_map.hpp"

namespace pleat::conversion {

/// What a network reads in the cloth's own axes, channels in this order: strains of the texel's steps along u and v
/// (3: uu, vv, uv), second differences of the positions uu, uv, vv in each axis (9, metres), the interpolated normal's
/// parts in the sheet (2), the velocity (3, m/s).
inline constexpr int kCurvatureChannel = 3, kClothNormalChannel = 12, kClothVelocityChannel = 14, kClothChannels = 17;
/// "strain_uu" ... "velocity_normal".
const std::vector<std::string>& cloth_channel_names();

/// Texels of several charts.
struct TexelCharts {
  std::vector<std::uint32_t> of;     ///< (h w) the chart of each texel, kNone for padding
  std::vector<std::uint32_t> shown;  ///< (h w) the valid texel whose value each texel shows
  /// (h w) 1 beyond a seam. There and beside it a step is as long at rest as in the material, u and v in metres: the
  /// rest mesh may be creased at the seam. Empty: there are none.
  std::vector<std::uint8_t> beyond_seams;
  std::array<float, 2> step{};
};

/// The axes of a texel, from differences of neighbouring texels: the first along u, the third normal to the sheet, the
/// second across both, t, n x t and n with t = du / |du| and n = du x dv / |du x dv|. Outside the image, and beyond the
/// rim of a texel's chart, positions continue linearly. Immutable.
class ClothAxes {
 public:
  /// rest: (3, h, w) rest positions at the coarse texels, metres. Without charts all texels are of one.
  ClothAxes(const std::vector<float>& rest, int height, int width, const TexelCharts& charts = {});

  /// Memory of one computation.
  using Scratch = std::vector<float>;

  /// image: (9, h, w), the channels of frame_channel_names(). features: (17, h, w). axes: (9, h, w), three vectors.
  /// Either result may be null. Where the rest mesh has no extent, strains are zero. Padding has the axes of the texel
  /// that it shows, none between two charts, and features of zero, as of a sheet at rest.
  void compute(const float* image, Scratch& scratch, float* features, float* axes) const;

 private:
  /// A texel with neighbours that are not of its chart.
  struct RimTexel {
    std::size_t texel, place;  ///< in a plane of the image, and in one of extended positions
    std::array<bool, 9> of_chart;
    float inverse_u, inverse_v;
  };
  struct Borrowed {
    std::size_t texel, from;
  };
  struct Padding {
    std::size_t texel, shown;
    bool has_axes;
  };

  bool between_charts(const std::vector<std::uint32_t>& charts, std::size_t texel, std::uint32_t chart) const;
  void lend(const std::vector<std::uint32_t>& charts);
  void find_rims(const std::vector<std::uint32_t>& charts, const float* positions);
  void take_material_steps(const TexelCharts& charts);
  void extend(const float* displacement, float* positions) const;
  void compute_rims(const float* image, const float* positions, float* features, float* axes) const;

  int height_, width_;
  std::size_t row_;                           ///< values of an extended row, a multiple of a vector's
  std::vector<float> rest_;                   ///< (3, h, w)
  std::vector<float> inverse_u_, inverse_v_;  ///< (h, row): 1 / squared length of a step in the rest mesh; 0: none
  std::vector<RimTexel> rims_;
  std::vector<Borrowed> borrowed_;
  std::vector<Padding> padding_;
};

/// The axes of coarse texels enlarged bilinearly to those of fine texels. Immutable.
class EnlargedAxes {
 public:
  EnlargedAxes(int height, int width, int scale);

  using Scratch = std::vector<float>;

  /// Vectors in the axes of their texel -> in the alignment's axes. axes: (9, h, w); values: (3, scale h, scale w).
  /// turned: (scale h, scale w, 4): x, y, z and nothing.
  void turn(const float* axes, const float* values, Scratch& scratch, float* turned) const;
  /// The inverse: values (3, scale h, scale w), in place. Where enlarged axes have collapsed, their transpose stands
  /// for the inverse.
  void turn_back(const float* axes, float* values) const;

 private:
  /// Where a fine texel's centre lies between coarse ones, along one direction.
  struct Between {
    std::size_t first, second;
    float weight;  ///< of the second
  };
  static std::vector<Between> places(int count, int scale);

  std::size_t height_, width_;
  std::vector<Between> rows_, columns_;
};

}  // namespace pleat::conversion
