#include "services/fold/tracking.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "services/fold/lanes.hpp"

namespace pleat::fold {
namespace {

// At large, in averages over many rings, the coarse cloth is followed as well: what acts on the cloth there (weight,
// wind, whatever moved it) is the coarse cloth's affair. Where it is near, only its motion; as it gets farther, its
// place too, with a frequency that grows to kLargeFrequency (rad/s) at kLargeLack (m). At least critically damped.
constexpr float kLargeFrequency = 16, kLargeLack = 0.2f, kLargeDamping = 30;
constexpr int kLargeRounds = 8;
// A coarse cloth that is thrown about leaves the fine one behind, which then is too long for where it is drawn to and
// crumples. Averages that are farther than kNear (m) follow harder, from twice that on with kFarFrequency (rad/s),
// critically damped.
constexpr float kNear = 0.06f, kFarFrequency = 25;

}  // namespace

Tracking::Tracking(const Topology& coarse, const Subdivision& subdivision, std::span<const float> masses)
    : corners_(masses.size()), rings_(coarse), viscosity_(coarse) {
  const auto coarse_count = static_cast<std::size_t>(coarse.vertex_count());
  std::vector<float> hat(coarse_count, 0);
  for (std::uint32_t i = 0; i < corners_.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      const auto corner = static_cast<Eigen::Index>(k);
      corners_[i].coarse[k] = coarse.faces(subdivision.parent_face[i], corner);
      corners_[i].weight[k] = subdivision.barycentric(i, corner);
      hat[corners_[i].coarse[k]] += masses[i] * corners_[i].weight[k];
    }
  }
  for (std::uint32_t i = 0; i < corners_.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      const float mass = hat[corners_[i].coarse[k]];
      corners_[i].share[k] = mass > 0 ? masses[i] * corners_[i].weight[k] / mass : 0;
    }
  }
  for (auto* buffer : {&averages_, &large_, &moves_, &smoothed_, &holds_}) buffer->assign(coarse_count, Float4{});
}

void Tracking::begin() {
  for (auto* buffer : {&averages_, &large_, &moves_}) std::fill(buffer->begin(), buffer->end(), Float4{});
}

void Tracking::smooth(std::span<const Float4> values, std::span<Float4> smoothed) {
  std::fill(smoothed_.begin(), smoothed_.end(), Float4{});
  for (std::uint32_t i = 0; i < corners_.size(); ++i) {
    const Corners& c = corners_[i];
    for (std::size_t k = 0; k < 3; ++k) smoothed_[c.coarse[k]] += c.share[k] * values[i];
  }
  for (std::uint32_t i = 0; i < corners_.size(); ++i) {
    const Corners& c = corners_[i];
    smoothed[i] = Float4{};
    for (std::size_t k = 0; k < 3; ++k) smoothed[i] += c.weight[k] * smoothed_[c.coarse[k]];
  }
}

void Tracking::set_touching(std::span<const float> touching) {
  touching_.assign(touching.begin(), touching.end());
  held_.clear();
  for (std::uint32_t i = 0; i < corners_.size(); ++i) {
    const auto& at = corners_[i].coarse;
    if (touching_[at[0]] + touching_[at[1]] + touching_[at[2]] > 0) held_.push_back(i);
  }
}

void Tracking::finish(float frequency, float time_s) {
  for (std::size_t c = 0; c < averages_.size(); ++c) {
    const float lack = std::sqrt(dot(averages_[c], averages_[c]));
    const Float4 velocity = large_[c];
    const float large = kLargeFrequency * std::min(1.0f, lack / kLargeLack);
    large_[c] = large * large * averages_[c] + std::max(kLargeDamping, 2 * large) * large_[c];
    const float far = std::clamp(lack / kNear - 1, 0.0f, 1.0f);
    const float own = frequency + far * std::max(0.0f, kFarFrequency - frequency);
    averages_[c] = own * own * averages_[c] + 2 * far * own * velocity;
  }
  for (int round = 0; round < kLargeRounds; ++round) {
    for (std::uint32_t c = 0; c < large_.size(); ++c) {
      const std::span<const std::uint32_t> ring = rings_.of(c);
      Float4 sum = large_[c];
      for (const std::uint32_t r : ring) sum += large_[r];
      smoothed_[c] = sum / static_cast<float>(1 + ring.size());
    }
    std::swap(large_, smoothed_);
  }
  const float viscous = viscosity_.share(time_s) / time_s;
  for (std::uint32_t c = 0; c < averages_.size(); ++c) averages_[c] += large_[c] + viscous * viscosity_.lack(c, moves_);
}

}  // namespace pleat::fold
