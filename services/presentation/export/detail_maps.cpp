#include "services/presentation/export/detail_maps.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "common/base/error.hpp"

namespace pleat::presentation {
namespace {

constexpr std::uint32_t kNoFace = 0xffffffffu;
constexpr float kBorder = 0.02F;  ///< of the image, on each side: room for the padding

/// Which face a texel's centre lies in, and where.
struct Cover {
  std::uint32_t face = kNoFace;
  std::array<float, 3> weights{};
};

/// uv: in [0, 1], v up. Row 0 is the upper one.
std::vector<Cover> rasterize(const Uv& uv, const Faces& faces, int size) {
  std::vector<Cover> covers(static_cast<std::size_t>(size) * static_cast<std::size_t>(size));
  const auto scale = static_cast<double>(size);
  const auto bounded = [size](double value) { return static_cast<int>(std::clamp(value, 0.0, size - 1.0)); };
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    std::array<Eigen::Vector2d, 3> corner;
    for (Eigen::Index k = 0; k < 3; ++k) {
      const auto row = uv.row(faces(f, k));
      corner[static_cast<std::size_t>(k)] =
          Eigen::Vector2d(static_cast<double>(row(0)) * scale, (1 - static_cast<double>(row(1))) * scale);
    }
    const Eigen::Vector2d a = corner[1] - corner[0], b = corner[2] - corner[0];
    const double area = a.x() * b.y() - a.y() * b.x();
    if (area == 0) continue;
    const auto [left, right] = std::minmax({corner[0].x(), corner[1].x(), corner[2].x()});
    const auto [up, down] = std::minmax({corner[0].y(), corner[1].y(), corner[2].y()});
    for (int y = bounded(std::floor(up - 0.5)); y <= bounded(std::ceil(down)); ++y) {
      for (int x = bounded(std::floor(left - 0.5)); x <= bounded(std::ceil(right)); ++x) {
        const Eigen::Vector2d p = Eigen::Vector2d(x + 0.5, y + 0.5) - corner[0];
        const double w1 = (p.x() * b.y() - p.y() * b.x()) / area, w2 = (a.x() * p.y() - a.y() * p.x()) / area;
        if (w1 < 0 || w2 < 0 || w1 + w2 > 1) continue;
        Cover& cover =
            covers[static_cast<std::size_t>(y) * static_cast<std::size_t>(size) + static_cast<std::size_t>(x)];
        if (cover.face != kNoFace) continue;
        cover.face = static_cast<std::uint32_t>(f);
        cover.weights = {static_cast<float>(1 - w1 - w2), static_cast<float>(w1), static_cast<float>(w2)};
      }
    }
  }
  return covers;
}

Eigen::RowVector3f value_at(const Positions& values, const Faces& faces, std::uint32_t face, const float* weights) {
  return weights[0] * values.row(faces(face, 0)) + weights[1] * values.row(faces(face, 1)) +
         weights[2] * values.row(faces(face, 2));
}

/// The direction of growing u at every material coordinate: of its faces, by their area.
Positions tangents(const Topology& mesh, const Positions& positions) {
  Positions out = Positions::Zero(mesh.uv.rows(), 3);
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    const auto p = [&](Eigen::Index k) { return positions.row(mesh.faces(f, k)); };
    const auto t = [&](Eigen::Index k) { return mesh.uv.row(mesh.uv_faces(f, k)); };
    const Eigen::RowVector3f e1 = p(1) - p(0), e2 = p(2) - p(0);
    const Eigen::RowVector2f d1 = t(1) - t(0), d2 = t(2) - t(0);
    const float turn = d1.x() * d2.y() - d2.x() * d1.y();
    const Eigen::RowVector3f direction = (turn < 0 ? -1.0F : 1.0F) * (d2.y() * e1 - d1.y() * e2);
    const float length = direction.norm(), area = e1.cross(e2).norm();
    if (!(length > 0)) continue;
    for (Eigen::Index k = 0; k < 3; ++k) out.row(mesh.uv_faces(f, k)) += area / length * direction;
  }
  return out;
}

std::uint16_t encoded(float value) {
  return static_cast<std::uint16_t>(std::lround(std::clamp(0.5F * value + 0.5F, 0.0F, 1.0F) * 65535.0F));
}

}  // namespace

DetailMaps::DetailMaps(const ExportInput& input, int size)
    : size_(size), fine_faces_(input.topology.faces), mesh_(input.coarse->topology) {
  if (size < 16 || size > kMaxMapSize)
    throw_invalid_argument("maps of " + std::to_string(size) + " texels: 16 to " + std::to_string(kMaxMapSize));
  Uv fine_uv = input.topology.uv;
  if (fine_uv.rows() == 0 || mesh_.uv.rows() == 0)
    throw_invalid_argument(input.name + ": maps need material coordinates");
  const Eigen::RowVector2f low = mesh_.uv.colwise().minCoeff();
  const float extent = (mesh_.uv.colwise().maxCoeff() - low).maxCoeff();
  if (!(extent > 0)) throw_invalid_argument(input.name + ": its material coordinates have no extent");
  for (Uv* uv : {&mesh_.uv, &fine_uv}) {
    for (auto row : uv->rowwise())
      row = Eigen::RowVector2f::Constant(kBorder) + (1 - 2 * kBorder) / extent * (row - low);
  }

  const std::vector<Cover> coarse = rasterize(mesh_.uv, mesh_.uv_faces, size),
                           fine = rasterize(fine_uv, input.topology.uv_faces, size);
  std::vector<std::uint32_t> nearest(coarse.size(), kNoFace);  // the texel whose values it has
  std::vector<std::uint32_t> front;
  for (std::uint32_t place = 0; place < coarse.size(); ++place) {
    if (coarse[place].face == kNoFace || fine[place].face == kNoFace) continue;
    Texel texel{place, coarse[place].face, fine[place].face, {}, {}};
    std::copy(coarse[place].weights.begin(), coarse[place].weights.end(), texel.coarse);
    std::copy(fine[place].weights.begin(), fine[place].weights.end(), texel.fine);
    texels_.push_back(texel);
    nearest[place] = place;
    front.push_back(place);
  }
  const auto width = static_cast<std::uint32_t>(size);
  for (int ring = 0; ring < kPadding; ++ring) {
    std::vector<std::uint32_t> next;
    for (const std::uint32_t place : front) {
      const std::uint32_t x = place % width, y = place / width;
      const auto take = [&](std::uint32_t other) {
        if (nearest[other] != kNoFace) return;
        nearest[other] = nearest[place];
        copies_.emplace_back(other, nearest[place]);
        next.push_back(other);
      };
      if (x > 0) take(place - 1);
      if (x + 1 < width) take(place + 1);
      if (y > 0) take(place - width);
      if (y + 1 < width) take(place + width);
    }
    front = std::move(next);
  }
}

DetailMaps::Images DetailMaps::at(const Positions& coarse, const Positions& fine) const {
  const std::size_t values = 3 * static_cast<std::size_t>(size_) * static_cast<std::size_t>(size_);
  Images images{size_, std::vector<float>(values, 0), std::vector<std::uint16_t>(values, encoded(0))};
  for (std::size_t i = 2; i < values; i += 3) images.normal[i] = encoded(1);

  const Positions coarse_normals = vertex_normals(coarse, mesh_.faces),
                  fine_normals = vertex_normals(fine, fine_faces_), directions = tangents(mesh_, coarse);
  for (const Texel& texel : texels_) {
    const Eigen::RowVector3f move = value_at(fine, fine_faces_, texel.fine_face, texel.fine) -
                                    value_at(coarse, mesh_.faces, texel.coarse_face, texel.coarse);
    const Eigen::RowVector3f n = value_at(coarse_normals, mesh_.faces, texel.coarse_face, texel.coarse).normalized();
    Eigen::RowVector3f t = value_at(directions, mesh_.uv_faces, texel.coarse_face, texel.coarse);
    t = (t - t.dot(n) * n).normalized();
    const Eigen::RowVector3f b = n.cross(t);
    const Eigen::RowVector3f normal = value_at(fine_normals, fine_faces_, texel.fine_face, texel.fine).normalized();
    const Eigen::RowVector3f local(normal.dot(t), normal.dot(b), normal.dot(n));
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      const std::size_t i = 3 * std::size_t{texel.place} + static_cast<std::size_t>(axis);
      images.displacement[i] = move(axis);
      if (std::isfinite(local(axis))) images.normal[i] = encoded(local(axis));
    }
  }
  for (const auto& [to, from] : copies_) {
    for (std::size_t k = 0; k < 3; ++k) {
      images.displacement[3 * std::size_t{to} + k] = images.displacement[3 * std::size_t{from} + k];
      images.normal[3 * std::size_t{to} + k] = images.normal[3 * std::size_t{from} + k];
    }
  }
  return images;
}

}  // namespace pleat::presentation
