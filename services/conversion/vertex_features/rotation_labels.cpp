#include "services/conversion/vertex_features/rotation_labels.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <queue>

#include "services/conversion/vertex_features/vectors.hpp"

namespace pleat::conversion {
namespace {

constexpr float kPi = std::numbers::pi_v<float>, kTurn = 2 * kPi;
constexpr float kNoAxis = 0.05f;  // rad: below, an axis is mostly noise
constexpr int kSweeps = 20, kClearedRings = 2;

float squared_distance(Float4 a, Float4 b) { return dot4(a - b, a - b); }

}  // namespace

RotationLabels::RotationLabels(RotationCode code, std::size_t vertex_count,
                               const std::vector<OneRings::WeightedEdge>& edges, float temporal_weight)
    : code_(code),
      temporal_weight_(temporal_weight),
      torn_squared_(code == RotationCode::kLogarithm ? kPi * kPi : 2),
      offsets_(vertex_count + 1, 0),
      neighbours_(2 * edges.size()) {
  for (const auto& e : edges) {
    edges_.push_back({e.a, e.b});
    ++offsets_[e.a + 1];
    ++offsets_[e.b + 1];
  }
  for (std::size_t v = 0; v < vertex_count; ++v) offsets_[v + 1] += offsets_[v];
  std::vector<std::uint32_t> next(offsets_.begin(), offsets_.end() - 1);
  for (const auto& [a, b] : edges_) {
    neighbours_[next[a]++] = b;
    neighbours_[next[b]++] = a;
  }
}

Float4 RotationLabels::pick(Float4 rotation, Float4 target) const {
  if (code_ == RotationCode::kQuaternion) return dot4(rotation, target) < 0 ? -rotation : rotation;
  const float angle = rotation[3];
  const Float4 axis{rotation[0], rotation[1], rotation[2], 0};
  const float along = dot4(axis, target);
  if (angle < kNoAxis) {
    const float length = std::sqrt(dot4(target, target));
    if (length > kPi) {
      return target * ((kTurn * std::nearbyint(length / kTurn) + angle * along / length) / length);
    }
  }
  return axis * (angle + kTurn * std::nearbyint((along - angle) / kTurn));
}

LabelReport RotationLabels::label(std::span<const Float4> rotations, std::span<const Float4> previous,
                                  std::vector<Float4>& labels) const {
  const std::size_t count = rotations.size();
  labels.resize(count);
  LabelReport report;
  const Frame frame{rotations, previous};
  const auto grow_all = [&](std::vector<Float4>& result) {
    std::vector<std::uint8_t> labelled(count, 0);
    grow(frame, labelled, result);
  };
  if (previous.empty()) {
    grow_all(labels);
  } else {
    for (std::size_t v = 0; v < count; ++v) labels[v] = pick(rotations[v], previous[v]);
  }
  report.torn_edges = count_torn(labels);
  if (report.torn_edges > 0) {
    report.torn_by_time = previous.empty() ? 0 : report.torn_edges;
    std::vector<Float4> attempt = labels;
    const auto keep_better = [&] {
      const std::size_t torn = count_torn(attempt);
      if (torn < report.torn_edges) {
        report.torn_edges = torn;
        labels = attempt;
      }
      return report.torn_edges == 0;
    };
    const auto regrow = [&] {
      std::vector<std::uint8_t> labelled = away_from_torn(attempt);
      grow(frame, labelled, attempt);
      relax(frame, attempt);
    };
    relax(frame, attempt);
    if (!keep_better()) {
      regrow();
      if (!keep_better() && !previous.empty()) {
        grow_all(attempt);
        keep_better();
      }
    }
  }
  for (const auto& [a, b] : edges_) {
    report.largest_jump = std::max(report.largest_jump, squared_distance(labels[a], labels[b]));
  }
  for (std::size_t v = 0; v < previous.size(); ++v) {
    report.largest_step = std::max(report.largest_step, squared_distance(labels[v], previous[v]));
  }
  report.largest_jump = std::sqrt(report.largest_jump);
  report.largest_step = std::sqrt(report.largest_step);
  return report;
}

std::size_t RotationLabels::count_torn(const std::vector<Float4>& labels) const {
  std::size_t torn = 0;
  for (const auto& [a, b] : edges_) torn += squared_distance(labels[a], labels[b]) > torn_squared_ ? 1 : 0;
  return torn;
}

float RotationLabels::energy_at(const Frame& frame, const std::vector<Float4>& labels, std::size_t vertex,
                                Float4 label) const {
  float energy = frame.previous.empty() ? 0 : temporal_weight_ * squared_distance(label, frame.previous[vertex]);
  for (const std::uint32_t j : neighbours(vertex)) energy += squared_distance(label, labels[j]);
  return energy;
}

void RotationLabels::relax(const Frame& frame, std::vector<Float4>& labels) const {
  bool changed = true;
  for (int sweep = 0; sweep < kSweeps && changed; ++sweep) {
    changed = false;
    for (std::size_t v = 0; v < labels.size(); ++v) {
      Float4 sum{};
      auto weight = static_cast<float>(neighbours(v).size());
      for (const std::uint32_t j : neighbours(v)) sum += labels[j];
      if (!frame.previous.empty()) {
        sum += temporal_weight_ * frame.previous[v];
        weight += temporal_weight_;
      }
      const Float4 better = pick(frame.rotations[v], sum / weight);
      // Other names are far off, so that what rounding changes is no change.
      if (squared_distance(better, labels[v]) < 1e-6f) continue;
      if (energy_at(frame, labels, v, better) < energy_at(frame, labels, v, labels[v])) {
        labels[v] = better;
        changed = true;
      }
    }
  }
}

float RotationLabels::smallness(Float4 rotation) const {
  return code_ == RotationCode::kLogarithm ? rotation[3] : -std::abs(rotation[0]);
}

void RotationLabels::grow(const Frame& frame, std::vector<std::uint8_t>& labelled, std::vector<Float4>& labels) const {
  struct Step {
    float jump;
    std::uint32_t vertex, from;
    bool operator>(const Step& other) const {
      return std::tie(jump, vertex, from) > std::tie(other.jump, other.vertex, other.from);
    }
  };
  std::priority_queue<Step, std::vector<Step>, std::greater<>> steps;
  const auto offer_neighbours = [&](std::uint32_t v) {
    for (const std::uint32_t j : neighbours(v)) {
      if (labelled[j] == 0) {
        steps.push({squared_distance(pick(frame.rotations[j], labels[v]), labels[v]), j, v});
      }
    }
  };
  const auto spread = [&] {
    while (!steps.empty()) {
      const Step step = steps.top();
      steps.pop();
      if (labelled[step.vertex] != 0) continue;
      labels[step.vertex] = pick(frame.rotations[step.vertex], labels[step.from]);
      labelled[step.vertex] = 1;
      offer_neighbours(step.vertex);
    }
  };
  for (std::uint32_t v = 0; v < labelled.size(); ++v) {
    if (labelled[v] != 0) offer_neighbours(v);
  }
  spread();
  std::vector<std::uint32_t> seeds;
  for (std::uint32_t v = 0; v < labelled.size(); ++v) {
    if (labelled[v] == 0) seeds.push_back(v);
  }
  std::stable_sort(seeds.begin(), seeds.end(), [&](std::uint32_t a, std::uint32_t b) {
    return smallness(frame.rotations[a]) < smallness(frame.rotations[b]);
  });
  for (const std::uint32_t seed : seeds) {
    if (labelled[seed] != 0) continue;
    // Only a first frame has no history: there the seed gets the name of the smallest angle.
    const Float4 nearest =
        frame.previous.empty() ? Float4{code_ == RotationCode::kQuaternion ? 1.0f : 0.0f} : frame.previous[seed];
    labels[seed] = pick(frame.rotations[seed], nearest);
    labelled[seed] = 1;
    offer_neighbours(seed);
    spread();
  }
}

std::vector<std::uint8_t> RotationLabels::away_from_torn(const std::vector<Float4>& labels) const {
  std::vector<std::uint8_t> away(labels.size(), 1);
  for (const auto& [a, b] : edges_) {
    if (squared_distance(labels[a], labels[b]) > torn_squared_) away[a] = away[b] = 0;
  }
  for (int ring = 0; ring < kClearedRings; ++ring) {
    const std::vector<std::uint8_t> inner = away;
    for (std::size_t v = 0; v < away.size(); ++v) {
      if (inner[v] != 0) continue;
      for (const std::uint32_t j : neighbours(v)) away[j] = 0;
    }
  }
  return away;
}

}  // namespace pleat::conversion
