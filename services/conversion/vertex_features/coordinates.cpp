#include "services/conversion/vertex_features/coordinates.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/conversion/vertex_features/vectors.hpp"

namespace pleat::conversion {
namespace {

// (V) number of each vertex's connected part, counted up from 0.
std::vector<std::uint32_t> connected_parts(const OneRings& rings) {
  std::vector<std::uint32_t> part(rings.vertex_count());
  for (std::uint32_t v = 0; v < part.size(); ++v) part[v] = v;
  const auto root = [&](std::uint32_t v) {
    while (part[v] != v) v = part[v] = part[part[v]];
    return v;
  };
  for (const auto& e : rings.edges()) {
    const std::uint32_t a = root(e.a), b = root(e.b);
    part[std::max(a, b)] = std::min(a, b);
  }
  for (std::uint32_t v = 0; v < part.size(); ++v) part[v] = root(v);
  return part;
}

void check_places(const Positions& places, std::size_t expected, const char* what) {
  if (static_cast<std::size_t>(places.rows()) != expected) {
    throw_invalid_argument("vertex features: " + std::to_string(places.rows()) + " places of " + what + " for " +
                           std::to_string(expected));
  }
}

Float4 row(const Positions& places, std::size_t index) {
  const float* p = places.data() + 3 * index;
  return Float4{p[0], p[1], p[2], 0};
}

Double4 widen(Float4 a) { return __builtin_convertvector(a, Double4); }

}  // namespace

CoordinateSolver::CoordinateSolver(std::shared_ptr<const OneRings> rings, Anchors anchors, const std::string& name)
    : rings_(std::move(rings)), anchors_(std::move(anchors)), fixed_(rings_->vertex_count(), 0) {
  if (!(anchors_.weight >= 0)) throw_invalid_argument(name + ": the weight of anchors must not be negative");
  for (const auto* list : {&anchors_.handles, &anchors_.soft}) {
    for (const std::uint32_t v : *list) {
      if (v >= fixed_.size()) throw_invalid_argument(name + ": anchor " + std::to_string(v) + " is not a vertex");
    }
  }
  for (const std::uint32_t v : anchors_.handles) fixed_[v] = 1;

  const std::vector<std::uint32_t> part_of = connected_parts(*rings_);
  std::vector<std::uint8_t> placed(fixed_.size(), 0);  // by parts
  for (const std::uint32_t v : anchors_.handles) placed[part_of[v]] = 1;
  if (anchors_.weight > 0) {
    for (const std::uint32_t v : anchors_.soft) placed[part_of[v]] = 1;
  }
  std::vector<std::uint32_t> part_index(fixed_.size(), kNone);
  for (std::size_t k = 0; k < anchors_.soft.size(); ++k) {
    const std::uint32_t part = part_of[anchors_.soft[k]];
    if (placed[part] != 0) continue;
    if (part_index[part] == kNone) {
      part_index[part] = static_cast<std::uint32_t>(parts_.size());
      parts_.emplace_back();
    }
    parts_[part_index[part]].soft.push_back(static_cast<std::uint32_t>(k));
  }
  for (std::uint32_t v = 0; v < fixed_.size(); ++v) {
    const std::uint32_t part = part_of[v];
    if (placed[part] != 0) continue;
    if (part_index[part] == kNone) {
      throw_invalid_argument(name + ": the part of vertex " + std::to_string(v) +
                             " has neither a handle nor an anchor: nothing says where it is");
    }
    fixed_[part] = 1;  // a part's number is its first vertex
    parts_[part_index[part]].vertices.push_back(v);
  }
  build_rows();
  build_system(name);
}

void CoordinateSolver::build_rows() {
  const std::size_t count = rings_->vertex_count();
  std::vector<std::vector<Neighbour>> rows(count);
  row_sums_.assign(count, {0, 0, 0});
  const auto add = [&](std::uint32_t i, std::uint32_t j, float weight) {
    const Eigen::RowVector3f r = weight * (rings_->rest_positions().row(i) - rings_->rest_positions().row(j));
    rows[i].push_back({j, r.x(), r.y(), r.z()});
    for (std::size_t k = 0; k < 3; ++k) row_sums_[i][k] += r(static_cast<Eigen::Index>(k));
  };
  for (const auto& e : rings_->edges()) {
    add(e.a, e.b, e.weight);
    add(e.b, e.a, e.weight);
  }
  row_offsets_.push_back(0);
  for (const auto& entries : rows) {
    row_entries_.insert(row_entries_.end(), entries.begin(), entries.end());
    row_offsets_.push_back(static_cast<std::uint32_t>(row_entries_.size()));
  }
}

void CoordinateSolver::build_system(const std::string& name) {
  const std::size_t count = rings_->vertex_count();
  std::vector<double> diagonal(count, 0);
  double sum = 0;
  for (const auto& e : rings_->edges()) {
    const double weight = 2 * static_cast<double>(e.weight);
    diagonal[e.a] += weight;
    diagonal[e.b] += weight;
    sum += 2 * weight;
  }
  soft_weight_ = anchors_.weight * sum / static_cast<double>(count);
  for (const std::uint32_t v : anchors_.soft) diagonal[v] += soft_weight_;

  slot_.assign(count, kNone);
  std::uint32_t unknowns = 0;
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t v = 0; v < count; ++v) {
    if (fixed_[v] == 0) slot_[v] = unknowns++;
  }
  if (unknowns == 0) return;
  for (std::size_t v = 0; v < count; ++v) {
    if (slot_[v] != kNone) entries.emplace_back(slot_[v], slot_[v], diagonal[v]);
  }
  for (const auto& e : rings_->edges()) {
    const double weight = 2 * static_cast<double>(e.weight);
    const std::uint32_t a = slot_[e.a], b = slot_[e.b];
    if (a != kNone && b != kNone) {
      entries.emplace_back(a, b, -weight);
      entries.emplace_back(b, a, -weight);
    } else if (a != kNone) {
      pulls_.push_back({a, e.b, weight});
    } else if (b != kNone) {
      pulls_.push_back({b, e.a, weight});
    }
  }
  Eigen::SparseMatrix<double> matrix(unknowns, unknowns);
  matrix.setFromTriplets(entries.begin(), entries.end());
  SparseCholesky::Triangle triangle;
  try {
    triangle = SparseCholesky(matrix).triangle();
  } catch (const Error& error) {
    throw Error(error.code(), name + ": " + error.what());
  }
  factor_ = std::make_unique<const LaneFactor>(triangle);
  std::vector<std::uint32_t> place(unknowns);
  for (std::uint32_t k = 0; k < unknowns; ++k) place[static_cast<std::size_t>(triangle.permutation[k])] = k;
  for (std::uint32_t& slot : slot_) slot = slot == kNone ? kNone : place[slot];
  for (Pull& pull : pulls_) pull.slot = place[pull.slot];
}

void CoordinateSolver::load(const GradientField& gradients, std::vector<Double4>& unknowns) const {
  const auto* const columns = gradients.columns.data();
  for (std::size_t v = 0; v < slot_.size(); ++v) {
    if (slot_[v] == kNone) continue;
    const auto& own = columns[v];
    const auto& sum = row_sums_[v];
    Float4 b = own[0] * sum[0] + own[1] * sum[1] + own[2] * sum[2];
    for (std::uint32_t k = row_offsets_[v]; k < row_offsets_[v + 1]; ++k) {
      const Neighbour& n = row_entries_[k];
      const auto& other = columns[n.vertex];
      b += other[0] * n.rx + other[1] * n.ry + other[2] * n.rz;
    }
    unknowns[slot_[v]] = widen(b);
  }
}

void CoordinateSolver::place_parts(const Positions& soft, std::vector<Float4>& positions) const {
  for (const Part& part : parts_) {
    Double4 offset{};
    for (const std::uint32_t k : part.soft) offset += widen(row(soft, k)) - widen(positions[anchors_.soft[k]]);
    const Float4 move = __builtin_convertvector(offset / static_cast<double>(part.soft.size()), Float4);
    for (const std::uint32_t v : part.vertices) positions[v] += move;
  }
}

void CoordinateSolver::check_gradients(const GradientField& gradients) const {
  if (gradients.columns.size() == slot_.size()) return;
  throw_invalid_argument("vertex features: " + std::to_string(gradients.columns.size()) + " gradients for " +
                         std::to_string(slot_.size()) + " vertices");
}

void CoordinateSolver::run_passes(const GradientField& gradients, int passes, CoordinateScratch& scratch) const {
  std::vector<Float4>& p = scratch.positions;
  for (int pass = 0; pass < passes && factor_ != nullptr; ++pass) {
    GradientField& difference = scratch.difference;
    rings_->gradients(p.data(), difference);
    for (std::size_t v = 0; v < slot_.size(); ++v) {
      for (std::size_t c = 0; c < 3; ++c) {
        difference.columns[v][c] = gradients.columns[v][c] - difference.columns[v][c];
      }
    }
    load(difference, scratch.unknowns);
    factor_->solve(scratch.unknowns);
    for (std::size_t v = 0; v < slot_.size(); ++v) {
      if (slot_[v] != kNone) p[v] += __builtin_convertvector(scratch.unknowns[slot_[v]], Float4);
    }
  }
}

void CoordinateSolver::store(const std::vector<Float4>& from, Positions& positions) const {
  positions.resize(static_cast<Eigen::Index>(slot_.size()), 3);
  for (std::size_t v = 0; v < slot_.size(); ++v) {
    for (int k = 0; k < 3; ++k) positions.data()[3 * v + static_cast<std::size_t>(k)] = from[v][k];
    if (!(std::abs(from[v][0]) + std::abs(from[v][1]) + std::abs(from[v][2]) < 1e9f)) {
      throw_invalid_argument("vertex features: the position of vertex " + std::to_string(v) + " is not finite");
    }
  }
}

void CoordinateSolver::solve(const GradientField& gradients, const Positions& handles, const Positions& soft,
                             int passes, CoordinateScratch& scratch, Positions& positions) const {
  const std::size_t count = slot_.size();
  check_gradients(gradients);
  check_places(handles, anchors_.handles.size(), "handles");
  check_places(soft, anchors_.soft.size(), "anchors");
  std::vector<Float4>& p = scratch.positions;
  p.resize(count);
  scratch.unknowns.resize(count);
  for (const Part& part : parts_) p[part.vertices.front()] = row(rings_->rest_positions(), part.vertices.front());
  for (std::size_t k = 0; k < anchors_.handles.size(); ++k) p[anchors_.handles[k]] = row(handles, k);

  load(gradients, scratch.unknowns);
  for (const Pull& pull : pulls_) scratch.unknowns[pull.slot] += pull.weight * widen(p[pull.fixed]);
  for (std::size_t k = 0; k < anchors_.soft.size(); ++k) {
    const std::uint32_t slot = slot_[anchors_.soft[k]];
    if (slot != kNone) scratch.unknowns[slot] += soft_weight_ * widen(row(soft, k));
  }
  if (factor_ != nullptr) factor_->solve(scratch.unknowns);
  for (std::size_t v = 0; v < count; ++v) {
    if (slot_[v] != kNone) p[v] = __builtin_convertvector(scratch.unknowns[slot_[v]], Float4);
  }
  run_passes(gradients, passes, scratch);
  place_parts(soft, p);
  store(p, positions);
}

void CoordinateSolver::correct(const GradientField& gradients, int passes, CoordinateScratch& scratch,
                               Positions& positions) const {
  check_gradients(gradients);
  check_places(positions, slot_.size(), "vertices");
  scratch.positions.resize(slot_.size());
  scratch.unknowns.resize(slot_.size());
  for (std::size_t v = 0; v < slot_.size(); ++v) scratch.positions[v] = row(positions, v);
  run_passes(gradients, passes, scratch);
  store(scratch.positions, positions);
}

}  // namespace pleat::conversion
