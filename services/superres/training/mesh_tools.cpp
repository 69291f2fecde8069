#include "services/superres/training/mesh_tools.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <span>
#include <variant>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/conversion/geometry_image/detail_image.hpp"
#include "services/conversion/vertex_features/rotation_labels.hpp"

namespace pleat::superres {
namespace {

double mean_square(const Positions& a, const Positions& b) {
  return (a - b).cast<double>().squaredNorm() / static_cast<double>(a.rows());
}

Positions upsampled(const conversion::Representation& representation, const Positions& coarse) {
  return upsample(representation.subdivision(), representation.coarse().faces, coarse);
}

}  // namespace

void FrameMeshes::add(std::size_t sequence, std::size_t frame, SharedRepresentation representation, Positions coarse,
                      Positions fine) {
  const RigidTransform alignment = representation->align(coarse);
  meshes_[{sequence, frame}] = {std::move(coarse), std::move(fine), alignment, std::move(representation)};
}

const FrameMeshes::Meshes& FrameMeshes::at(std::size_t sequence, std::size_t frame) const {
  const auto it = meshes_.find({sequence, frame});
  if (it == meshes_.end()) throw_internal("training: no meshes of frame " + std::to_string(frame));
  return it->second;
}

void FrameMeshes::axes(std::size_t sequence, std::size_t frame, Tensor& axes) const {
  const Meshes& meshes = at(sequence, frame);
  meshes.representation->answer_axes(meshes.coarse, meshes.alignment, axes);
}

void FrameMeshes::base(std::size_t sequence, std::size_t frame, Positions& positions) const {
  const Meshes& meshes = at(sequence, frame);
  meshes.representation->base(meshes.coarse, meshes.alignment, positions);
}

const FrameMeshes::Meshes& FrameJudge::validated(std::size_t sequence, std::size_t frame) const {
  const FrameMeshes::Meshes& meshes = meshes_->at(sequence, frame);
  if (meshes.fine.rows() == 0) throw_internal("judge: not a validation frame");
  return meshes;
}

double FrameJudge::squared_error(std::size_t sequence, std::size_t frame, std::span<const float> answer) {
  const FrameMeshes::Meshes& meshes = validated(sequence, frame);
  const conversion::Representation& representation = *meshes.representation;
  Tensor tensor{representation.answer_shape(), {}, {answer.begin(), answer.end()}};
  denormalize(meshes_->output(), tensor);
  Positions fine;
  representation.decode(tensor, meshes.coarse, meshes.alignment, fine);
  return mean_square(fine, meshes.fine);
}

double FrameJudge::barycentric_squared_error(std::size_t sequence, std::size_t frame) {
  const FrameMeshes::Meshes& meshes = validated(sequence, frame);
  return mean_square(upsampled(*meshes.representation, meshes.coarse), meshes.fine);
}

std::vector<float> FrameJudge::barycentric_answer(std::size_t sequence, std::size_t frame) {
  const FrameMeshes::Meshes& meshes = validated(sequence, frame);
  Frame coarse, fine;
  coarse.positions = meshes.coarse;
  fine.positions = upsampled(*meshes.representation, meshes.coarse);
  Tensor answer;
  meshes.representation->target(coarse, fine, meshes.alignment, answer);
  normalize(meshes_->output(), answer);
  return std::move(answer.values);
}

MeshRead make_mesh_read(const conversion::Representation& representation) {
  const conversion::VertexReads& reads = representation.reads();
  const Topology& fine = representation.fine();
  MeshRead result;
  if (const auto* image = std::get_if<conversion::GeometryImageSpec>(&representation.spec().kind);
      image != nullptr && image->layout == conversion::ImageLayout::kDetail) {
    result.unit_m = conversion::detail_unit(representation.coarse(), image->units).answers.front();
  }
  const auto vertices = static_cast<std::size_t>(fine.vertex_count());
  std::size_t most = 1;
  for (std::size_t v = 0; v < vertices; ++v) {
    most = std::max<std::size_t>(most, reads.offsets[v + 1] - reads.offsets[v]);
  }
  result.texels.assign(most * vertices, 0);
  result.weights.assign(most * vertices, 0.0F);
  for (std::size_t v = 0; v < vertices; ++v) {
    for (std::size_t i = reads.offsets[v]; i < reads.offsets[v + 1]; ++i) {
      const std::size_t place = (i - reads.offsets[v]) * vertices + v;
      result.texels[place] = reads.places[i];
      result.weights[place] = reads.weights[i];
    }
  }
  // Column by column.
  const auto rest = fine.rest_positions.reshaped<Eigen::ColMajor>();
  const auto faces = fine.faces.reshaped<Eigen::ColMajor>();
  result.rest.assign(rest.begin(), rest.end());
  result.faces.assign(faces.begin(), faces.end());
  std::vector<std::int64_t> ends;
  for (const Edge& edge : build_connectivity(fine.vertex_count(), fine.faces).edges) {
    if (fine.rest_positions.row(edge.v0) == fine.rest_positions.row(edge.v1)) continue;
    result.edges.push_back(edge.v0);
    ends.push_back(edge.v1);
  }
  result.edges.insert(result.edges.end(), ends.begin(), ends.end());
  return result;
}

namespace {

PlaceMap ring_of(const Topology& mesh) {
  std::vector<std::vector<std::int64_t>> neighbours(static_cast<std::size_t>(mesh.vertex_count()));
  for (const Edge& edge : build_connectivity(mesh.vertex_count(), mesh.faces).edges) {
    neighbours[edge.v0].push_back(edge.v1);
    neighbours[edge.v1].push_back(edge.v0);
  }
  PlaceMap map;
  map.columns = mesh.vertex_count();
  for (const auto& own : neighbours) map.add(own);
  return map;
}

}  // namespace

std::shared_ptr<const MeshPorts> make_mesh_ports(const conversion::Representation& representation) {
  const auto* spec = std::get_if<conversion::VertexFeatureSpec>(&representation.spec().kind);
  if (spec == nullptr) return nullptr;
  constexpr int kCorners = 3;
  auto ports = std::make_shared<MeshPorts>();
  ports->corners = kCorners;
  ports->features = conversion::rotation_channels(spec->rotation) + 6;
  const Topology &coarse = representation.coarse(), &fine = representation.fine();
  std::vector<std::int64_t> corner(static_cast<std::size_t>(coarse.vertex_count()), -1);
  for (Eigen::Index face = 0; face < coarse.face_count(); ++face) {
    for (Eigen::Index k = 0; k < kCorners; ++k) {
      std::int64_t& place = corner[coarse.faces(face, k)];
      if (place < 0) place = k * coarse.face_count() + face;
    }
  }
  ports->coarse.columns = kCorners * coarse.face_count();
  for (const std::int64_t place : corner) ports->coarse.add({place});
  ports->coarse_ring = ring_of(coarse);
  ports->fine_ring = ring_of(fine);

  const conversion::VertexReads& reads = representation.reads();
  const auto places = representation.answer_mask().size();
  std::vector<std::int64_t> vertex(places, -1);
  ports->fine.columns = static_cast<std::int64_t>(places);
  for (std::size_t v = 0; v + 1 < reads.offsets.size(); ++v) {
    const auto own = std::span(reads.places).subspan(reads.offsets[v], reads.offsets[v + 1] - reads.offsets[v]);
    ports->fine.add({own.begin(), own.end()});
    for (const std::uint32_t place : own) vertex[place] = static_cast<std::int64_t>(v);
  }
  ports->fine_read.columns = fine.vertex_count();
  for (const std::int64_t v : vertex) ports->fine_read.add(v < 0 ? std::vector<std::int64_t>{} : std::vector{v});
  return ports;
}

std::vector<std::array<float, 3>> flat_sheet_axes(const Topology& mesh) {
  const Eigen::Index corners = mesh.uv_faces.size();
  Eigen::MatrixX3d a(corners, 3), x(corners, 3);
  for (Eigen::Index i = 0; i < corners; ++i) {
    const auto uv = mesh.uv.row(mesh.uv_faces.data()[i]).cast<double>();
    a.row(i) << uv[0], uv[1], 1;
    x.row(i) = mesh.rest_positions.row(mesh.faces.data()[i]).cast<double>();
  }
  const Eigen::Matrix3d solution = (a.transpose() * a).ldlt().solve(a.transpose() * x);
  const double extent = (mesh.uv.colwise().maxCoeff() - mesh.uv.colwise().minCoeff()).norm();
  if ((a * solution - x).cwiseAbs().maxCoeff() > 1e-4 * extent) return {};
  const Eigen::Vector3d u = solution.row(0), v = solution.row(1);
  if (std::abs(u.dot(v)) > 1e-4 * u.norm() * v.norm()) return {};
  const auto to_array = [](const Eigen::Vector3d& d) {
    return std::array<float, 3>{static_cast<float>(d[0]), static_cast<float>(d[1]), static_cast<float>(d[2])};
  };
  return {to_array(u), to_array(v)};
}

}  // namespace pleat::superres
