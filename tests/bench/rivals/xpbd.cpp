#include "tests/bench/rivals/xpbd.hpp"

#include <algorithm>

namespace pleat::bench {

Xpbd::Xpbd(const simulation::Scene& scene, const Topology& garment, const Positions& start, int substeps)
    : RivalCloth(scene, garment, start), substeps_(substeps) {
  const auto nowhere = static_cast<std::uint32_t>(garment.vertex_count());
  const auto fill = [&](const auto& elements, auto& packs, auto& mobilities) {
    for (const auto& members : independent_packs(std::span(elements))) {
      auto& pack = packs.emplace_back(nowhere);
      auto& mobility = mobilities.emplace_back();
      for (std::size_t lane = 0; lane < members.size(); ++lane) {
        const auto& element = elements[members[lane]];
        pack.set(lane, element.v, element.rest);
      }
      for (std::size_t k = 0; k < pack.v.size(); ++k) {
        for (std::size_t lane = 0; lane < kLanes; ++lane) {
          mobility.w[k][static_cast<int>(lane)] = inverse_masses_[pack.v[k][lane]];
        }
      }
    }
  };
  fill(faces_, face_packs_, face_mobilities_);
  fill(hinges_, hinge_packs_, hinge_mobilities_);
}

void Xpbd::advance(double step_s, std::span<const simulation::ContactForce> contacts) {
  const double h = step_s / substeps_;
  const auto hf = static_cast<float>(h);
  step_start_ = x_;
  // The air changes little within a contact step, and costs as much as half a sub-step.
  find_accelerations(step_s, accelerations_);
  for (int s = 0; s < substeps_; ++s) {
    before_ = x_;
    for (std::size_t v = 0; v + 1 < x_.size(); ++v) x_[v] += h * (v_[v] + h * accelerations_[v]);
    solve_faces(hf * hf);
    solve_hinges(hf * hf);
    solve_pins(hf * hf);
    solve_contacts(hf, contacts);
    for (std::size_t v = 0; v + 1 < x_.size(); ++v) v_[v] = (x_[v] - before_[v]) / h;
  }
}

// With J the gradients of the strains G (3), W the inverse masses, K the 3x3 stiffness of the energy in G:
// (1/(h^2) K^-1 + J W J^T) lambda = -G. K may be singular, so we solve (1 + h^2 J W J^T K) s = G, lambda = -h^2 K s.
void Xpbd::solve_faces(float h2) {
  for (std::size_t p = 0; p < face_packs_.size(); ++p) {
    const Face8& face = face_packs_[p];
    const auto& w = face_mobilities_[p].w;
    const Strain8 e(face, x_, table_);
    const Float8 uu = 2 * e.g00 + 1, vv = 2 * e.g11 + 1, uv = 2 * e.g01;
    Float8 saa{}, sab{}, sbb{};
    for (std::size_t k = 0; k < 3; ++k) {
      saa += w[k] * face.du[k] * face.du[k];
      sab += w[k] * face.du[k] * face.dv[k];
      sbb += w[k] * face.dv[k] * face.dv[k];
    }
    const Float8 a00 = saa * uu, a01 = sab * uv, a02 = 0.5f * (saa * uv + sab * uu), a11 = sbb * vv,
                 a12 = 0.5f * (sab * vv + sbb * uv), a22 = 0.25f * (saa * vv + 2 * sab * uv + sbb * uu);
    const Float8 k00 = h2 * face.area * e.moduli.c11, k01 = h2 * face.area * e.moduli.c12,
                 k11 = h2 * face.area * e.moduli.c22, k22 = 2 * h2 * face.area * e.moduli.c33;
    const Float8 m00 = 1 + a00 * k00 + a01 * k01, m01 = a00 * k01 + a01 * k11, m02 = a02 * k22;
    const Float8 m10 = a01 * k00 + a11 * k01, m11 = 1 + a01 * k01 + a11 * k11, m12 = a12 * k22;
    const Float8 m20 = a02 * k00 + a12 * k01, m21 = a02 * k01 + a12 * k11, m22 = 1 + a22 * k22;
    // Cramer's rule.
    const Float8 c0 = m11 * m22 - m12 * m21, c1 = m12 * m20 - m10 * m22, c2 = m10 * m21 - m11 * m20;
    const Float8 inverse = 1 / (m00 * c0 + m01 * c1 + m02 * c2);
    const Float8 s0 = inverse * (c0 * e.g00 + (m02 * m21 - m01 * m22) * e.g11 + (m01 * m12 - m02 * m11) * e.g01);
    const Float8 s1 = inverse * (c1 * e.g00 + (m00 * m22 - m02 * m20) * e.g11 + (m02 * m10 - m00 * m12) * e.g01);
    const Float8 s2 = inverse * (c2 * e.g00 + (m01 * m20 - m00 * m21) * e.g11 + (m00 * m11 - m01 * m10) * e.g01);
    const Float8 l0 = -(k00 * s0 + k01 * s1), l1 = -(k01 * s0 + k11 * s1), l2 = -0.5f * k22 * s2;
    const Vector8 pu = l0 * e.xu + l2 * e.xv, pv = l2 * e.xu + l1 * e.xv;
    for (std::size_t k = 0; k < 3; ++k) add_to(x_, face.v[k], (w[k] * face.du[k]) * pu + (w[k] * face.dv[k]) * pv);
  }
}

void Xpbd::solve_hinges(float h2) {
  for (std::size_t p = 0; p < hinge_packs_.size(); ++p) {
    const Hinge8& hinge = hinge_packs_[p];
    const auto& w = hinge_mobilities_[p].w;
    const Angle8 angle(hinge, x_);
    Float8 mobility{};
    for (std::size_t k = 0; k < 4; ++k) mobility += w[k] * dot(angle.gradient[k], angle.gradient[k]);
    const Float8 stiffness = h2 * angle.stiffness;
    const Float8 lambda = -stiffness * angle.theta / (1 + stiffness * mobility);
    for (std::size_t k = 0; k < 4; ++k) add_to(x_, hinge.v[k], (lambda * w[k]) * angle.gradient[k]);
  }
}

void Xpbd::solve_pins(float h2) {
  for (const RivalPin& pin : pins_) {
    const double stiffness = static_cast<double>(h2 * pin.stiffness * inverse_masses_[pin.vertex]);
    x_[pin.vertex] += (pin.target - x_[pin.vertex]) * (stiffness / (1 + stiffness));
  }
}

// The repulsion of a pair, F - K s for a motion s along its normal since the contact step began, never pulling; and
// friction as a viscosity across it, over the sub-step.
void Xpbd::solve_contacts(float h, std::span<const simulation::ContactForce> contacts) {
  for (const simulation::ContactForce& contact : contacts) {
    Float4 moved{}, slid{};
    float mobility = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      const std::uint32_t v = contact.vertices[k];
      if (v == kNone) continue;
      moved += contact.weights[k] * __builtin_convertvector(x_[v] - step_start_[v], Float4);
      slid += contact.weights[k] * __builtin_convertvector(x_[v] - before_[v], Float4);
      mobility += contact.weights[k] * contact.weights[k] * inverse_masses_[v];
    }
    const Float4 normal = to_float4(contact.normal);
    const auto along = [&](Float4 a) { return a[0] * normal[0] + a[1] * normal[1] + a[2] * normal[2]; };
    const float push = std::max(
        0.0f, h * h * (contact.force - contact.stiffness * along(moved)) / (1 + h * h * contact.stiffness * mobility));
    const Float4 drag = (h * contact.friction / (1 + h * contact.friction * mobility)) * (slid - along(slid) * normal);
    for (std::size_t k = 0; k < 4; ++k) {
      const std::uint32_t v = contact.vertices[k];
      if (v == kNone) continue;
      x_[v] += __builtin_convertvector(contact.weights[k] * inverse_masses_[v] * (push * normal - drag), Double4);
    }
  }
}

}  // namespace pleat::bench
