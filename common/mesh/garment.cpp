#include "common/mesh/garment.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "common/base/error.hpp"
#include "common/mesh/charts.hpp"
#include "common/mesh/mesh_file.hpp"

namespace pleat {
namespace {

constexpr double kFar = 2;                    ///< ratio of lengths that no cloth reaches on the median
constexpr double kTorn = 10;                  ///< and none in one edge
constexpr float kLarge = 10, kSmall = 0.02f;  ///< extents in metres that few garments have

EdgeRatios ratios_of(std::vector<double> ratios) {
  if (ratios.empty()) return {};
  const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
  std::nth_element(ratios.begin(), middle, ratios.end());
  return {*middle, *std::max_element(ratios.begin(), ratios.end())};
}

// Of the width of what lies there: charts of different meshes don't touch.
constexpr float kGapBetween = 0.02f;

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

bool is_far(double ratio) { return !(ratio <= kFar && ratio >= 1 / kFar); }

void note_size(const Topology& garment, const std::string& name, std::vector<std::string>& notes) {
  const float extent =
      (garment.rest_positions.colwise().maxCoeff() - garment.rest_positions.colwise().minCoeff()).maxCoeff();
  if (extent > kLarge) {
    notes.push_back(
        name + ": is " + number(static_cast<double>(extent)) +
        " m large; if it is in centimetres or millimetres, give --scale 0.01 or 0.001 (data sets: --garment-scale)");
  } else if (extent < kSmall) {
    notes.push_back(name + ": is " + number(static_cast<double>(extent)) +
                    " m large; if it is in another unit, give --scale (data sets: --garment-scale) with its metres");
  }
}

template <typename Rows>
void append(Rows& rows, const Rows& more) {
  const Eigen::Index before = rows.rows();
  rows.conservativeResize(before + more.rows(), Eigen::NoChange);
  rows.bottomRows(more.rows()) = more;
}

}  // namespace

Topology read_garment(const std::filesystem::path& path, std::vector<std::string>& notes, double scale) {
  return made_garment(read_mesh(path, MeshUse::kGarment), path.string(), notes, scale);
}

Topology made_garment(Topology garment, const std::string& name, std::vector<std::string>& notes, double scale) {
  if (!(scale > 0) || !std::isfinite(scale)) throw_invalid_argument("scale " + number(scale) + ": must be positive");
  if (scale != 1) {
    const bool same_unit = garment.uv_faces.rows() > 0 && !is_far(material_ratios(garment).median);
    garment.rest_positions *= static_cast<float>(scale);
    if (same_unit) garment.uv *= static_cast<float>(scale);
  }
  prepare_garment(garment, name, notes);
  note_size(garment, name, notes);
  return garment;
}

EdgeRatios edge_ratios(const Positions& now, const Positions& rest, const Faces& faces) {
  std::vector<double> ratios;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = faces(f, k), b = faces(f, (k + 1) % 3);
      const double length = static_cast<double>((rest.row(a) - rest.row(b)).norm());
      if (length > 0) ratios.push_back(static_cast<double>((now.row(a) - now.row(b)).norm()) / length);
    }
  }
  return ratios_of(std::move(ratios));
}

EdgeRatios material_ratios(const Topology& garment) {
  std::vector<double> ratios;
  for (Eigen::Index f = 0; f < garment.uv_faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const int n = (k + 1) % 3;
      const double length =
          static_cast<double>((garment.uv.row(garment.uv_faces(f, k)) - garment.uv.row(garment.uv_faces(f, n))).norm());
      const double space = static_cast<double>(
          (garment.rest_positions.row(garment.faces(f, k)) - garment.rest_positions.row(garment.faces(f, n))).norm());
      if (length > 0) ratios.push_back(space / length);
    }
  }
  return ratios_of(std::move(ratios));
}

void require_rest_lengths(const Topology& garment, const std::string& name) {
  const double ratio = material_ratios(garment).median;
  if (!is_far(ratio)) return;
  throw_invalid_argument(name + ": edges are " + number(ratio) +
                         " times as long in space as in material coordinates, which give the cloth its size in metres; "
                         "scale one of them");
}

void require_frame_of(const Positions& frame, const Topology& rest, const std::string& frame_name,
                      const std::string& rest_name) {
  const EdgeRatios ratios = edge_ratios(frame, rest.rest_positions, rest.faces);
  if (!is_far(ratios.median) && ratios.most < kTorn) return;
  // One factor for all edges is a unit; others are another order.
  const bool unit = ratios.most < 1.5 * ratios.median;
  throw_invalid_argument(frame_name + ": edges are " + number(ratios.median) +
                         " times as long as at rest on the median, " + number(ratios.most) + " times at most: " +
                         (unit ? "are both in metres?" : "is the vertex order that of " + rest_name + "?"));
}

Topology join_garments(const std::vector<Topology>& garments) {
  Topology joined = garments.at(0);
  for (std::size_t g = 1; g < garments.size(); ++g) {
    Topology next = garments[g];
    next.faces.array() += static_cast<std::uint32_t>(joined.vertex_count());
    next.uv_faces.array() += static_cast<std::uint32_t>(joined.uv.rows());
    const float low = joined.uv.col(0).minCoeff(), high = joined.uv.col(0).maxCoeff();
    next.uv.col(0).array() += high + kGapBetween * (high - low) - next.uv.col(0).minCoeff();
    append(joined.rest_positions, next.rest_positions);
    append(joined.faces, next.faces);
    append(joined.uv, next.uv);
    append(joined.uv_faces, next.uv_faces);
  }
  return joined;
}

}  // namespace pleat
