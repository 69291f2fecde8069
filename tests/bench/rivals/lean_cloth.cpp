#include "tests/bench/rivals/lean_cloth.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <thread>

#include "common/mesh/connectivity.hpp"

namespace pleat::bench {
namespace {

float squared(Float4 d) { return d[0] * d[0] + d[1] * d[1] + d[2] * d[2]; }

// 2D Young's modulus (N/m) for isotropic springs: the mean of warp and weft without strain, with the engine's factor 2.
double young_modulus(const simulation::Scene& scene) {
  const auto& row = scene.material.stretching[0];
  return scene.stretching_multiplier * (row[0] + row[2]);
}

}  // namespace

LeanCloth::LeanCloth(const simulation::Scene& scene, const Topology& garment, const Positions& start,
                     const LeanOptions& options)
    : options_(options),
      h_(static_cast<float>(scene.frame_time_s / options.substeps)),
      radius2_(static_cast<float>(options.radius_m * options.radius_m)),
      gravity_(to_float4(scene.gravity)),
      barrier_(static_cast<std::ptrdiff_t>(options.threads)) {
  // The order along the sheet's longer side: parts are strips, and neighbours are near each other in memory.
  const auto vertices = static_cast<std::uint32_t>(garment.vertex_count());
  const Eigen::RowVector3f size =
      garment.rest_positions.colwise().maxCoeff() - garment.rest_positions.colwise().minCoeff();
  Eigen::Index axis = 0;
  size.maxCoeff(&axis);
  order_.resize(vertices);
  std::iota(order_.begin(), order_.end(), 0u);
  std::stable_sort(order_.begin(), order_.end(), [&](std::uint32_t a, std::uint32_t b) {
    return garment.rest_positions(a, axis) < garment.rest_positions(b, axis);
  });
  std::vector<std::uint32_t> place(vertices);
  for (std::uint32_t p = 0; p < vertices; ++p) place[order_[p]] = p;

  // One more without mobility, for lanes without spring.
  rest_.assign(vertices + 1, Float4{});
  x_.assign(vertices + 1, Float4{});
  v_.assign(vertices + 1, Float4{});
  inverse_masses_.assign(vertices + 1, 0);
  std::vector<double> masses(vertices, 0);
  for (Eigen::Index f = 0; f < garment.face_count(); ++f) {
    const auto corner = [&](int k) -> Eigen::Vector3d {
      return garment.rest_positions.row(garment.faces(f, k)).cast<double>().transpose();
    };
    const double area = (corner(1) - corner(0)).cross(corner(2) - corner(0)).norm() / 2;
    for (int k = 0; k < 3; ++k) {
      masses[place[garment.faces(f, k)]] += scene.material.density * scene.density_multiplier * area / 3;
    }
  }
  for (std::uint32_t p = 0; p < vertices; ++p) {
    rest_[p] = to_float4(garment.rest_positions.row(order_[p]).transpose());
    x_[p] = to_float4(start.row(order_[p]).transpose());
    v_[p] = to_float4(scene.velocity);
    inverse_masses_[p] = static_cast<float>(1 / masses[p]);
  }
  before_ = x_;
  for (const simulation::Handle& handle : scene.handles) {
    for (const std::uint32_t v : handle.vertices) inverse_masses_[place[v]] = 0;
  }

  // A lattice of equilateral triangles of springs k has the modulus 2 k / sqrt(3). Springs across the edges resist
  // bending; a twentieth of the others.
  const auto stiffness = static_cast<float>(young_modulus(scene) * std::sqrt(3.0) / 2);
  std::vector<Spring> springs;
  const auto add = [&](std::uint32_t a, std::uint32_t b, float k) {
    const std::array<std::uint32_t, 2> ends{std::min(place[a], place[b]), std::max(place[a], place[b])};
    springs.push_back({ends, std::sqrt(squared(rest_[ends[0]] - rest_[ends[1]])), k});
  };
  for (const Edge& edge : build_connectivity(garment.vertex_count(), garment.faces).edges) {
    add(edge.v0, edge.v1, stiffness);
    if (edge.f1 != kNone) add(edge.opposite0, edge.opposite1, stiffness / 20);
  }
  std::stable_sort(springs.begin(), springs.end(), [](const Spring& a, const Spring& b) { return a.v[0] < b.v[0]; });

  const auto threads = static_cast<std::uint32_t>(options.threads);
  std::vector<std::vector<Spring>> own(threads);
  std::vector<Spring> cut;
  for (std::uint32_t t = 0; t < threads; ++t) {
    parts_.push_back({vertices * t / threads, vertices * (t + 1) / threads, {}, {}, {}, 0});
  }
  for (const Spring& spring : springs) {
    const auto inside = [&](const Part& part) { return spring.v[0] >= part.first && spring.v[1] < part.last; };
    const auto part = std::find_if(parts_.begin(), parts_.end(), inside);
    (part == parts_.end() ? cut : own[static_cast<std::size_t>(part - parts_.begin())]).push_back(spring);
  }
  for (std::uint32_t t = 0; t < threads; ++t) parts_[t].springs = pack(own[t]);
  cut_springs_ = pack(cut);
}

std::vector<LeanCloth::Spring8> LeanCloth::pack(const std::vector<Spring>& springs) const {
  std::vector<Spring8> packs;
  for (const auto& members : independent_packs(std::span(springs))) {
    Spring8& pack = packs.emplace_back();
    for (Lanes& lanes : pack.v) lanes.fill(static_cast<std::uint32_t>(order_.size()));
    for (std::size_t lane = 0; lane < members.size(); ++lane) {
      const Spring& spring = springs[members[lane]];
      const auto l = static_cast<int>(lane);
      const float w0 = inverse_masses_[spring.v[0]], w1 = inverse_masses_[spring.v[1]];
      // XPBD with one iteration: lambda starts from 0.
      const float share = 1 / (w0 + w1 + 1 / (spring.stiffness * h_ * h_));
      for (std::size_t k = 0; k < 2; ++k) pack.v[k][lane] = spring.v[k];
      pack.rest[l] = spring.rest;
      pack.share0[l] = share * w0;
      pack.share1[l] = share * w1;
    }
  }
  return packs;
}

void LeanCloth::frame() {
  std::vector<std::jthread> others;
  for (std::size_t part = 1; part < parts_.size(); ++part) others.emplace_back([this, part] { work(part); });
  work(0);
}

void LeanCloth::work(std::size_t index) {
  Part& part = parts_[index];
  const int interval = options_.substeps / options_.detections;
  for (int s = 0; s < options_.substeps; ++s) {
    if (radius2_ > 0 && s % interval == 0) {
      part.fastest = 0;
      for (std::uint32_t p = part.first; p < part.last; ++p) part.fastest = std::max(part.fastest, squared(v_[p]));
      part.fastest = std::sqrt(part.fastest);
      barrier_.arrive_and_wait();
      if (index == 0) sort_into_cells();
      barrier_.arrive_and_wait();
      find_close_pairs(part);
    }
    for (std::uint32_t p = part.first; p < part.last; ++p) {
      before_[p] = x_[p];
      if (inverse_masses_[p] > 0) x_[p] += h_ * (v_[p] + h_ * gravity_);
    }
    solve(part.springs);
    barrier_.arrive_and_wait();
    if (index == 0) {
      solve(cut_springs_);
      for (const Part& any : parts_) separate(any.crossing);
    }
    barrier_.arrive_and_wait();
    separate(part.close);
    const float inverse = 1 / h_;
    for (std::uint32_t p = part.first; p < part.last; ++p) v_[p] = inverse * (x_[p] - before_[p]);
  }
}

void LeanCloth::solve(std::span<const Spring8> springs) {
  for (const Spring8& spring : springs) {
    Float4 rows[kLanes];
    for (std::size_t k = 0; k < kLanes; ++k) rows[k] = x_[spring.v[1][k]] - x_[spring.v[0][k]];
    const Vector8 d = from_rows(rows);
    const Float8 error = 1 - spring.rest / max(sqrt(dot(d, d)), broadcast8(1e-9f));
    const Float8 move0 = error * spring.share0, move1 = error * spring.share1;
    for (std::size_t k = 0; k < kLanes; ++k) {
      const auto lane = static_cast<int>(k);
      x_[spring.v[0][k]] += move0[lane] * rows[k];
      x_[spring.v[1][k]] -= move1[lane] * rows[k];
    }
  }
}

void LeanCloth::separate(std::span<const Pair> pairs) {
  const float radius = std::sqrt(radius2_);
  for (const auto& [a, b] : pairs) {
    const Float4 d = x_[b] - x_[a];
    const float distance2 = squared(d), mobility = inverse_masses_[a] + inverse_masses_[b];
    if (distance2 >= radius2_ || distance2 <= 0 || mobility <= 0) continue;
    const Float4 push = ((radius / std::sqrt(distance2) - 1) / mobility) * d;
    x_[a] -= inverse_masses_[a] * push;
    x_[b] += inverse_masses_[b] * push;
  }
}

// The search radius covers what two particles can approach until the next search.
void LeanCloth::sort_into_cells() {
  const auto count = static_cast<std::uint32_t>(order_.size());
  float fastest = 0;
  for (const Part& part : parts_) fastest = std::max(fastest, part.fastest);
  const float radius = std::sqrt(radius2_), interval = h_ * static_cast<float>(options_.substeps / options_.detections);
  search_ = radius + std::min(radius, 2 * fastest * interval);
  Float4 low = x_[0], high = x_[0];
  for (std::uint32_t p = 0; p < count; ++p) {
    low = min(low, x_[p]);
    high = max(high, x_[p]);
  }
  corner_ = low;
  // Cells may be larger than the search: a fine sheet leaves most of its box empty, and empty cells cost as well.
  const auto cells_of = [&](float side) {
    for (int k = 0; k < 3; ++k) cells_[static_cast<std::size_t>(k)] = static_cast<int>((high[k] - low[k]) / side) + 1;
    return static_cast<std::size_t>(cells_[0]) * static_cast<std::size_t>(cells_[1]) *
           static_cast<std::size_t>(cells_[2]);
  };
  float side = search_;
  while (cells_of(side) > std::size_t{32} * count) side *= 1.1F;
  cell_begin_.assign(cells_of(side) + 1, 0);
  cell_of_.resize(count);
  for (std::uint32_t p = 0; p < count; ++p) {
    const Float4 place = (x_[p] - corner_) / side;
    cell_of_[p] = static_cast<std::uint32_t>(
        (static_cast<int>(place[2]) * cells_[1] + static_cast<int>(place[1])) * cells_[0] + static_cast<int>(place[0]));
    ++cell_begin_[cell_of_[p] + 1];
  }
  std::partial_sum(cell_begin_.begin(), cell_begin_.end(), cell_begin_.begin());
  sorted_.resize(count);
  sorted_x_.resize(count);
  std::vector<std::uint32_t> filled(cell_begin_.begin(), cell_begin_.end() - 1);
  for (std::uint32_t p = 0; p < count; ++p) {
    const std::uint32_t at = filled[cell_of_[p]]++;
    sorted_[at] = p;
    sorted_x_[at] = x_[p];
  }
}

// Pairs of the part's particles with those after them in cell order. Neighbours on the sheet may be close.
void LeanCloth::find_close_pairs(Part& part) {
  part.close.clear();
  part.crossing.clear();
  const float search2 = search_ * search_;
  const auto meet = [&](std::uint32_t p, Float4 x, std::uint32_t begin, std::uint32_t end) {
    for (std::uint32_t at = begin; at < end; ++at) {
      if (squared(sorted_x_[at] - x) >= search2) continue;
      const std::uint32_t q = sorted_[at];
      if (squared(rest_[q] - rest_[p]) < radius2_) continue;
      (q >= part.first && q < part.last ? part.close : part.crossing).push_back({p, q});
    }
  };
  // By cell, so that the particles that a cell meets are in the cache.
  for (std::uint32_t at = 0; at < sorted_.size(); ++at) {
    const std::uint32_t p = sorted_[at];
    if (p < part.first || p >= part.last) continue;
    const auto cell = static_cast<int>(cell_of_[p]);
    const int i = cell % cells_[0], j = cell / cells_[0] % cells_[1], k = cell / (cells_[0] * cells_[1]);
    const int last = std::min(i + 1, cells_[0] - 1) - i, first = std::max(i - 1, 0) - i;
    meet(p, sorted_x_[at], at + 1, cell_begin_[static_cast<std::size_t>(cell + last) + 1]);
    for (const auto& [dj, dk] : {std::pair{1, 0}, std::pair{-1, 1}, std::pair{0, 1}, std::pair{1, 1}}) {
      if (j + dj < 0 || j + dj >= cells_[1] || k + dk >= cells_[2]) continue;
      const int row = cell + (dk * cells_[1] + dj) * cells_[0];
      meet(p, sorted_x_[at], cell_begin_[static_cast<std::size_t>(row + first)],
           cell_begin_[static_cast<std::size_t>(row + last) + 1]);
    }
  }
}

Positions LeanCloth::positions() const {
  Positions positions(static_cast<Eigen::Index>(order_.size()), 3);
  for (std::size_t p = 0; p < order_.size(); ++p) {
    positions.row(order_[p]) = Eigen::RowVector3f(x_[p][0], x_[p][1], x_[p][2]);
  }
  return positions;
}

}  // namespace pleat::bench
