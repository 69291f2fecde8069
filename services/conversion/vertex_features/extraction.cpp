#include "services/conversion/vertex_features/extraction.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"
#include "services/conversion/vertex_features/polar.hpp"

namespace pleat::conversion {
namespace {

// A rest mesh counts as flat if it leaves its plane by less than this share of its extent.
constexpr double kFlat = 1e-5;

Vector8 load_vector(const float* plane, std::size_t first, std::size_t count) {
  return {load_lanes(plane, first, count), load_lanes(plane + count, first, count),
          load_lanes(plane + 2 * count, first, count)};
}

std::optional<Eigen::Matrix3f> plane_of(const Positions& rest_positions) {
  const Eigen::MatrixX3d p = rest_positions.cast<double>();
  const Eigen::RowVector3d centre = p.colwise().mean();
  const Eigen::MatrixX3d d = p.rowwise() - centre;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> spectrum(d.transpose() * d);
  const Eigen::Vector3d normal = spectrum.eigenvectors().col(0);
  if ((d * normal).cwiseAbs().maxCoeff() > kFlat * d.rowwise().norm().maxCoeff()) return std::nullopt;
  // The coordinate axes nearest to the plane, so that a sheet in x and z has T's own first and last column.
  Eigen::Index along = 0;
  normal.cwiseAbs().maxCoeff(&along);
  const Eigen::Vector3d unit = Eigen::Vector3d::Unit((along + 1) % 3);
  const Eigen::Vector3d n = normal(along) < 0 ? Eigen::Vector3d(-normal) : normal;
  Eigen::Matrix3d axes;
  axes.col(0) = (unit - unit.dot(n) * n).normalized();
  axes.col(1) = n.cross(axes.col(0));
  axes.col(2) = n;
  return axes.cast<float>();
}

bool within(const Eigen::Matrix3f& t, float lowest, float highest) {
  // Gershgorin's bounds on the eigenvalues of T^T T.
  const Eigen::Matrix3f s = t.transpose() * t;
  for (int k = 0; k < 3; ++k) {
    const float radius = std::abs(s(k, (k + 1) % 3)) + std::abs(s(k, (k + 2) % 3));
    if (!(s(k, k) - radius >= lowest * lowest && s(k, k) + radius <= highest * highest)) return false;
  }
  return t.determinant() > 0;
}

}  // namespace

FeatureExtractor::FeatureExtractor(std::shared_ptr<const OneRings> rings, RotationCode code, float temporal_weight)
    : rings_(std::move(rings)), code_(code), labels_(code, rings_->vertex_count(), rings_->edges(), temporal_weight) {}

void FeatureExtractor::extract(const Positions& positions, float heading, std::span<const Float4> previous,
                               ExtractedFrame& frame) const {
  const std::size_t count = rings_->vertex_count();
  if (!previous.empty() && previous.size() != count) {
    throw_invalid_argument("vertex features: " + std::to_string(previous.size()) + " rotations of the last frame for " +
                           std::to_string(count) + " vertices");
  }
  // About the first vertex: edges far from the origin keep their digits through the rotation.
  const Eigen::Vector3f origin = positions.rows() > 0 ? Eigen::Vector3f(positions.row(0)) : Eigen::Vector3f::Zero();
  load_positions(positions, count, -heading, origin, "vertex features", frame.positions);
  frame.values.resize(static_cast<std::size_t>(channels()) * count);
  frame.rotations.resize(count);
  const auto first_stretch = static_cast<std::size_t>(rotation_channels(code_));
  for (std::size_t pack = 0; pack < rings_->pack_count(); ++pack) {
    const std::size_t first = pack * kRingPack;
    const Polar8 polar = polar_decomposition(rings_->gradients(pack, frame.positions.data()));
    const Quaternion8 q = quaternions(polar.rotation);
    scatter_lanes(code_ == RotationCode::kLogarithm ? axes_and_angles(q) : q, frame.rotations.data() + first,
                  std::min(kRingPack, count - first));
    for (std::size_t k = 0; k < 6; ++k) {
      store_lanes(polar.stretch[k], frame.values.data() + (first_stretch + k) * count, first, count);
    }
  }
  frame.report = labels_.label(frame.rotations, previous, frame.labels);
  float* const planes = frame.values.data();
  for (std::size_t v = 0; v < count; ++v) {
    const Float4 x = frame.labels[v];
    if (code_ == RotationCode::kLogarithm) {
      planes[v] = -x[2];
      planes[count + v] = x[1];
      planes[2 * count + v] = -x[0];
    } else {
      for (std::size_t k = 0; k < 4; ++k) planes[k * count + v] = x[static_cast<int>(k)];
    }
  }
}

std::vector<std::string> feature_channel_names(RotationCode code) {
  std::vector<std::string> names = {"rotation_xy", "rotation_xz", "rotation_yz"};
  if (code == RotationCode::kQuaternion) names = {"rotation_w", "rotation_x", "rotation_y", "rotation_z"};
  for (const char* entry : {"xx", "xy", "xz", "yy", "yz", "zz"}) names.push_back(std::string("stretch_") + entry);
  return names;
}

void gradients_from_features(RotationCode code, std::span<const float> values, GradientField& field) {
  const auto rotations = static_cast<std::size_t>(rotation_channels(code));
  const std::size_t count = values.size() / (rotations + 6);
  if (count == 0 || count * (rotations + 6) != values.size()) {
    throw_invalid_argument("vertex features: " + std::to_string(values.size()) + " values do not fill " +
                           std::to_string(rotations + 6) + " channels");
  }
  field.columns.resize(count);
  for (std::size_t first = 0; first < count; first += kRingPack) {
    const Vector8 entries = load_vector(values.data(), first, count);
    const Matrix8 rotation = code == RotationCode::kLogarithm
                                 ? rotations_from_vectors({-entries.z, entries.y, -entries.x})
                                 : rotations_from_quaternions({entries.x, entries.y, entries.z,
                                                               load_lanes(values.data() + 3 * count, first, count)});
    std::array<Float8, 6> stretch;
    for (std::size_t k = 0; k < 6; ++k) {
      stretch[k] = load_lanes(values.data() + (rotations + k) * count, first, count);
    }
    store_gradients(compose(rotation, stretch), first, field);
  }
}

GradientChannels::GradientChannels(const Positions& rest_positions) : axes_(plane_of(rest_positions)) {}

std::vector<std::string> GradientChannels::names() const {
  std::vector<std::string> names;
  if (planar()) {
    for (const char* column : {"a", "b"}) {
      for (const char* row : {"x", "y", "z"}) names.push_back(std::string("gradient_") + row + column);
    }
  } else {
    for (const char* row : {"x", "y", "z"}) {
      for (const char* column : {"x", "y", "z"}) names.push_back(std::string("gradient_") + row + column);
    }
  }
  return names;
}

void GradientChannels::to_planes(const GradientField& field, std::vector<float>& values) const {
  const std::size_t count = field.columns.size();
  values.resize(static_cast<std::size_t>(channels()) * count);
  for (std::size_t v = 0; v < count; ++v) {
    const auto& t = field.columns[v];
    for (std::size_t row = 0; row < 3; ++row) {
      const auto r = static_cast<int>(row);
      if (!planar()) {
        for (std::size_t c = 0; c < 3; ++c) values[(3 * row + c) * count + v] = t[c][r];
        continue;
      }
      for (std::size_t axis = 0; axis < 2; ++axis) {
        const auto a = axes_->col(static_cast<Eigen::Index>(axis));
        values[(3 * axis + row) * count + v] = t[0][r] * a(0) + t[1][r] * a(1) + t[2][r] * a(2);
      }
    }
  }
}

void GradientChannels::from_planes(std::span<const float> values, GradientField& field) const {
  const auto channel_count = static_cast<std::size_t>(channels());
  const std::size_t count = values.size() / channel_count;
  if (count == 0 || count * channel_count != values.size()) {
    throw_invalid_argument("vertex features: " + std::to_string(values.size()) + " values do not fill " +
                           std::to_string(channel_count) + " channels");
  }
  field.columns.resize(count);
  for (std::size_t first = 0; first < count; first += kRingPack) {
    Matrix8 t;
    if (planar()) {
      const Vector8 a = load_vector(values.data(), first, count),
                    b = load_vector(values.data() + 3 * count, first, count);
      const Vector8 area = cross(a, b);
      const Vector8 n = (1 / sqrt(max(dot(area, area), broadcast8(1e-30f)))) * area;
      for (std::size_t c = 0; c < 3; ++c) {
        const auto row = axes_->row(static_cast<Eigen::Index>(c));
        t[c] = row(0) * a.x + row(1) * b.x + row(2) * n.x;
        t[3 + c] = row(0) * a.y + row(1) * b.y + row(2) * n.y;
        t[6 + c] = row(0) * a.z + row(1) * b.z + row(2) * n.z;
      }
    } else {
      for (std::size_t k = 0; k < 9; ++k) t[k] = load_lanes(values.data() + k * count, first, count);
    }
    store_gradients(t, first, field);
  }
}

void clamp_stretch(GradientField& field, float lowest, float highest) {
  for (std::size_t v = 0; v < field.columns.size(); ++v) {
    const Eigen::Matrix3f t = field.at(v);
    if (within(t, lowest, highest)) continue;
    const Eigen::JacobiSVD<Eigen::Matrix3f> svd(t, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Matrix3f u = svd.matrixU();
    if (u.determinant() * svd.matrixV().determinant() < 0) u.col(2) = -u.col(2);
    const Eigen::Vector3f s = svd.singularValues().cwiseMax(lowest).cwiseMin(highest);
    field.set(v, u * s.asDiagonal() * svd.matrixV().transpose());
  }
}

}  // namespace pleat::conversion
