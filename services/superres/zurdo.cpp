#include "services/superres/zurdo.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::superres {
namespace {

constexpr int kMostRounds = 5;

using Frames = std::vector<Eigen::Matrix3f>;  ///< columns: along u, across it, normal

Subdivision subdivision_of(const MeshPair& mesh) {
  for (int rounds = 0; rounds <= kMostRounds; ++rounds) {
    Subdivision subdivision = subdivide(mesh.coarse, rounds);
    if (subdivision.fine.vertex_count() == mesh.fine.vertex_count()) return subdivision;
    if (subdivision.fine.vertex_count() > mesh.fine.vertex_count()) break;
  }
  throw_invalid_argument("examples of wrinkles: the fine mesh is not the coarse one subdivided");
}

}  // namespace

struct ZurdoWrinkles::State {
  MeshPair mesh;
  ZurdoOptions options;
  Subdivision subdivision;
  Connectivity connectivity;
  std::vector<double> rest_lengths;
  struct Near {
    std::uint32_t edge;
    float weight;  ///< of one coarse vertex sum to 1
  };
  std::vector<std::vector<Near>> near;       ///< per coarse vertex
  std::vector<Eigen::Vector3d> direction_u;  ///< per coarse face: barycentric gradient of u, for the frames

  std::vector<std::size_t> chosen;
  Eigen::MatrixXf ratios;              ///< (edges x examples)
  std::vector<Eigen::MatrixXf> solve;  ///< per coarse vertex: (examples x examples + 1): weights from kernels and 1
  std::vector<Eigen::Matrix3Xf> displacements;  ///< per fine vertex: (3 x examples), in its frame

  State(const MeshPair& pair, const ZurdoOptions& o) : mesh(pair), options(o), subdivision(subdivision_of(pair)) {
    if (o.examples < 1 || o.rings < 1 || o.rings > 8 || !(o.smoothness >= 0)) {
      throw_invalid_argument("examples of wrinkles: options out of range");
    }
    connectivity = build_connectivity(mesh.coarse.vertex_count(), mesh.coarse.faces);
    for (const Edge& edge : connectivity.edges) {
      rest_lengths.push_back(
          (mesh.coarse.rest_positions.row(edge.v0) - mesh.coarse.rest_positions.row(edge.v1)).cast<double>().norm());
    }
    find_near_edges();
    find_directions();
  }

  std::size_t edges() const { return connectivity.edges.size(); }

  /// Edges within the rings; one that begins r steps away weighs exp(-(r / (rings / 2))^2).
  void find_near_edges() {
    const auto vertices = static_cast<std::size_t>(mesh.coarse.vertex_count());
    std::vector<std::vector<std::uint32_t>> at(vertices);
    for (std::uint32_t e = 0; e < edges(); ++e) {
      at[connectivity.edges[e].v0].push_back(e);
      at[connectivity.edges[e].v1].push_back(e);
    }
    near.resize(vertices);
    for (std::uint32_t v = 0; v < vertices; ++v) {
      std::vector<std::uint32_t> front{v}, seen_edges;
      std::vector<bool> visited(vertices, false);
      visited[v] = true;
      double sum = 0;
      for (int ring = 0; ring < options.rings; ++ring) {
        const double distance = 2.0 * ring / options.rings;
        const auto weight = static_cast<float>(std::exp(-distance * distance));
        std::vector<std::uint32_t> next;
        for (const std::uint32_t u : front) {
          for (const std::uint32_t e : at[u]) {
            if (std::find(seen_edges.begin(), seen_edges.end(), e) != seen_edges.end()) continue;
            seen_edges.push_back(e);
            near[v].push_back({e, weight});
            sum += static_cast<double>(weight);
            const Edge& edge = connectivity.edges[e];
            for (const std::uint32_t end : {edge.v0, edge.v1}) {
              if (!visited[end]) next.push_back(end);
              visited[end] = true;
            }
          }
        }
        front = std::move(next);
      }
      for (Near& entry : near[v]) entry.weight /= static_cast<float>(sum);
    }
  }

  void find_directions() {
    const Topology& coarse = mesh.coarse;
    if (coarse.uv_faces.rows() != coarse.faces.rows()) {
      throw_invalid_argument("examples of wrinkles: the coarse mesh has no material coordinates");
    }
    for (Eigen::Index f = 0; f < coarse.faces.rows(); ++f) {
      Eigen::Matrix3d corners;
      for (int k = 0; k < 3; ++k) {
        corners.row(k) << coarse.uv.row(coarse.uv_faces(f, k)).cast<double>(), 1;
      }
      // Positions are p = sum_k p_k b_k(u, v), with b = (u, v, 1) corners^-1.
      const Eigen::Vector3d gradient = corners.inverse().row(0).transpose();
      direction_u.push_back(gradient.allFinite() ? gradient : Eigen::Vector3d(-1, 1, 0));
    }
  }

  std::vector<float> edge_ratios(const Positions& coarse) const {
    if (coarse.rows() != mesh.coarse.vertex_count()) {
      throw_invalid_argument("examples of wrinkles: a coarse frame has " + std::to_string(coarse.rows()) +
                             " vertices, not " + std::to_string(mesh.coarse.vertex_count()));
    }
    std::vector<float> result(edges());
    for (std::size_t e = 0; e < edges(); ++e) {
      const Edge& edge = connectivity.edges[e];
      const double length = (coarse.row(edge.v0) - coarse.row(edge.v1)).cast<double>().norm();
      result[e] = static_cast<float>(rest_lengths[e] > 0 ? length / rest_lengths[e] : 1.0);
    }
    return result;
  }

  /// Frames of the fine vertices on the upsampled surface: from coarse frames, blended and made orthonormal.
  Frames frames(const Positions& coarse) const {
    const Positions normals = vertex_normals(coarse, mesh.coarse.faces);
    Positions along = Positions::Zero(coarse.rows(), 3);
    for (Eigen::Index f = 0; f < mesh.coarse.faces.rows(); ++f) {
      const Eigen::Vector3d& g = direction_u[static_cast<std::size_t>(f)];
      Eigen::RowVector3f direction = Eigen::RowVector3f::Zero();
      for (int k = 0; k < 3; ++k) direction += static_cast<float>(g[k]) * coarse.row(mesh.coarse.faces(f, k));
      for (int k = 0; k < 3; ++k) along.row(mesh.coarse.faces(f, k)) += direction;
    }
    const Positions n = upsample(subdivision, mesh.coarse.faces, normals);
    const Positions u = upsample(subdivision, mesh.coarse.faces, along);
    Frames result(static_cast<std::size_t>(n.rows()));
    for (Eigen::Index v = 0; v < n.rows(); ++v) {
      Eigen::Vector3f normal = n.row(v).transpose();
      if (normal.squaredNorm() < 1e-12F) normal = Eigen::Vector3f::UnitY();
      normal.normalize();
      Eigen::Vector3f first = u.row(v).transpose();
      first -= first.dot(normal) * normal;
      if (first.squaredNorm() < 1e-12F) first = normal.unitOrthogonal();
      first.normalize();
      result[static_cast<std::size_t>(v)] << first, normal.cross(first), normal;
    }
    return result;
  }

  /// Squared distances of a pose to the first `count` examples at every coarse vertex: (examples x V_coarse).
  Eigen::MatrixXf distances(const std::vector<float>& pose, Eigen::Index count) const {
    const Eigen::Map<const Eigen::VectorXf> own(pose.data(), static_cast<Eigen::Index>(pose.size()));
    // (examples x edges), so that the sums run over whole columns.
    const Eigen::MatrixXf squares = (ratios.leftCols(count).colwise() - own).array().square().matrix().transpose();
    Eigen::MatrixXf result = Eigen::MatrixXf::Zero(count, static_cast<Eigen::Index>(near.size()));
    for (std::size_t v = 0; v < near.size(); ++v) {
      for (const Near& entry : near[v])
        result.col(static_cast<Eigen::Index>(v)) += entry.weight * squares.col(entry.edge);
    }
    return result;
  }

  void choose(std::size_t count, const std::function<ZurdoPose(std::size_t)>& pose) {
    std::vector<std::vector<float>> all;
    for (std::size_t k = 0; k < count; ++k) all.push_back(edge_ratios(pose(k).coarse));
    std::vector<double> nearest(count, std::numeric_limits<double>::infinity());
    std::size_t next = 0;
    while (chosen.size() < std::min(count, static_cast<std::size_t>(options.examples))) {
      chosen.push_back(next);
      for (std::size_t k = 0; k < count; ++k) {
        double sum = 0;
        for (std::size_t e = 0; e < edges(); ++e) {
          const double d = static_cast<double>(all[k][e]) - static_cast<double>(all[next][e]);
          sum += d * d;
        }
        nearest[k] = std::min(nearest[k], sum);
      }
      next = static_cast<std::size_t>(std::max_element(nearest.begin(), nearest.end()) - nearest.begin());
      if (nearest[next] <= 0) break;  // only copies are left
    }
    ratios.resize(static_cast<Eigen::Index>(edges()), static_cast<Eigen::Index>(chosen.size()));
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      std::copy(all[chosen[i]].begin(), all[chosen[i]].end(), ratios.col(static_cast<Eigen::Index>(i)).data());
    }
  }

  void learn(const std::function<ZurdoPose(std::size_t)>& pose) {
    const auto count = static_cast<Eigen::Index>(chosen.size());
    displacements.assign(static_cast<std::size_t>(mesh.fine.vertex_count()), Eigen::Matrix3Xf(3, count));
    std::vector<Eigen::MatrixXf> kernels(near.size(), Eigen::MatrixXf(count, count));
    for (Eigen::Index i = 0; i < count; ++i) {
      const ZurdoPose example = pose(chosen[static_cast<std::size_t>(i)]);
      if (example.fine.rows() != mesh.fine.vertex_count()) {
        throw_invalid_argument("examples of wrinkles: a fine frame has " + std::to_string(example.fine.rows()) +
                               " vertices, not " + std::to_string(mesh.fine.vertex_count()));
      }
      const Frames axes = frames(example.coarse);
      const Positions base = upsample(subdivision, mesh.coarse.faces, example.coarse);
      for (Eigen::Index v = 0; v < base.rows(); ++v) {
        const auto u = static_cast<std::size_t>(v);
        displacements[u].col(i) = axes[u].transpose() * (example.fine.row(v) - base.row(v)).transpose();
      }
      const std::vector<float> own(ratios.col(i).data(), ratios.col(i).data() + ratios.rows());
      const Eigen::MatrixXf squared = distances(own, count);
      for (std::size_t v = 0; v < near.size(); ++v) {
        kernels[v].col(i) = squared.col(static_cast<Eigen::Index>(v)).cwiseSqrt();
      }
    }
    for (const Eigen::MatrixXf& kernel : kernels) {
      // [K 1; 1' 0] [c; s] = [kernels of a pose; 1] gives weights c that sum to 1 (K is conditionally definite).
      Eigen::MatrixXd system = Eigen::MatrixXd::Zero(count + 1, count + 1);
      system.topLeftCorner(count, count) = kernel.cast<double>();
      const double unit = count > 1 ? kernel.cast<double>().sum() / static_cast<double>(count * (count - 1)) : 1.0;
      // The kernel -|d| is the definite one.
      system.topLeftCorner(count, count).diagonal().array() -= options.smoothness * unit + 1e-12;
      system.col(count).head(count).setOnes();
      system.row(count).head(count).setOnes();
      solve.push_back(system.fullPivLu().inverse().topRows(count).cast<float>());
    }
  }
};

ZurdoWrinkles::ZurdoWrinkles(const MeshPair& mesh, std::size_t count, const std::function<ZurdoPose(std::size_t)>& pose,
                             const ZurdoOptions& options)
    : state_(std::make_unique<State>(mesh, options)) {
  if (count == 0) throw_invalid_argument("examples of wrinkles: no poses");
  state_->choose(count, pose);
  state_->learn(pose);
}

ZurdoWrinkles::~ZurdoWrinkles() = default;
ZurdoWrinkles::ZurdoWrinkles(ZurdoWrinkles&&) noexcept = default;
ZurdoWrinkles& ZurdoWrinkles::operator=(ZurdoWrinkles&&) noexcept = default;

const std::vector<std::size_t>& ZurdoWrinkles::examples() const { return state_->chosen; }

Positions ZurdoWrinkles::synthesize(const Positions& coarse) const {
  const State& s = *state_;
  const auto count = static_cast<Eigen::Index>(s.chosen.size());
  const Eigen::MatrixXf squared = s.distances(s.edge_ratios(coarse), count);
  Eigen::MatrixXf weights(count, squared.cols());
  Eigen::VectorXf kernels(count + 1);
  for (Eigen::Index v = 0; v < squared.cols(); ++v) {
    kernels << squared.col(v).cwiseSqrt(), 1.0F;
    weights.col(v) = s.solve[static_cast<std::size_t>(v)] * kernels;
  }
  const Frames axes = s.frames(coarse);
  Positions result = upsample(s.subdivision, s.mesh.coarse.faces, coarse);
  Eigen::VectorXf blended(count);
  for (Eigen::Index v = 0; v < result.rows(); ++v) {
    const auto u = static_cast<std::size_t>(v);
    const auto parent = static_cast<Eigen::Index>(s.subdivision.parent_face[u]);
    blended.setZero();
    for (int k = 0; k < 3; ++k) {
      const float share = s.subdivision.barycentric(v, k);
      if (share != 0) blended += share * weights.col(s.mesh.coarse.faces(parent, k));
    }
    result.row(v) += (axes[u] * (s.displacements[u] * blended)).transpose();
  }
  return result;
}

ZurdoWrinkles train_zurdo(const DatasetReader& dataset, const ZurdoOptions& options, std::size_t most) {
  std::vector<std::pair<std::string, std::uint64_t>> frames;
  for (const SequenceInfo& sequence : dataset.sequences()) {
    if (sequence.split != "train") continue;
    if (sequence.own_meshes) {
      throw_invalid_argument(dataset.folder().string() + ": sequence " + sequence.name +
                             " has meshes of its own; examples are of one mesh");
    }
    for (std::uint64_t k = 0; k < sequence.frames_complete; ++k) frames.emplace_back(sequence.name, k);
  }
  if (frames.empty()) throw_not_found(dataset.folder().string() + ": no frames in the split 'train'");
  const std::size_t stride = (frames.size() + most - 1) / most, count = (frames.size() + stride - 1) / stride;
  return ZurdoWrinkles(
      dataset.topology(), count,
      [&](std::size_t k) {
        const auto& [name, frame] = frames[k * stride];
        return ZurdoPose{std::move(dataset.coarse(name, frame, frame + 1).at(0)),
                         std::move(dataset.fine(name, frame, frame + 1).at(0))};
      },
      options);
}

}  // namespace pleat::superres
