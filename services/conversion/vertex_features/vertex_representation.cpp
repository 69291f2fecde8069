#include "services/conversion/vertex_features/vertex_representation.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/conversion/vertex_features/heading.hpp"

namespace pleat::conversion {
namespace {

constexpr double kReachEdges = 2;     // mean coarse edges, in which obstacles are felt
constexpr double kDepthShare = 0.25;  // of that, in which the inside of a mesh is searched for its surface

/// A fine vertex by the coarse vertices that it is a mean of: (vertex, its share of 2^rounds), ascending, kNone last.
using Share = std::pair<std::uint32_t, int>;
using Shares = std::array<Share, 3>;

Shares shares_of(const Faces& faces, Eigen::Index face, const std::array<int, 3>& weights) {
  Shares shares;
  for (std::size_t k = 0; k < 3; ++k) {
    shares[k] = weights[k] > 0 ? Share{faces(face, static_cast<Eigen::Index>(k)), weights[k]} : Share{kNone, 0};
  }
  std::sort(shares.begin(), shares.end());
  return shares;
}

std::map<Shares, std::uint32_t> fine_vertices(const Subdivision& s, const Faces& coarse_faces, int halves) {
  std::map<Shares, std::uint32_t> vertices;
  for (std::size_t v = 0; v < s.parent_face.size(); ++v) {
    std::array<int, 3> weights{};
    for (std::size_t k = 0; k < 3; ++k) {
      const float weight = s.barycentric(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(k));
      weights[k] = static_cast<int>(std::lround(weight * static_cast<float>(halves)));
    }
    vertices[shares_of(coarse_faces, s.parent_face[v], weights)] = static_cast<std::uint32_t>(v);
  }
  return vertices;
}

/// psi of an alignment R_y(-psi).
float heading_of(const RigidTransform& alignment) {
  return -std::atan2(alignment.rotation(0, 2), alignment.rotation(0, 0));
}

Positions aligned(const Positions& positions, const RigidTransform& alignment) {
  return (positions * alignment.rotation.transpose()).rowwise() + alignment.translation.transpose();
}

/// Without offsets nothing but the mean of the coarse vertices is known of the place.
Anchors anchors_of(const Subdivision& subdivision, const VertexFeatureSpec& spec) {
  Anchors anchors;
  anchors.soft = subdivision.feature_vertices;
  anchors.weight = spec.answer == AnswerKind::kFeaturesAlone ? 0 : spec.anchor_weight;
  return anchors;
}

const Subdivision& with_parents(const Subdivision& subdivision) {
  if (subdivision.parent_face.empty()) {
    throw_invalid_argument("vertex features: need a fine mesh that is a subdivision of the coarse one");
  }
  return subdivision;
}

const VertexFeatureSpec& checked(const RepresentationSpec& spec) {
  const auto& features = std::get<VertexFeatureSpec>(spec.kind);
  if (features.passes < 0 || features.passes > kMostPasses) {
    throw_invalid_argument("vertex features: 0 to " + std::to_string(kMostPasses) + " passes, not " +
                           std::to_string(features.passes));
  }
  if (!(features.anchor_weight > 0) || !(features.anchor_weight <= 1e6)) {
    throw_invalid_argument("vertex features: the weight of anchors must be above 0 and at most 1e6");
  }
  return features;
}

}  // namespace

VertexRepresentation::VertexRepresentation(const Topology& coarse, Subdivision subdivision,
                                           const RepresentationSpec& spec)
    : spec_(spec),
      coarse_(coarse),
      subdivision_(std::move(subdivision)),
      extractor_(std::make_shared<OneRings>(coarse_, "coarse mesh"), checked(spec_).rotation),
      fine_rings_(std::make_shared<OneRings>(with_parents(subdivision_).fine, "fine mesh")),
      fine_extractor_(fine_rings_, features().rotation),
      gradient_channels_(subdivision_.fine.rest_positions),
      solver_(fine_rings_, anchors_of(subdivision_, features()), "fine mesh") {
  make_places();
  make_constants();
}

void VertexRepresentation::make_places() {
  const int rounds = spec_.subdivision.rounds, halves = 1 << rounds;
  const auto side = static_cast<std::size_t>(patch_side(rounds));
  const auto by_shares = fine_vertices(subdivision_, coarse_.faces, halves);
  const std::size_t width = side * faces();
  vertex_at_.assign(side * width, kNone);
  for (std::size_t face = 0; face < faces(); ++face) {
    std::size_t index = 0;
    for (int i = 0; i <= halves; ++i) {
      for (int j = 0; i + j <= halves; ++j, ++index) {
        const auto found =
            by_shares.find(shares_of(coarse_.faces, static_cast<Eigen::Index>(face), {halves - i - j, i, j}));
        if (found == by_shares.end()) throw_internal("vertex features: a fine vertex of a coarse face is missing");
        vertex_at_[index / side * width + face * side + index % side] = found->second;
      }
    }
  }
  input_mask_.assign(faces(), 1);
  std::vector<std::vector<std::uint32_t>> places(static_cast<std::size_t>(fine().vertex_count()));
  answer_mask_.assign(vertex_at_.size(), 0);
  for (std::size_t place = 0; place < vertex_at_.size(); ++place) {
    if (vertex_at_[place] == kNone) continue;
    auto& own = places[vertex_at_[place]];
    if (!has_offsets() && !own.empty()) {
      vertex_at_[place] = kNone;
      continue;
    }
    answer_mask_[place] = 1;
    own.push_back(static_cast<std::uint32_t>(place));
  }
  for (const auto& own : places) {
    reads_.places.insert(reads_.places.end(), own.begin(), own.end());
    reads_.weights.insert(reads_.weights.end(), own.size(),
                          1.0F / static_cast<float>(std::max<std::size_t>(1, own.size())));
    reads_.offsets.push_back(static_cast<std::uint32_t>(reads_.places.size()));
  }
}

/// Where a face lies in the rest mesh, as waves that a linear map can tell places apart by, and its shape.
void VertexRepresentation::make_constants() {
  const Positions& rest = coarse_.rest_positions;
  const Eigen::RowVector3f low = rest.colwise().minCoeff(), high = rest.colwise().maxCoeff();
  const float size = std::max((high - low).maxCoeff(), 1e-9F);
  const char* const axes[] = {"x", "y", "z"};
  for (const char* axis : axes) {
    for (const int waves : {1, 2, 4}) {
      for (const char* phase : {"sine", "cosine"}) {
        constants_.channels.push_back(std::string("place_") + axis + "_" + phase + std::to_string(waves));
      }
    }
  }
  for (int k = 0; k < 3; ++k) {
    for (const char* axis : axes) constants_.channels.push_back("corner" + std::to_string(k) + "_" + axis);
  }
  constants_.shape = {static_cast<std::int64_t>(constants_.channels.size()), 1, static_cast<std::int64_t>(faces())};
  constants_.values.resize(constants_.channels.size() * faces());
  double edge = 0;
  for (const auto& e : extractor_.rings().edges()) edge += static_cast<double>((rest.row(e.a) - rest.row(e.b)).norm());
  edge /= static_cast<double>(extractor_.rings().edges().size());
  reach_ = kReachEdges * edge;
  const float length = static_cast<float>(edge);
  for (std::size_t face = 0; face < faces(); ++face) {
    const auto corner = [&](Eigen::Index k) {
      return Eigen::RowVector3f(rest.row(coarse_.faces(static_cast<Eigen::Index>(face), k)));
    };
    const Eigen::RowVector3f centre = (corner(0) + corner(1) + corner(2)) / 3;
    std::size_t channel = 0;
    const auto put = [&](float value) { constants_.values[channel++ * faces() + face] = value; };
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      const float place = (2 * centre[axis] - low[axis] - high[axis]) / size;  // -1 to 1 along the longest side
      for (const float waves : {1.0F, 2.0F, 4.0F}) {
        const float angle = 1.57079633F * waves * place;
        put(std::sin(angle));
        put(std::cos(angle));
      }
    }
    for (Eigen::Index k = 0; k < 3; ++k) {
      for (Eigen::Index axis = 0; axis < 3; ++axis) put((corner(k) - centre)[axis] / length);
    }
  }
}

std::vector<std::int64_t> VertexRepresentation::input_shape() const {
  return {3 * corner_channels(), 1, static_cast<std::int64_t>(faces())};
}

std::vector<std::int64_t> VertexRepresentation::answer_shape() const {
  const std::int64_t side = patch_side(spec_.subdivision.rounds);
  return {(has_offsets() ? 3 : 0) + shape_channels(), side, side * static_cast<std::int64_t>(faces())};
}

std::vector<std::string> VertexRepresentation::input_channels() const {
  std::vector<std::string> of_vertex = feature_channel_names(extractor_.code()), names;
  for (const char* name : {"position_x", "position_y", "position_z", "velocity_x", "velocity_y", "velocity_z"}) {
    of_vertex.emplace_back(name);
  }
  if (features().obstacles) {
    for (const char* name : {"obstacle_near", "obstacle_x", "obstacle_y", "obstacle_z"}) of_vertex.emplace_back(name);
  }
  for (int k = 0; k < 3; ++k) {
    for (const std::string& name : of_vertex) names.push_back(name + "_corner" + std::to_string(k));
  }
  return names;
}

std::vector<std::string> VertexRepresentation::answer_channels() const {
  std::vector<std::string> names;
  if (has_offsets()) names = {"offset_x", "offset_y", "offset_z"};
  const bool gradients = features().answer == AnswerKind::kGradients;
  for (const std::string& name : gradients ? gradient_channels_.names() : feature_channel_names(features().rotation)) {
    names.push_back(name);
  }
  return names;
}

RigidTransform VertexRepresentation::align(const Positions& coarse) const {
  check_coarse(coarse);
  RigidTransform alignment;
  if (!features().fixed_axes) {
    alignment.rotation =
        Eigen::AngleAxisf(-heading(coarse_.rest_positions, coarse, 0), Eigen::Vector3f::UnitY()).toRotationMatrix();
  }
  alignment.translation = -(alignment.rotation * centroid(coarse));
  return alignment;
}

void VertexRepresentation::check_coarse(const Positions& coarse) const {
  if (coarse.rows() != coarse_.vertex_count()) {
    throw_invalid_argument(std::to_string(coarse.rows()) + " coarse positions for a mesh of " +
                           std::to_string(coarse_.vertex_count()) + " vertices");
  }
  for (Eigen::Index v = 0; v < coarse.rows(); ++v) {
    if (!coarse.row(v).allFinite()) {
      throw_invalid_argument("coarse positions: vertex " + std::to_string(v) + " is not finite");
    }
  }
}

void VertexRepresentation::vertex_features(const Frame& frame, const RigidTransform& alignment, bool first,
                                           Scratch& scratch) const {
  check_coarse(frame.positions);
  const std::size_t vertices = static_cast<std::size_t>(coarse_.vertex_count());
  const bool moves = frame.velocities.rows() > 0;
  if (moves && (frame.velocities.rows() != coarse_.vertex_count() || !all_finite(frame.velocities))) {
    throw_invalid_argument("frame " + std::to_string(frame.index) + ": velocities of another mesh, or not finite");
  }
  if (first) scratch.labels.clear();
  extractor_.extract(frame.positions, heading_of(alignment), scratch.labels, scratch.extracted);
  std::swap(scratch.labels, scratch.extracted.labels);
  scratch.features.resize(static_cast<std::size_t>(corner_channels()) * vertices);
  float* to = std::copy(scratch.extracted.values.begin(), scratch.extracted.values.end(), scratch.features.data());
  for (std::size_t v = 0; v < vertices; ++v) {
    const auto row = static_cast<Eigen::Index>(v);
    const Eigen::Vector3f x = alignment.rotation * frame.positions.row(row).transpose() + alignment.translation;
    const Eigen::Vector3f motion =
        moves ? Eigen::Vector3f(alignment.rotation * frame.velocities.row(row).transpose()) : Eigen::Vector3f::Zero();
    for (std::size_t c = 0; c < 3; ++c) {
      to[c * vertices + v] = x[static_cast<Eigen::Index>(c)];
      to[(3 + c) * vertices + v] = motion[static_cast<Eigen::Index>(c)];
    }
  }
}

void VertexRepresentation::obstacle_features(const Frame& frame, const RigidTransform& alignment,
                                             ObstacleField* obstacles, float* to) const {
  const auto vertices = static_cast<std::size_t>(coarse_.vertex_count());
  std::fill_n(to, 4 * vertices, 0.0F);
  if (obstacles == nullptr || obstacles->empty()) return;
  for (std::size_t v = 0; v < vertices; ++v) {
    const Eigen::Vector3d p = frame.positions.row(static_cast<Eigen::Index>(v)).cast<double>();
    const auto contact = obstacles->contact_near(p, reach_, kDepthShare * reach_);
    if (!contact) continue;
    const double near = std::clamp(1 - contact->distance / reach_, 0.0, 2.0);
    const Eigen::Vector3f away = alignment.rotation * (near * contact->normal).cast<float>();
    to[v] = static_cast<float>(near);
    for (std::size_t c = 0; c < 3; ++c) to[(1 + c) * vertices + v] = away[static_cast<Eigen::Index>(c)];
  }
}

void VertexRepresentation::encode(std::span<const Frame> frames, const RigidTransform& alignment, Tensor& input,
                                  ObstacleField* obstacles) const {
  if (static_cast<int>(frames.size()) != spec_.window) {
    throw_invalid_argument("window: " + std::to_string(frames.size()) + " frames, the representation has " +
                           std::to_string(spec_.window));
  }
  const auto channels = static_cast<std::size_t>(corner_channels());
  const auto vertices = static_cast<std::size_t>(coarse_.vertex_count());
  input.shape = input_shape();
  input.shape[0] *= spec_.window;
  if (input.channels.size() != static_cast<std::size_t>(input.shape[0])) {
    input.channels.clear();
    for (int age = spec_.window - 1; age >= 0; --age) {
      for (const std::string& name : input_channels()) {
        input.channels.push_back(age == 0 ? name : name + "_" + std::to_string(age));
      }
    }
  }
  input.values.resize(3 * channels * faces() * frames.size());
  const Pool<Scratch>::Lent scratch(scratch_);
  float* to = input.values.data();
  for (std::size_t t = 0; t < frames.size(); ++t) {
    vertex_features(frames[t], alignment, t == 0, *scratch);
    if (features().obstacles) {
      obstacle_features(frames[t], alignment, obstacles, scratch->features.data() + (channels - 4) * vertices);
    }
    for (Eigen::Index k = 0; k < 3; ++k) {
      for (std::size_t c = 0; c < channels; ++c) {
        const float* from = scratch->features.data() + c * vertices;
        for (std::size_t face = 0; face < faces(); ++face) {
          *to++ = from[coarse_.faces(static_cast<Eigen::Index>(face), k)];
        }
      }
    }
  }
}

void VertexRepresentation::gradient_planes(const Positions& aligned, Scratch& scratch,
                                           std::vector<float>& planes) const {
  load_positions(aligned, fine_rings_->vertex_count(), 0, Eigen::Vector3f::Zero(), "fine positions", scratch.aligned);
  fine_rings_->gradients(scratch.aligned.data(), scratch.field);
  gradient_channels_.to_planes(scratch.field, planes);
}

void VertexRepresentation::target(const Frame& coarse, const Frame& fine, const RigidTransform& alignment,
                                  Tensor& answer) const {
  check_coarse(coarse.positions);
  Positions base_positions;
  base(coarse.positions, alignment, base_positions);
  if (fine.positions.rows() != base_positions.rows()) {
    throw_invalid_argument(std::to_string(fine.positions.rows()) + " fine positions for a mesh of " +
                           std::to_string(base_positions.rows()) + " vertices");
  }
  const Positions positions = aligned(fine.positions, alignment);
  const Pool<Scratch>::Lent scratch(scratch_);
  const std::vector<float>* planes = &scratch->planes;
  if (features().answer == AnswerKind::kGradients) {
    gradient_planes(base_positions, *scratch, scratch->base);
    gradient_planes(positions, *scratch, scratch->planes);
    for (std::size_t i = 0; i < scratch->planes.size(); ++i) scratch->planes[i] -= scratch->base[i];
  } else {
    fine_extractor_.extract(positions, 0, {}, scratch->fine);
    planes = &scratch->fine.values;
  }
  answer.shape = answer_shape();
  answer.channels = answer_channels();
  answer.values.assign(answer.channels.size() * answer_places(), 0);
  const auto vertices = static_cast<std::size_t>(positions.rows());
  const std::size_t offsets = has_offsets() ? 3 : 0;
  for (std::size_t place = 0; place < answer_places(); ++place) {
    const std::uint32_t v = vertex_at_[place];
    if (v == kNone) continue;
    for (std::size_t c = 0; c < offsets; ++c) {
      answer.values[c * answer_places() + place] =
          positions(v, static_cast<Eigen::Index>(c)) - base_positions(v, static_cast<Eigen::Index>(c));
    }
    for (std::size_t c = 0; c < planes->size() / vertices; ++c) {
      answer.values[(offsets + c) * answer_places() + place] = (*planes)[c * vertices + v];
    }
  }
}

int VertexRepresentation::shape_channels() const {
  return features().answer == AnswerKind::kGradients ? gradient_channels_.channels() : fine_extractor_.channels();
}

void VertexRepresentation::read_planes(const Tensor& answer, bool add, Scratch& scratch) const {
  const auto vertices = static_cast<std::size_t>(fine().vertex_count());
  const std::size_t offsets = has_offsets() ? 3 : 0, channels = static_cast<std::size_t>(shape_channels());
  if (!add) scratch.planes.assign(channels * vertices, 0);
  const char* what = features().answer == AnswerKind::kGradients ? "gradient" : "feature";
  for (std::size_t c = 0; c < channels; ++c) {
    for (std::size_t v = 0; v < vertices; ++v) {
      const float value = read(answer.values.data() + (offsets + c) * answer_places(), v);
      if (!std::isfinite(value)) {
        throw_invalid_argument(std::string("answer: the ") + what + " of fine vertex " + std::to_string(v) +
                               " is not finite");
      }
      scratch.planes[c * vertices + v] += value;
    }
  }
}

float VertexRepresentation::read(const float* channel, std::size_t v) const {
  float sum = 0;
  for (std::uint32_t i = reads_.offsets[v]; i < reads_.offsets[v + 1]; ++i) {
    sum += reads_.weights[i] * channel[reads_.places[i]];
  }
  return sum;
}

void VertexRepresentation::decode(const Tensor& answer, const Positions& coarse, const RigidTransform& alignment,
                                  Positions& fine) const {
  const std::vector<std::int64_t> shape = answer_shape();
  if (answer.shape != shape || answer.values.size() != static_cast<std::size_t>(shape[0]) * answer_places()) {
    throw_invalid_argument("answer: expected (" + std::to_string(shape[0]) + ", " + std::to_string(shape[1]) + ", " +
                           std::to_string(shape[2]) + ")");
  }
  check_coarse(coarse);
  base(coarse, alignment, fine);
  const auto vertices = static_cast<std::size_t>(fine.rows());
  const bool gradients = features().answer == AnswerKind::kGradients;
  const Pool<Scratch>::Lent scratch(scratch_);
  if (gradients && features().passes > 0) gradient_planes(fine, *scratch, scratch->planes);
  for (std::size_t v = 0; v < vertices && has_offsets(); ++v) {
    for (std::size_t c = 0; c < 3; ++c) {
      fine.data()[3 * v + c] += read(answer.values.data() + c * answer_places(), v);
    }
    if (!fine.row(static_cast<Eigen::Index>(v)).allFinite()) {
      throw_invalid_argument("answer: the offset of fine vertex " + std::to_string(v) + " is not finite");
    }
  }
  if (features().passes > 0 || !has_offsets()) {
    read_planes(answer, gradients, *scratch);
    if (gradients) {
      gradient_channels_.from_planes(scratch->planes, scratch->field);
    } else {
      gradients_from_features(features().rotation, scratch->planes, scratch->field);
    }
    clamp_stretch(scratch->field);
    if (has_offsets()) {
      solver_.correct(scratch->field, features().passes, scratch->coordinates, fine);
    } else {
      solver_.solve(scratch->field, Positions(0, 3), aligned(coarse, alignment), features().passes,
                    scratch->coordinates, fine);
    }
  }
  fine = ((fine.rowwise() - alignment.translation.transpose()) * alignment.rotation).eval();
}

void VertexRepresentation::answer_axes(const Positions&, const RigidTransform&, Tensor& axes) const { axes = {}; }

void VertexRepresentation::base(const Positions& coarse, const RigidTransform& alignment, Positions& fine) const {
  upsample(subdivision_, coarse_.faces, aligned(coarse, alignment), fine);
}

std::size_t VertexRepresentation::size() const {
  // Both solvers' rows and the factor are some tens of numbers a vertex.
  return 32 * static_cast<std::size_t>(fine().vertex_count()) + 4 * answer_places() + constants_.values.size();
}

}  // namespace pleat::conversion
