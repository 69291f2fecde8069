#include "services/conversion/vertex_features/one_rings.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/conversion/vertex_features/vectors.hpp"

namespace pleat::conversion {
namespace {

constexpr double kNormalShare = 0.3;

Eigen::Vector3d point(const Positions& positions, std::uint32_t v) { return positions.row(v).cast<double>(); }

double cotangent(const Eigen::Vector3d& apex, const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  const Eigen::Vector3d u = a - apex, v = b - apex;
  return u.dot(v) / u.cross(v).norm();
}

double edge_weight(const Positions& rest, const Edge& edge) {
  const Eigen::Vector3d a = point(rest, edge.v0), b = point(rest, edge.v1);
  double c = cotangent(point(rest, edge.opposite0), a, b) / 2;
  if (edge.f1 != kNone) c += cotangent(point(rest, edge.opposite1), a, b) / 2;
  const double w = c <= 0 ? std::sqrt(std::exp(c)) : std::sqrt(1 + c);
  return std::isfinite(w) && w <= 1e5 ? w : 1;
}

// An (a, b) for each face (vertex, a, b).
using Corners = std::vector<std::array<std::uint32_t, 2>>;

std::vector<Corners> corners_of(const Topology& topology) {
  std::vector<Corners> corners(static_cast<std::size_t>(topology.vertex_count()));
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      corners[topology.faces(f, k)].push_back({topology.faces(f, (k + 1) % 3), topology.faces(f, (k + 2) % 3)});
    }
  }
  return corners;
}

}  // namespace

Eigen::Matrix3f GradientField::at(std::size_t vertex) const {
  Eigen::Matrix3f gradient;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) gradient(r, c) = columns[vertex][static_cast<std::size_t>(c)][r];
  }
  return gradient;
}

void GradientField::set(std::size_t vertex, const Eigen::Matrix3f& gradient) {
  for (int c = 0; c < 3; ++c) columns[vertex][static_cast<std::size_t>(c)] = to_float4(gradient.col(c));
}

struct OneRings::Ring {
  struct Place {
    std::uint32_t vertex;
    bool counts, corner;
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
  };
  std::vector<Place> places;
  Eigen::Vector3d h = Eigen::Vector3d::Zero();
  double neighbours = 0;

  // The faces as fans: open ones begin where no face ends. A vertex may have several.
  explicit Ring(Corners corners) {
    while (!corners.empty()) {
      const auto open = std::find_if(corners.begin(), corners.end(), [&](const auto& face) {
        return std::none_of(corners.begin(), corners.end(), [&](const auto& other) { return other[1] == face[0]; });
      });
      auto next = open != corners.end() ? open : corners.begin();
      const std::uint32_t start = (*next)[0];
      for (std::uint32_t at = start; next != corners.end();) {
        places.push_back({at, true, true});
        at = (*next)[1];
        corners.erase(next);
        next = std::find_if(corners.begin(), corners.end(), [&](const auto& face) { return face[0] == at; });
        if (at == start) next = corners.end();
        if (next == corners.end()) places.push_back({at, at != start, false});
      }
    }
    for (const Place& place : places) neighbours += place.counts ? 1 : 0;
  }
};

OneRings::OneRings(const Topology& topology, const std::string& name)
    : vertex_count_(static_cast<std::size_t>(topology.vertex_count())), rest_positions_(topology.rest_positions) {
  validate_topology(topology, name);
  weigh_edges(topology);
  std::vector<std::vector<std::pair<std::uint32_t, double>>> weights(vertex_count_);
  for (const WeightedEdge& e : edges_) {
    weights[e.a].emplace_back(e.b, static_cast<double>(e.weight));
    weights[e.b].emplace_back(e.a, static_cast<double>(e.weight));
  }
  const auto refuse = [&](std::size_t vertex, const char* what) {
    throw_invalid_argument(name + ": vertex " + std::to_string(vertex) + ' ' + what);
  };
  const std::vector<Corners> corners = corners_of(topology);
  std::vector<Ring> rings;
  rings.reserve(vertex_count_);
  for (std::size_t v = 0; v < vertex_count_; ++v) {
    if (corners[v].empty()) refuse(v, "belongs to no face: it has no features");
    const Eigen::Vector3d centre = point(rest_positions_, static_cast<std::uint32_t>(v));
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    for (const auto& face : corners[v]) {
      normal += (point(rest_positions_, face[0]) - centre).cross(point(rest_positions_, face[1]) - centre).normalized();
    }
    double length = 0;
    Eigen::Matrix3d c = Eigen::Matrix3d::Zero();
    for (const auto& [j, w] : weights[v]) {
      const Eigen::Vector3d r = point(rest_positions_, j) - centre;
      length += r.norm();
      c += w * r * r.transpose();
    }
    Ring ring(corners[v]);
    normal = normal.normalized() * kNormalShare * length / ring.neighbours;
    c += normal * normal.transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> spectrum(c, Eigen::EigenvaluesOnly);
    if (!(spectrum.eigenvalues()(0) > std::max(1e-10 * spectrum.eigenvalues()(2), 1e-18))) {
      refuse(v, "has a collapsed one-ring at rest: its faces have no area");
    }
    const Eigen::Matrix3d inverse = c.inverse();
    ring.h = inverse * normal;
    for (Ring::Place& place : ring.places) {
      if (!place.counts) continue;
      const auto edge = std::find_if(weights[v].begin(), weights[v].end(),
                                     [&](const auto& weight) { return weight.first == place.vertex; });
      place.g = edge->second * inverse * (point(rest_positions_, place.vertex) - centre);
    }
    rings.push_back(std::move(ring));
  }
  for (std::size_t v = 0; v < vertex_count_; v += kRingPack) add_pack(rings, v);
}

void OneRings::weigh_edges(const Topology& topology) {
  for (const Edge& e : build_connectivity(topology.vertex_count(), topology.faces).edges) {
    edges_.push_back({e.v0, e.v1, static_cast<float>(edge_weight(rest_positions_, e))});
  }
}

void OneRings::add_pack(const std::vector<Ring>& rings, std::size_t first_vertex) {
  const auto vertex_of = [&](std::size_t lane) { return std::min(first_vertex + lane, vertex_count_ - 1); };
  Pack pack{};
  pack.first = static_cast<std::uint32_t>(entries_.size());
  for (std::size_t lane = 0; lane < kRingPack; ++lane) {
    const Ring& ring = rings[vertex_of(lane)];
    const auto l = static_cast<int>(lane);
    pack.centre[lane] = static_cast<std::uint32_t>(vertex_of(lane));
    pack.hx[l] = static_cast<float>(ring.h.x());
    pack.hy[l] = static_cast<float>(ring.h.y());
    pack.hz[l] = static_cast<float>(ring.h.z());
    pack.normal_scale[l] = static_cast<float>(kNormalShare / ring.neighbours);
    pack.count = std::max(pack.count, static_cast<std::uint32_t>(ring.places.size()));
  }
  for (std::size_t place = 0; place < pack.count; ++place) {
    Entry entry{};
    for (std::size_t lane = 0; lane < kRingPack; ++lane) {
      const auto& places = rings[vertex_of(lane)].places;
      entry.vertex[lane] = pack.centre[lane];
      if (place >= places.size()) continue;
      const auto l = static_cast<int>(lane);
      entry.vertex[lane] = places[place].vertex;
      entry.gx[l] = static_cast<float>(places[place].g.x());
      entry.gy[l] = static_cast<float>(places[place].g.y());
      entry.gz[l] = static_cast<float>(places[place].g.z());
      entry.counts[l] = places[place].counts ? 1 : 0;
      entry.corner[l] = places[place].corner ? 1 : 0;
    }
    entries_.push_back(entry);
  }
  packs_.push_back(pack);
}

Matrix8 OneRings::gradients(std::size_t pack_index, const Float4* positions) const {
  const Pack& pack = packs_[pack_index];
  const auto edge = [&](const Entry& entry) {
    Float4 rows[kRingPack];
    for (std::size_t k = 0; k < kRingPack; ++k) rows[k] = positions[entry.vertex[k]] - positions[pack.centre[k]];
    Float8 columns[4];
    transpose(rows, columns);
    return Vector8{columns[0], columns[1], columns[2]};
  };
  const Float8 tiny = broadcast8(1e-30f);
  Vector8 tx{}, ty{}, tz{}, normal{};
  Float8 length{};
  const Entry* entry = entries_.data() + pack.first;
  Vector8 e = edge(*entry);
  for (const Entry* const end = entry + pack.count; entry < end; ++entry) {
    const Vector8 next = entry + 1 < end ? edge(entry[1]) : e;
    const Vector8 g{entry->gx, entry->gy, entry->gz};
    tx = tx + e.x * g;
    ty = ty + e.y * g;
    tz = tz + e.z * g;
    length += entry->counts * sqrt(dot(e, e));
    const Vector8 area = cross(e, next);
    normal = normal + (entry->corner / sqrt(max(dot(area, area), tiny))) * area;
    e = next;
  }
  const Vector8 m = (pack.normal_scale * length / sqrt(max(dot(normal, normal), tiny))) * normal;
  const Vector8 h{pack.hx, pack.hy, pack.hz};
  tx = tx + m.x * h;
  ty = ty + m.y * h;
  tz = tz + m.z * h;
  return {tx.x, tx.y, tx.z, ty.x, ty.y, ty.z, tz.x, tz.y, tz.z};
}

void OneRings::gradients(const Float4* positions, GradientField& field) const {
  field.columns.resize(vertex_count_);
  for (std::size_t pack = 0; pack < packs_.size(); ++pack) {
    store_gradients(gradients(pack, positions), pack * kRingPack, field);
  }
}

void load_positions(const Positions& positions, std::size_t vertex_count, float angle, const Eigen::Vector3f& origin,
                    const std::string& name, std::vector<Float4>& to) {
  if (static_cast<std::size_t>(positions.rows()) != vertex_count) {
    throw_invalid_argument(name + ": " + std::to_string(positions.rows()) + " positions for " +
                           std::to_string(vertex_count) + " vertices");
  }
  const float c = std::cos(angle), s = std::sin(angle);
  to.resize(vertex_count);
  bool usable = true;
  for (std::size_t v = 0; v < vertex_count; ++v) {
    const float* p = positions.data() + 3 * v;
    const float x = p[0] - origin.x(), y = p[1] - origin.y(), z = p[2] - origin.z();
    to[v] = Float4{c * x + s * z, y, c * z - s * x, 0};
    usable = usable && std::abs(x) + std::abs(y) + std::abs(z) < 1e6f;  // false for NaN
  }
  if (usable) return;
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    if (!((positions.row(v) - origin.transpose()).lpNorm<1>() < 1e6f)) {
      throw_invalid_argument(name + ": the position of vertex " + std::to_string(v) + " is not finite or too far away");
    }
  }
}

}  // namespace pleat::conversion
