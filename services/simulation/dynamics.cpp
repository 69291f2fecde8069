#include "services/simulation/dynamics.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

// A coarse mesh is one range: waking threads for it costs more than it saves.
constexpr std::size_t kPackGrain = 512;

// Takes the vertices from as many stretches in turn. A sweep over them (swept_conjugate_gradients) then seldom waits
// for the row before.
void deal_out(std::vector<std::uint32_t>& vertices) {
  constexpr std::size_t kStretches = 4;
  const std::size_t length = (vertices.size() + kStretches - 1) / kStretches;
  std::vector<std::uint32_t> dealt;
  for (std::size_t k = 0; k < length; ++k) {
    for (std::size_t i = k; i < vertices.size(); i += length) dealt.push_back(vertices[i]);
  }
  vertices = std::move(dealt);
}

// Compressed rows: for every place the offsets of what its elements computed for it, in element order.
template <typename Elements, typename Offset>
void gather_lists(std::span<const std::uint32_t> place, const Elements& elements, const Offset& offset,
                  std::vector<std::uint32_t>& offsets, std::vector<std::uint32_t>& corners) {
  offsets.assign(place.size() + 1, 0);
  for (const auto& e : elements) {
    for (const std::uint32_t v : e.v) ++offsets[place[v] + 1];
  }
  std::partial_sum(offsets.begin(), offsets.end(), offsets.begin());
  corners.resize(offsets.back());
  std::vector<std::uint32_t> next(offsets.begin(), offsets.end() - 1);
  for (std::size_t e = 0; e < elements.size(); ++e) {
    for (std::size_t k = 0; k < elements[e].v.size(); ++k) {
      corners[next[place[elements[e].v[k]]]++] = static_cast<std::uint32_t>(offset(e, k));
    }
  }
}

// Halves the points at the median of their longest extent, again and again.
void order_by_place(const Positions& points, std::span<std::uint32_t> vertices) {
  if (vertices.size() <= 4) return;
  Eigen::RowVector3f low = points.row(vertices[0]), high = low;
  for (const std::uint32_t v : vertices) {
    low = low.cwiseMin(points.row(v));
    high = high.cwiseMax(points.row(v));
  }
  Eigen::Index axis = 0;
  (high - low).maxCoeff(&axis);
  const std::size_t half = vertices.size() / 2;
  std::nth_element(vertices.begin(), vertices.begin() + static_cast<std::ptrdiff_t>(half), vertices.end(),
                   [&](std::uint32_t a, std::uint32_t b) {
                     return points(a, axis) < points(b, axis) || (points(a, axis) == points(b, axis) && a < b);
                   });
  order_by_place(points, vertices.first(half));
  order_by_place(points, vertices.subspan(half));
}

}  // namespace

Dynamics::Dynamics(const Topology& mesh, const Scene& scene, const Topology* coarse,
                   std::span<const std::uint32_t> feature_vertices)
    : table_(scene.material, scene.stretching_multiplier), density_(scene.material.density * scene.density_multiplier) {
  const auto vertices = static_cast<std::size_t>(mesh.vertex_count());
  masses_.assign(vertices, 0);
  areas_.assign(vertices, 0);
  std::vector<std::uint32_t> identity(vertices);
  std::iota(identity.begin(), identity.end(), 0u);
  add_level(mesh, identity, scene);
  mass_faces_ = faces_.size();
  for (const Face& face : faces_) {
    for (const std::uint32_t v : face.v) {
      areas_[v] += static_cast<double>(face.rest.area) / 3;
      masses_[v] += density_ * static_cast<double>(face.rest.area) / 3;
    }
  }
  // A vertex without faces would make the matrix singular; it falls like a crumb of the average mass.
  const double mean = std::accumulate(masses_.begin(), masses_.end(), 0.0) / static_cast<double>(vertices);
  for (double& mass : masses_) {
    if (mass <= 0) mass = mean;
  }
  const std::size_t mass_hinges = hinges_.size();
  if (coarse != nullptr) add_level(*coarse, feature_vertices, scene);
  choose_order(mesh);
  const auto sort_by_place = [this](auto begin, auto end) {
    std::stable_sort(begin, end, [this](const auto& a, const auto& b) { return place_[a.v[0]] < place_[b.v[0]]; });
  };
  const auto mass_faces = static_cast<std::ptrdiff_t>(mass_faces_);
  sort_by_place(faces_.begin(), faces_.begin() + mass_faces);
  sort_by_place(faces_.begin() + mass_faces, faces_.end());
  sort_by_place(hinges_.begin(), hinges_.begin() + static_cast<std::ptrdiff_t>(mass_hinges));
  sort_by_place(hinges_.begin() + static_cast<std::ptrdiff_t>(mass_hinges), hinges_.end());
  build_packs();
  build_pattern();
}

void Dynamics::add_level(const Topology& mesh, std::span<const std::uint32_t> map, const Scene& scene) {
  const auto uv = [&](Eigen::Index f, int k) -> Eigen::Vector2d {
    return mesh.uv.row(mesh.uv_faces(f, k)).cast<double>();
  };
  std::vector<double> areas;
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    const Eigen::Vector2d e1 = uv(f, 1) - uv(f, 0), e2 = uv(f, 2) - uv(f, 0);
    const double determinant = e1.x() * e2.y() - e1.y() * e2.x();
    // Rows of the inverse of [e1 e2] are the gradients of the shape functions of corners 1 and 2.
    const Eigen::Vector2d g1(e2.y() / determinant, -e2.x() / determinant);
    const Eigen::Vector2d g2(-e1.y() / determinant, e1.x() / determinant);
    Face face;
    face.v = {map[mesh.faces(f, 0)], map[mesh.faces(f, 1)], map[mesh.faces(f, 2)]};
    face.rest.du = {static_cast<float>(-g1.x() - g2.x()), static_cast<float>(g1.x()), static_cast<float>(g2.x())};
    face.rest.dv = {static_cast<float>(-g1.y() - g2.y()), static_cast<float>(g1.y()), static_cast<float>(g2.y())};
    face.rest.area = static_cast<float>(determinant / 2);
    areas.push_back(determinant / 2);
    faces_.push_back(face);
  }
  const Connectivity connectivity = build_connectivity(mesh.vertex_count(), mesh.faces);
  // The edge v0-v1 in the material coordinates of a face: a seam has other ones on its other side.
  const auto edge_in = [&](std::uint32_t face, std::uint32_t v0, std::uint32_t v1) -> Eigen::Vector2d {
    Eigen::Vector2d a = Eigen::Vector2d::Zero(), b = a;
    for (int k = 0; k < 3; ++k) {
      if (mesh.faces(face, k) == v0) a = uv(face, k);
      if (mesh.faces(face, k) == v1) b = uv(face, k);
    }
    return b - a;
  };
  for (const Edge& edge : connectivity.edges) {
    if (edge.f1 == kNone) continue;
    const Eigen::Vector2d d0 = edge_in(edge.f0, edge.v0, edge.v1), d1 = edge_in(edge.f1, edge.v0, edge.v1);
    const double length = (d0.norm() + d1.norm()) / 2, area = areas[edge.f0] + areas[edge.f1];
    Hinge hinge;
    hinge.v = {map[edge.v0], map[edge.v1], map[edge.opposite0], map[edge.opposite1]};
    hinge.rest.shape = static_cast<float>(length * length / (2 * area));
    hinge.rest.curvature_per_radian = static_cast<float>(length / area);
    for (std::size_t j = 0; j < 5; ++j) {
      const double kappa = 10.0 * static_cast<double>(j);
      hinge.rest.stiffness[j] = static_cast<float>(scene.bending_multiplier *
                                                   std::min(bending_stiffness(scene.material, d0.x(), d0.y(), kappa),
                                                            bending_stiffness(scene.material, d1.x(), d1.y(), kappa)));
    }
    hinges_.push_back(hinge);
  }
}

void Dynamics::choose_order(const Topology& mesh) {
  vertex_at_.resize(vertex_count());
  std::iota(vertex_at_.begin(), vertex_at_.end(), 0u);
  order_by_place(mesh.rest_positions, vertex_at_);
  if (vertex_count() < kWorthThreads) deal_out(vertex_at_);
  place_.resize(vertex_count());
  for (std::uint32_t p = 0; p < vertex_at_.size(); ++p) place_[vertex_at_[p]] = p;
}

// A level begins with a pack of its own, because only the first one meets the air.
std::uint32_t Dynamics::face_slot(std::size_t face) const {
  return static_cast<std::uint32_t>(face < mass_faces_ ? face : mass_packs_ * kPack + face - mass_faces_);
}

void Dynamics::build_packs() {
  const auto packs = [](std::size_t elements) { return (elements + kPack - 1) / kPack; };
  mass_packs_ = packs(mass_faces_);
  face_packs_.resize(mass_packs_ + packs(faces_.size() - mass_faces_));
  const auto placed = [this](auto vertices) {
    for (std::uint32_t& v : vertices) v = place_[v];
    return vertices;
  };
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    face_packs_[face_slot(f) / kPack].set(face_slot(f) % kPack, placed(faces_[f].v), faces_[f].rest);
  }
  hinge_packs_.resize(packs(hinges_.size()));
  for (std::size_t h = 0; h < hinges_.size(); ++h) {
    hinge_packs_[h / kPack].set(h % kPack, placed(hinges_[h].v), hinges_[h].rest);
  }
  face_records_.assign(face_packs_.size() * kPack * kFaceRecord, 0);
  hinge_records_.assign(hinge_packs_.size() * kPack * kHingeRecord, 0);
  reference_angles_.assign(hinge_packs_.size() * kPack, 0);
  positions_.resize(vertex_count());
  velocities_.resize(vertex_count());
}

void Dynamics::build_pattern() {
  const std::size_t n = vertex_count();
  gather_lists(
      place_, faces_, [this](std::size_t f, std::size_t k) { return face_slot(f) * kFaceRecord + kFaceForces + 3 * k; },
      face_offsets_, face_corners_);
  gather_lists(
      place_, hinges_, [](std::size_t h, std::size_t k) { return h * kHingeRecord + 4 * k; }, hinge_offsets_,
      hinge_corners_);

  enum class Source : std::uint8_t { kFace, kTransposed, kHinge };
  struct Entry {
    std::uint64_t key;
    Source source;
    std::uint32_t first, second;
  };
  std::vector<Entry> entries;
  entries.reserve(3 * faces_.size() + 6 * hinges_.size());
  const auto key = [](std::uint32_t i, std::uint32_t j) {
    return static_cast<std::uint64_t>(std::min(i, j)) << 32 | std::max(i, j);
  };
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t i = place_[faces_[f].v[k]], j = place_[faces_[f].v[(k + 1) % 3]];
      if (i == j) continue;
      entries.push_back({key(i, j), i < j ? Source::kFace : Source::kTransposed,
                         static_cast<std::uint32_t>(face_slot(f) * kFaceRecord + 9 * k), 0});
    }
  }
  for (std::size_t h = 0; h < hinges_.size(); ++h) {
    for (std::size_t a = 0; a < 4; ++a) {
      for (std::size_t b = a + 1; b < 4; ++b) {
        const std::uint32_t i = place_[hinges_[h].v[a]], j = place_[hinges_[h].v[b]];
        if (i == j) continue;
        const auto at_a = static_cast<std::uint32_t>(h * kHingeRecord + 4 * a);
        const auto at_b = static_cast<std::uint32_t>(h * kHingeRecord + 4 * b);
        entries.push_back({key(i, j), Source::kHinge, i < j ? at_a : at_b, i < j ? at_b : at_a});
      }
    }
  }
  std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.key < b.key; });
  const auto begins = [this] {
    return PairSources{static_cast<std::uint32_t>(face_sources_.size()),
                       static_cast<std::uint32_t>(transposed_sources_.size()),
                       static_cast<std::uint32_t>(hinge_sources_.size())};
  };
  for (std::size_t e = 0; e < entries.size(); ++e) {
    const Entry& entry = entries[e];
    if (e == 0 || entry.key != entries[e - 1].key) {
      pairs_.push_back({static_cast<std::uint32_t>(entry.key >> 32), static_cast<std::uint32_t>(entry.key)});
      sources_.push_back(begins());
    }
    if (entry.source == Source::kFace) face_sources_.push_back(entry.first);
    if (entry.source == Source::kTransposed) transposed_sources_.push_back(entry.first);
    if (entry.source == Source::kHinge) hinge_sources_.push_back({entry.first, entry.second});
  }
  sources_.push_back(begins());
  matrix_ = BlockMatrix(n, pairs_);

  inverse_diagonal_.assign(9 * n + 1, 0);
  for (auto* vector : {&right_side_, &change_, &residual_, &direction_, &product_, &preconditioned_, &solved_}) {
    vector->assign(n, Float4{});
  }
  fixed_.assign(n, 0);
}

void Dynamics::use_levels(const Subdivision& subdivision) {
  multilevel_ = Multilevel(subdivision.level_sizes, subdivision.halved_edges, place_, pairs_, matrix_);
  if (!averages_.empty()) multilevel_.add_averages(averages_);
}

void Dynamics::track_averages(const Subdivision& subdivision, const Faces& coarse_faces) {
  averages_ = Averages(subdivision, coarse_faces, masses_, place_);
  multilevel_.add_averages(averages_);
}

Points Dynamics::internal_forces(const Points& x) const {
  Points forces(x.size(), Vector3d::Zero());
  for (const Face& face : faces_) {
    const Vector3f e1 = (x[face.v[1]] - x[face.v[0]]).cast<float>(), e2 = (x[face.v[2]] - x[face.v[0]]).cast<float>();
    const auto strain = triangle_strain(face.rest, e1, e2);
    Vector3f f1, f2;
    stretching_forces(face.rest, table_.at(strain.g00, strain.g11, strain.g01), strain, f1, f2);
    forces[face.v[0]] -= (f1 + f2).cast<double>();
    forces[face.v[1]] += f1.cast<double>();
    forces[face.v[2]] += f2.cast<double>();
  }
  for (const Hinge& hinge : hinges_) {
    const Vector3d& origin = x[hinge.v[0]];
    const auto angle =
        hinge_angle<float>((x[hinge.v[1]] - origin).cast<float>(), (x[hinge.v[2]] - origin).cast<float>(),
                           (x[hinge.v[3]] - origin).cast<float>());
    const float moment = hinge_moment(hinge.rest, hinge_stiffness(hinge.rest, angle.theta), angle.theta);
    for (std::size_t k = 0; k < 4; ++k) forces[hinge.v[k]] -= (moment * angle.gradient[k]).cast<double>();
  }
  return forces;
}

bool Dynamics::bursts(const Points& start, const Points& end) const {
  for (std::size_t f = 0; f < mass_faces_; ++f) {
    const Face& face = faces_[f];
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t a = face.v[k], b = face.v[(k + 1) % 3];
      const double length2 = std::max((start[b] - start[a]).squaredNorm(), 4 * static_cast<double>(face.rest.area));
      if ((end[b] - end[a]).squaredNorm() > 4 * length2) return true;
    }
  }
  return false;
}

double Dynamics::internal_energy(const Points& x) const {
  double energy = 0;
  for (const Face& face : faces_) {
    const Vector3f e1 = (x[face.v[1]] - x[face.v[0]]).cast<float>(), e2 = (x[face.v[2]] - x[face.v[0]]).cast<float>();
    const auto strain = triangle_strain(face.rest, e1, e2);
    energy += static_cast<double>(stretching_energy(face.rest, table_.at(strain.g00, strain.g11, strain.g01), strain));
  }
  for (const Hinge& hinge : hinges_) {
    const Vector3d& origin = x[hinge.v[0]];
    const auto angle =
        hinge_angle<float>((x[hinge.v[1]] - origin).cast<float>(), (x[hinge.v[2]] - origin).cast<float>(),
                           (x[hinge.v[3]] - origin).cast<float>());
    energy += static_cast<double>(hinge_energy(hinge.rest, hinge_stiffness(hinge.rest, angle.theta), angle.theta));
  }
  return energy;
}

void Dynamics::assemble(const Points& x, const Points& v, const Step& step, ThreadPool& pool) {
  const auto h = static_cast<float>(step.length_s);
  const auto scale = static_cast<float>(step.length_s * (step.length_s + step.damping_s));

  pool.parallel_for(vertex_count(), 4 * kVertexGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Vector3d &position = x[vertex_at_[i]], &velocity = v[vertex_at_[i]];
      positions_[i] = Double4{position.x(), position.y(), position.z(), 0};
      velocities_[i] = Double4{velocity.x(), velocity.y(), velocity.z(), 0};
    }
  });
  const Air air{velocities_.data(), step.wind.velocity.cast<float>(), static_cast<float>(step.wind.density),
                static_cast<float>(step.wind.drag), static_cast<float>(density_) / h};
  const bool windy = step.wind.density > 0 || step.wind.drag > 0;
  pool.parallel_for(face_packs_.size(), kPackGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) {
      stretching_pack(face_packs_[p], positions_.data(), table_, windy && p < mass_packs_ ? &air : nullptr,
                      face_records_.data() + p * kPack * kFaceRecord);
    }
  });
  pool.parallel_for(hinge_packs_.size(), kPackGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) {
      bending_pack(hinge_packs_[p], positions_.data(), reference_angles_.data() + p * kPack,
                   hinge_records_.data() + p * kPack * kHingeRecord);
    }
  });

  pool.parallel_for(pairs_.size(), 8 * kVertexGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) {
      const PairSources &first = sources_[p], &last = sources_[p + 1];
      Float4 c0{}, c1{}, c2{}, t0{}, t1{}, t2{};
      for (std::uint32_t s = first.face; s < last.face; ++s) {
        const float* block = face_records_.data() + face_sources_[s];
        c0 += BlockMatrix::load(block);
        c1 += BlockMatrix::load(block + 3);
        c2 += BlockMatrix::load(block + 6);
      }
      for (std::uint32_t s = first.transposed; s < last.transposed; ++s) {
        const float* block = face_records_.data() + transposed_sources_[s];
        t0 += BlockMatrix::load(block);
        t1 += BlockMatrix::load(block + 3);
        t2 += BlockMatrix::load(block + 6);
      }
      for (std::uint32_t s = first.hinge; s < last.hinge; ++s) {
        const Float4 a = BlockMatrix::load(hinge_records_.data() + hinge_sources_[s].first);
        const Float4 b = BlockMatrix::load(hinge_records_.data() + hinge_sources_[s].second);
        c0 += a * b[0];
        c1 += a * b[1];
        c2 += a * b[2];
      }
      c0 = scale * (c0 + Float4{t0[0], t1[0], t2[0], 0});
      c1 = scale * (c1 + Float4{t0[1], t1[1], t2[1], 0});
      c2 = scale * (c2 + Float4{t0[2], t1[2], t2[2], 0});
      BlockMatrix::store(matrix_.block(matrix_.upper_slot(p)), c0, c1, c2);
      BlockMatrix::store(matrix_.block(matrix_.lower_slot(p)), Float4{c0[0], c1[0], c2[0], 0},
                         Float4{c0[1], c1[1], c2[1], 0}, Float4{c0[2], c1[2], c2[2], 0});
    }
  });

  const Float4 gravity = to_float4(step.gravity);
  pool.parallel_for(vertex_count(), kVertexGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const auto mass = static_cast<float>(masses_[vertex_at_[i]]);
      Float4 force = mass * gravity;
      for (std::uint32_t c = face_offsets_[i]; c < face_offsets_[i + 1]; ++c) {
        force += BlockMatrix::load(face_records_.data() + face_corners_[c]);
      }
      for (std::uint32_t c = hinge_offsets_[i]; c < hinge_offsets_[i + 1]; ++c) {
        const float moment = hinge_records_[hinge_corners_[c] / kHingeRecord * kHingeRecord + 3];
        force += moment * BlockMatrix::load(hinge_records_.data() + hinge_corners_[c]);
      }
      // K v through velocity differences: the common motion, far larger than the rest in a fall, drops out exactly.
      Float4 c0{mass, 0, 0, 0}, c1{0, mass, 0, 0}, c2{0, 0, mass, 0}, stiffness_velocity{};
      for (std::uint32_t slot = matrix_.row_begin(i); slot < matrix_.row_end(i); ++slot) {
        const float* block = matrix_.block(slot);
        const Float4 b0 = BlockMatrix::load(block), b1 = BlockMatrix::load(block + 3),
                     b2 = BlockMatrix::load(block + 6);
        c0 -= b0;
        c1 -= b1;
        c2 -= b2;
        const Float4 difference = __builtin_convertvector(velocities_[matrix_.column(slot)] - velocities_[i], Float4);
        stiffness_velocity += b0 * difference[0] + b1 * difference[1] + b2 * difference[2];
      }
      BlockMatrix::store(matrix_.diagonal(i), c0, c1, c2);
      right_side_[i] = h * force - stiffness_velocity;
    }
  });

  std::fill(fixed_.begin(), fixed_.end(), 0);
  for (const Pin& pin : step.pins) {
    const std::uint32_t i = place_[pin.vertex];
    const Vector3d way = pin.target - x[pin.vertex];
    if (pin.hard) {
      fixed_[i] = 1;
      change_[i] = to_float4(way / step.length_s - v[pin.vertex]);
      continue;
    }
    Eigen::Map<Eigen::Matrix3f> diagonal(matrix_.diagonal(i));
    diagonal.diagonal().array() += static_cast<float>(step.length_s * step.length_s * pin.stiffness);
    right_side_[i] += to_float4(step.length_s * pin.stiffness * (way - step.length_s * v[pin.vertex]));
  }

  contacts_.assign(step.contacts.begin(), step.contacts.end());
  outside_.clear();
  for (ContactForce& contact : contacts_) {
    for (std::uint32_t& vertex : contact.vertices) {
      if (vertex != kNone) vertex = place_[vertex];
    }
    const Vector3f impulse = h * contact.force * contact.normal - contact.velocity_block(h) * contact.approach;
    for (std::size_t k = 0; k < 4; ++k) {
      if (contact.vertices[k] != kNone) right_side_[contact.vertices[k]] += to_float4(contact.weights[k] * impulse);
    }
    if (!add_to_matrix(contact, h)) outside_.push_back(contact);
  }
  for (std::size_t k = 0; k < 9 * vertex_count(); ++k) inverse_diagonal_[k] = matrix_.diagonal(0)[k];
  averages_scale_ = averages_.empty() ? 0 : static_cast<float>(std::pow(step.frequency * step.length_s, 2));
  if (averages_scale_ > 0) add_averages(step, pool);
  for (const ContactForce& contact : outside_) {
    const Eigen::Matrix3f block = contact.velocity_block(h);
    for (std::size_t k = 0; k < 4; ++k) {
      if (contact.vertices[k] == kNone) continue;
      Eigen::Map<Eigen::Matrix3f>(inverse_diagonal_.data() + 9 * static_cast<std::size_t>(contact.vertices[k])) +=
          contact.weights[k] * contact.weights[k] * block;
    }
  }
  whole_diagonal_ = inverse_diagonal_;
  pool.parallel_for(vertex_count(), kVertexGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      float inverse[9];
      invert_block(inverse_diagonal_.data() + 9 * i, inverse);
      std::copy(inverse, inverse + 9, inverse_diagonal_.data() + 9 * i);
    }
  });
}

// The force at the end of the step, as springs have it: h omega^2 times the pull of target - x - h v.
void Dynamics::add_averages(const Step& step, ThreadPool& pool) {
  pool.parallel_for(vertex_count(), 4 * kVertexGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Vector3d& target = step.targets[vertex_at_[i]];
      positions_[i] = Double4{target.x(), target.y(), target.z(), 0} - positions_[i] - step.length_s * velocities_[i];
    }
  });
  averages_.gather(positions_, pool);
  const auto scale = static_cast<float>(step.length_s * step.frequency * step.frequency);
  pool.parallel_for(vertex_count(), kVertexGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      right_side_[i] += scale * averages_.pull_at(i);
      float* diagonal = inverse_diagonal_.data() + 9 * i;
      for (int k = 0; k < 3; ++k) diagonal[4 * k] += averages_scale_ * averages_.diagonal(i);
    }
  });
}

// Contacts with obstacles push vertices of one edge or face of the cloth at most, between which the matrix has blocks.
// Returns false, and adds nothing, for a contact that has none between two of its vertices: one of cloth with cloth.
bool Dynamics::add_to_matrix(const ContactForce& contact, float step_s) {
  std::array<std::array<std::uint32_t, 4>, 4> slots;  // of the pairs of different vertices
  for (std::size_t a = 0; a < 4; ++a) {
    for (std::size_t b = 0; b < 4; ++b) {
      const std::uint32_t i = contact.vertices[a], j = contact.vertices[b];
      if (a == b || i == kNone || j == kNone) continue;
      slots[a][b] = matrix_.find(i, j);
      if (slots[a][b] == kNone) return false;
    }
  }
  const Eigen::Matrix3f block = contact.velocity_block(step_s);
  for (std::size_t a = 0; a < 4; ++a) {
    for (std::size_t b = 0; b < 4; ++b) {
      if (contact.vertices[a] == kNone || contact.vertices[b] == kNone) continue;
      float* values = a == b ? matrix_.diagonal(contact.vertices[a]) : matrix_.block(slots[a][b]);
      Eigen::Map<Eigen::Matrix3f> sum(values);
      sum += contact.weights[a] * contact.weights[b] * block;
    }
  }
  return true;
}

}  // namespace pleat::simulation
