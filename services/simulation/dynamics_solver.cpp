// The linear solvers of Dynamics, and its step.
#include <algorithm>
#include <chrono>
#include <numeric>

#include "services/simulation/dynamics.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using Clock = std::chrono::steady_clock;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

double dot(Float4 a, Float4 b) {
  return static_cast<double>(a[0]) * b[0] + static_cast<double>(a[1]) * b[1] + static_cast<double>(a[2]) * b[2];
}

}  // namespace

// The part in A y of the contacts that the matrix does not have. Returns y . (that part).
double Dynamics::add_contacts(const Step& step, std::span<const Float4> y, std::span<Float4> product) const {
  const auto h = static_cast<float>(step.length_s);
  double energy = 0;
  for (const ContactForce& contact : outside_) {
    Float4 sum{};
    for (std::size_t k = 0; k < 4; ++k) {
      if (contact.vertices[k] != kNone) sum += contact.weights[k] * y[contact.vertices[k]];
    }
    const Float4 normal = to_float4(contact.normal);
    const auto along = static_cast<float>(dot(normal, sum));
    const Float4 result =
        (h * h * contact.stiffness - h * contact.friction) * along * normal + h * contact.friction * sum;
    energy += dot(result, sum);
    for (std::size_t k = 0; k < 4; ++k) {
      const std::uint32_t i = contact.vertices[k];
      if (i != kNone && !fixed_[i]) product[i] += contact.weights[k] * result;
    }
  }
  return energy;
}

int Dynamics::conjugate_gradients(const Step& step, ThreadPool& pool) {
  const std::size_t n = vertex_count();
  const std::size_t ranges = (n + kVertexGrain - 1) / kVertexGrain;
  std::vector<double> partial(ranges), partial2(ranges);
  const auto total = [](const std::vector<double>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0);
  };
  const auto multiply_row = [&](std::size_t i, const std::vector<Float4>& y) {
    if (fixed_[i]) return Float4{};
    const Float4 row = matrix_.multiply_row(i, y.data());
    return averages_scale_ > 0 ? row + averages_scale_ * averages_.pull_at(i) : row;
  };

  // The start: last step's change (prescribed values at fixed vertices). Residual r = b - A x.
  if (averages_scale_ > 0) averages_.gather(change_, pool);
  pool.parallel_for(n, kVertexGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) product_[i] = multiply_row(i, change_);
  });
  add_contacts(step, change_, product_);
  pool.parallel_for(n, kVertexGrain, [&](std::size_t begin, std::size_t end) {
    double rz = 0, bz = 0;
    for (std::size_t i = begin; i < end; ++i) {
      if (fixed_[i]) {
        residual_[i] = direction_[i] = Float4{};
        continue;
      }
      Float4 b = right_side_[i];
      b[3] = 0;
      residual_[i] = b - product_[i];
      residual_[i][3] = 0;
      const float* inverse = inverse_diagonal_.data() + 9 * i;
      Float4 z = BlockMatrix::apply(inverse, residual_[i]);
      z[3] = 0;
      direction_[i] = z;
      rz += dot(residual_[i], z);
      bz += dot(b, BlockMatrix::apply(inverse, b));
    }
    partial[begin / kVertexGrain] = rz;
    partial2[begin / kVertexGrain] = bz;
  });
  // With coarser levels: their corrections, and the product with the residual anew.
  const auto correct = [&](std::vector<Float4>& z) {
    multilevel_.add_corrections(residual_, fixed_, z, pool);
    pool.parallel_for(n, kVertexGrain, [&](std::size_t begin, std::size_t end) {
      double sum = 0;
      for (std::size_t i = begin; i < end; ++i) sum += dot(residual_[i], z[i]);
      partial[begin / kVertexGrain] = sum;
    });
  };
  if (!multilevel_.empty()) {
    multilevel_.update(matrix_, averages_scale_, pool);
    correct(direction_);
  }
  double rz = total(partial);
  const double target = step.tolerance * step.tolerance * total(partial2);

  int iteration = 0;
  for (; iteration < step.max_iterations && rz > target; ++iteration) {
    if (averages_scale_ > 0) averages_.gather(direction_, pool);
    pool.parallel_for(n, kVertexGrain, [&](std::size_t begin, std::size_t end) {
      double sum = 0;
      for (std::size_t i = begin; i < end; ++i) {
        product_[i] = multiply_row(i, direction_);
        sum += dot(product_[i], direction_[i]);
      }
      partial[begin / kVertexGrain] = sum;
    });
    double energy = total(partial);
    energy += add_contacts(step, direction_, product_);
    if (!(energy > 0)) break;  // float32 is exhausted
    const auto alpha = static_cast<float>(rz / energy);
    pool.parallel_for(n, kVertexGrain, [&](std::size_t begin, std::size_t end) {
      double sum = 0;
      for (std::size_t i = begin; i < end; ++i) {
        change_[i] += alpha * direction_[i];
        Float4 r = residual_[i] - alpha * product_[i];
        r[3] = 0;
        residual_[i] = r;
        Float4 z = BlockMatrix::apply(inverse_diagonal_.data() + 9 * i, r);
        z[3] = 0;
        preconditioned_[i] = z;
        sum += dot(r, z);
      }
      partial[begin / kVertexGrain] = sum;
    });
    if (!multilevel_.empty()) correct(preconditioned_);
    const double next = total(partial);
    const auto beta = static_cast<float>(next / rz);
    rz = next;
    pool.parallel_for(n, kVertexGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) direction_[i] = preconditioned_[i] + beta * direction_[i];
    });
  }
  correct_translation(step);
  return iteration;
}

// The same with symmetric Gauss-Seidel sweeps as the preconditioner, for a mesh without coarser levels: with A = L + D
// + L^T + C, C the contacts and E the diagonal blocks of both, P = (E + L) E^-1 (E + L^T). In the variables (E + L^T)
// x, with residuals (E + L)^-1 r, the operator is (Eisenstat 1981)
//   p -> t + (E + L)^-1 (p - (2 E - D) t + C t),  t = (E + L^T)^-1 p,
// so that an iteration costs what one product with A does. One thread: a sweep takes the vertices in their order.
int Dynamics::swept_conjugate_gradients(const Step& step) {
  const std::size_t n = vertex_count();
  const auto inverse = [&](std::size_t i, Float4 x) {
    Float4 y = BlockMatrix::apply(inverse_diagonal_.data() + 9 * i, x);
    y[3] = 0;
    return y;
  };
  const auto whole = [&](std::size_t i, Float4 x) {
    Float4 y = BlockMatrix::apply(whole_diagonal_.data() + 9 * i, x);
    y[3] = 0;
    return y;
  };
  // Solves row i of (E + L) y = x. The nearest rows, which were solved last, come last.
  const auto solve_down = [&](std::size_t i, Float4 x, std::span<const Float4> y) {
    std::uint32_t slot = matrix_.row_begin(i);
    for (; slot < matrix_.row_end(i) && matrix_.column(slot) < i; ++slot) {
      x -= BlockMatrix::apply(matrix_.block(slot), y[matrix_.column(slot)]);
    }
    return inverse(i, x);
  };
  const auto solve_up = [&](std::size_t i, Float4 x, std::span<const Float4> y) {
    for (std::uint32_t slot = matrix_.row_end(i); slot-- > matrix_.row_begin(i) && matrix_.column(slot) > i;) {
      x -= BlockMatrix::apply(matrix_.block(slot), y[matrix_.column(slot)]);
    }
    return inverse(i, x);
  };

  // The start: last step's change. residual_ = (E + L)^-1 (b - A x); product_ holds the same of b.
  for (std::size_t i = 0; i < n; ++i) {
    preconditioned_[i] = fixed_[i] ? Float4{} : matrix_.multiply_row(i, change_.data());
  }
  add_contacts(step, change_, preconditioned_);
  double rz = 0, bz = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (fixed_[i]) {
      residual_[i] = product_[i] = direction_[i] = Float4{};
      continue;
    }
    residual_[i] = solve_down(i, right_side_[i] - preconditioned_[i], residual_);
    product_[i] = solve_down(i, right_side_[i], product_);
    direction_[i] = whole(i, residual_[i]);
    rz += dot(residual_[i], direction_[i]);
    bz += dot(product_[i], whole(i, product_[i]));
  }
  const double target = step.tolerance * step.tolerance * bz;

  std::vector<Float4>& swept = preconditioned_;  // t
  int iteration = 0;
  for (; iteration < step.max_iterations && rz > target; ++iteration) {
    for (std::size_t i = n; i-- > 0;) {
      if (fixed_[i]) {
        swept[i] = product_[i] = Float4{};
        continue;
      }
      swept[i] = solve_up(i, direction_[i], swept);
      product_[i] = direction_[i] - 2 * whole(i, swept[i]) + BlockMatrix::apply(matrix_.diagonal(i), swept[i]);
    }
    add_contacts(step, swept, product_);
    double energy = 0;
    std::vector<Float4>& down = solved_;
    for (std::size_t i = 0; i < n; ++i) {
      down[i] = fixed_[i] ? Float4{} : solve_down(i, product_[i], down);
      product_[i] = swept[i] + down[i];
      energy += dot(product_[i], direction_[i]);
    }
    if (!(energy > 0)) break;  // float32 is exhausted
    const auto alpha = static_cast<float>(rz / energy);
    double next = 0;
    for (std::size_t i = 0; i < n; ++i) {
      change_[i] += alpha * swept[i];
      residual_[i] -= alpha * product_[i];
      const Float4 z = whole(i, residual_[i]);
      swept[i] = z;
      next += dot(residual_[i], z);
    }
    const auto beta = static_cast<float>(next / rz);
    rz = next;
    for (std::size_t i = 0; i < n; ++i) direction_[i] = swept[i] + beta * direction_[i];
  }
  // (E + L) times the residual is that of A x = b.
  for (std::size_t i = n; i-- > 0;) {
    if (fixed_[i]) continue;
    Float4 r = whole(i, residual_[i]);
    for (std::uint32_t slot = matrix_.row_begin(i); slot < matrix_.row_end(i) && matrix_.column(slot) < i; ++slot) {
      r += BlockMatrix::apply(matrix_.block(slot), residual_[matrix_.column(slot)]);
    }
    r[3] = 0;
    residual_[i] = r;
  }
  correct_translation(step);
  return iteration;
}

// What the iterations leave over must not change the momentum: the best common velocity for all vertices, which alone
// solves the sum of all rows. Elastic forces and contacts of cloth with cloth drop out of it.
void Dynamics::correct_translation(const Step& step) {
  if (std::any_of(fixed_.begin(), fixed_.end(), [](char fixed) { return fixed != 0; })) return;
  const double h = step.length_s;
  Eigen::Matrix3d sum = Eigen::Matrix3d::Identity() * std::accumulate(masses_.begin(), masses_.end(), 0.0);
  for (const Pin& pin : step.pins) sum.diagonal().array() += h * h * pin.stiffness;
  sum.diagonal().array() += static_cast<double>(averages_scale_) * averages_.total_mass();
  for (const ContactForce& contact : contacts_) {
    float weight = 0;
    for (std::size_t k = 0; k < 4; ++k) weight += contact.vertices[k] == kNone ? 0 : contact.weights[k];
    sum += static_cast<double>(weight * weight) * contact.velocity_block(static_cast<float>(h)).cast<double>();
  }
  Double4 residual{};
  for (const Float4& r : residual_) residual += __builtin_convertvector(r, Double4);
  const Vector3d velocity = sum.inverse() * Vector3d(residual[0], residual[1], residual[2]);
  if (!velocity.allFinite()) return;
  for (Float4& change : change_) change += to_float4(velocity);
}

int Dynamics::solve(const Points& positions, Points& velocities, const Step& step, ThreadPool& pool) {
  const auto start = Clock::now();
  assemble(positions, velocities, step, pool);
  assembly_ms_ = milliseconds_since(start);
  const auto middle = Clock::now();
  const bool small = vertex_count() < kWorthThreads;
  const bool sweeps = small && multilevel_.empty() && averages_scale_ == 0;
  const int iterations = sweeps ? swept_conjugate_gradients(step) : conjugate_gradients(step, small ? alone_ : pool);
  for (std::size_t i = 0; i < vertex_count(); ++i) {
    const Float4 dv = change_[place_[i]];
    velocities[i] += Vector3d(static_cast<double>(dv[0]), static_cast<double>(dv[1]), static_cast<double>(dv[2]));
  }
  solve_ms_ = milliseconds_since(middle);
  return iterations;
}

}  // namespace pleat::simulation
