#include "services/simulation/multilevel.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

namespace pleat::simulation {
namespace {

using Weights = std::vector<std::pair<std::uint32_t, float>>;

struct Entry {
  std::uint32_t row, source;
  float weight;
};

template <typename Term>
void compress(std::vector<Entry>& entries, std::size_t rows, std::vector<std::uint32_t>& begin,
              std::vector<Term>& terms) {
  std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.row < b.row; });
  begin.assign(rows + 1, 0);
  for (const Entry& e : entries) {
    ++begin[e.row + 1];
    terms.push_back({e.source, e.weight});
  }
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
}

}  // namespace

Multilevel::Multilevel(std::span<const std::uint32_t> level_sizes, std::span<const std::array<std::uint32_t, 2>> ends,
                       std::span<const std::uint32_t> place,
                       std::span<const std::pair<std::uint32_t, std::uint32_t>> pairs, const BlockMatrix& matrix)
    : ends_(ends.begin(), ends.end()) {
  if (level_sizes.size() < 2) return;
  levels_.resize(level_sizes.size() - 1);
  // Each vertex of the finest level as a combination of the current one's.
  std::vector<Weights> weights(level_sizes.back());  // by place
  for (std::uint32_t v = 0; v < weights.size(); ++v) weights[place[v]] = {{v, 1.0f}};
  for (std::size_t l = levels_.size(); l-- > 0;) {
    Level& level = levels_[l];
    level.size = level_sizes[l];
    level.next_size = level_sizes[l + 1];
    std::vector<std::vector<std::uint32_t>> children(level.size);
    for (auto m = static_cast<std::uint32_t>(level.size); m < level.next_size; ++m) {
      for (const std::uint32_t end : ends_[m]) children[end].push_back(m);
    }
    const bool last = l + 1 == levels_.size();
    level.places.resize(level.next_size);
    for (std::uint32_t v = 0; v < level.next_size; ++v) level.places[v] = last ? place[v] : v;
    level.child_begin.push_back(0);
    for (const auto& list : children) {
      for (const std::uint32_t child : list) level.children.push_back(level.places[child]);
      level.child_begin.push_back(static_cast<std::uint32_t>(level.children.size()));
    }
    for (Weights& combination : weights) {
      Weights coarser;
      const auto add = [&](std::uint32_t vertex, float weight) {
        const auto known =
            std::find_if(coarser.begin(), coarser.end(), [&](const auto& e) { return e.first == vertex; });
        if (known == coarser.end()) {
          coarser.push_back({vertex, weight});
        } else {
          known->second += weight;
        }
      };
      for (const auto& [vertex, weight] : combination) {
        if (vertex < level.size) {
          add(vertex, weight);
        } else {
          for (const std::uint32_t end : ends_[vertex]) add(end, weight / 2);
        }
      }
      combination = std::move(coarser);
    }
    std::vector<Entry> diagonal, off_diagonal;
    for (std::uint32_t v = 0; v < weights.size(); ++v) {
      for (const auto& [i, w] : weights[v]) diagonal.push_back({i, v, w * w});
    }
    for (std::size_t p = 0; p < pairs.size(); ++p) {
      for (const auto& [i, wi] : weights[pairs[p].first]) {
        for (const auto& [j, wj] : weights[pairs[p].second]) {
          if (i == j) off_diagonal.push_back({i, matrix.upper_slot(p), wi * wj});
        }
      }
    }
    compress(diagonal, level.size, level.diagonal_begin, level.diagonal_terms);
    compress(off_diagonal, level.size, level.pair_begin, level.pair_terms);
    level.inverse.assign(9 * level.size + 1, 0);
    level.residual.assign(level.size, Float4{});
    level.correction.assign(level.size, Float4{});
  }
}

void Multilevel::add_averages(const Averages& averages) {
  if (levels_.empty()) return;
  const Level& finest = levels_.back();
  std::vector<std::uint32_t> vertex_at(finest.next_size);
  for (std::uint32_t v = 0; v < finest.next_size; ++v) vertex_at[finest.places[v]] = v;
  for (Level& level : levels_) level.averages.assign(level.size, 0);
  // P^T phi_v, level by level: entries at vertices, those of the coarser level remain.
  std::vector<double> restricted(finest.next_size, 0);
  std::vector<std::uint32_t> entries, coarser;
  for (std::size_t v = 0; v < averages.count(); ++v) {
    entries.clear();
    const auto add = [&](std::vector<std::uint32_t>& list, std::uint32_t vertex, double weight) {
      if (restricted[vertex] == 0) list.push_back(vertex);
      restricted[vertex] += weight;
    };
    for (const auto& [place, weight] : averages.weights(v)) {
      add(entries, vertex_at[place], static_cast<double>(weight));
    }
    for (std::size_t l = levels_.size(); l-- > 0;) {
      Level& level = levels_[l];
      coarser.clear();
      for (const std::uint32_t vertex : entries) {
        if (vertex < level.size) coarser.push_back(vertex);
      }
      for (const std::uint32_t vertex : entries) {
        if (vertex < level.size) continue;
        const double half = std::exchange(restricted[vertex], 0) / 2;
        for (const std::uint32_t end : ends_[vertex]) add(coarser, end, half);
      }
      for (const std::uint32_t vertex : coarser) {
        level.averages[vertex] += static_cast<float>(averages.mass(v) * restricted[vertex] * restricted[vertex]);
      }
      entries.swap(coarser);
    }
    for (const std::uint32_t vertex : entries) restricted[vertex] = 0;
  }
}

void Multilevel::update(const BlockMatrix& matrix, float averages_scale, ThreadPool& pool) {
  for (Level& level : levels_) {
    pool.parallel_for(level.size, kVertexGrain / 4, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        Float4 c[3] = {}, t[3] = {};
        for (std::uint32_t n = level.diagonal_begin[i]; n < level.diagonal_begin[i + 1]; ++n) {
          const float* block = matrix.diagonal(level.diagonal_terms[n].source);
          for (std::size_t k = 0; k < 3; ++k) c[k] += level.diagonal_terms[n].weight * BlockMatrix::load(block + 3 * k);
        }
        for (std::uint32_t n = level.pair_begin[i]; n < level.pair_begin[i + 1]; ++n) {
          const float* block = matrix.block(level.pair_terms[n].source);
          for (std::size_t k = 0; k < 3; ++k) t[k] += level.pair_terms[n].weight * BlockMatrix::load(block + 3 * k);
        }
        float sum[9];
        for (int column = 0; column < 3; ++column) {
          for (int row = 0; row < 3; ++row) sum[3 * column + row] = c[column][row] + t[column][row] + t[row][column];
        }
        if (!level.averages.empty()) {
          for (int k = 0; k < 3; ++k) sum[4 * k] += averages_scale * level.averages[i];
        }
        float inverse[9];
        invert_block(sum, inverse);
        std::copy(inverse, inverse + 9, level.inverse.data() + 9 * i);
      }
    });
  }
}

void Multilevel::add_corrections(std::span<const Float4> r, std::span<const char> fixed, std::span<Float4> z,
                                 ThreadPool& pool) {
  for (std::size_t l = levels_.size(); l-- > 0;) {
    Level& level = levels_[l];
    const std::span<const Float4> finer =
        l + 1 == levels_.size() ? r : std::span<const Float4>(levels_[l + 1].residual);
    pool.parallel_for(level.size, kVertexGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        Float4 sum{};
        for (std::uint32_t c = level.child_begin[i]; c < level.child_begin[i + 1]; ++c) sum += finer[level.children[c]];
        level.residual[i] = finer[level.places[i]] + 0.5f * sum;
        Float4 correction = BlockMatrix::apply(level.inverse.data() + 9 * i, level.residual[i]);
        correction[3] = 0;
        level.correction[i] = correction;
      }
    });
  }
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    const Level& level = levels_[l];
    const bool last = l + 1 == levels_.size();
    const std::span<Float4> finer = last ? z : std::span<Float4>(levels_[l + 1].correction);
    pool.parallel_for(level.next_size, kVertexGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const std::uint32_t at = level.places[i];
        if (last && fixed[at]) continue;
        finer[at] += i < level.size ? level.correction[i]
                                    : 0.5f * (level.correction[ends_[i][0]] + level.correction[ends_[i][1]]);
      }
    });
  }
}

}  // namespace pleat::simulation
