#include "tests/bench/rivals/block_descent.hpp"

#include <algorithm>
#include <cmath>
#include <set>

namespace pleat::bench {

BlockDescent::BlockDescent(const simulation::Scene& scene, const Topology& garment, const Positions& start,
                           const BlockDescentOptions& options)
    : RivalCloth(scene, garment, start), options_(options), systems_(x_.size()), last_velocities_(v_) {
  contacts_at_.resize(x_.size());
  colour_vertices();
}

void BlockDescent::colour_vertices() {
  const std::size_t vertices = x_.size() - 1;
  std::vector<std::set<std::uint32_t>> neighbours(vertices);
  const auto connect = [&](const auto& elements) {
    for (const auto& element : elements) {
      for (const std::uint32_t a : element.v) {
        for (const std::uint32_t b : element.v) {
          if (a != b) neighbours[a].insert(b);
        }
      }
    }
  };
  connect(faces_);
  connect(hinges_);
  constexpr std::size_t kUncoloured = ~std::size_t{0};
  std::vector<std::size_t> colour(vertices, kUncoloured);
  for (std::uint32_t v = 0; v < vertices; ++v) {
    std::set<std::size_t> taken;
    for (const std::uint32_t n : neighbours[v]) taken.insert(colour[n]);
    colour[v] = 0;
    while (taken.contains(colour[v])) ++colour[v];
    if (colour[v] == colours_.size()) colours_.emplace_back();
    colours_[colour[v]].vertices.push_back(v);
  }

  const auto nowhere = static_cast<std::uint32_t>(vertices);
  std::vector<std::array<std::size_t, 3>> counts(colours_.size(), std::array<std::size_t, 3>{});
  const auto append = [&](auto& packs, std::size_t& count, const auto& v, const auto& rest) {
    if (count % kLanes == 0) packs.emplace_back(nowhere);
    packs.back().set(count++ % kLanes, v, rest);
  };
  for (const RivalFace& face : faces_) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t a = k, b = (k + 1) % 3, c = (k + 2) % 3;
      const simulation::TriangleRest<float> rest{{face.rest.du[a], face.rest.du[b], face.rest.du[c]},
                                                 {face.rest.dv[a], face.rest.dv[b], face.rest.dv[c]},
                                                 face.rest.area};
      const std::size_t at = colour[face.v[a]];
      append(colours_[at].faces, counts[at][0], std::array{face.v[a], face.v[b], face.v[c]}, rest);
    }
  }
  for (const RivalHinge& hinge : hinges_) {
    // Seen from the other face, the edge runs the other way and the wings change places.
    const std::array<std::uint32_t, 4> here = hinge.v, there{here[1], here[0], here[3], here[2]};
    for (const auto& v : {here, there}) {
      append(colours_[colour[v[0]]].edge_ends, counts[colour[v[0]]][1], v, hinge.rest);
      append(colours_[colour[v[2]]].wings, counts[colour[v[2]]][2], v, hinge.rest);
    }
  }
}

void BlockDescent::advance(double step_s, std::span<const simulation::ContactForce> contacts) {
  for (auto& list : contacts_at_) list.clear();
  for (std::uint32_t c = 0; c < contacts.size(); ++c) {
    for (const std::uint32_t v : contacts[c].vertices) {
      if (v != kNone) contacts_at_[v].push_back(c);
    }
  }
  find_accelerations(step_s, accelerations_);
  step_start_ = x_;
  start_sweeps(step_s);
  const double radius2 = options_.spectral_radius * options_.spectral_radius;
  double omega = 1;
  for (int i = 0; i < options_.iterations; ++i) {
    if (radius2 > 0) sweep_start_ = x_;
    sweep(step_s, contacts);
    if (radius2 <= 0) continue;
    if (i > 0) {
      omega = i == 1 ? 2 / (2 - radius2) : 4 / (4 - radius2 * omega);
      for (std::size_t v = 0; v < x_.size(); ++v) x_[v] = earlier_[v] + omega * (x_[v] - earlier_[v]);
    }
    std::swap(earlier_, sweep_start_);
  }
  last_velocities_ = v_;
  for (std::size_t v = 0; v + 1 < x_.size(); ++v) v_[v] = (x_[v] - step_start_[v]) / step_s;
}

// The paper's adaptive initialisation: of the external acceleration only as much as the last step has shown along it.
void BlockDescent::start_sweeps(double step_s) {
  inertial_.resize(x_.size());
  for (std::size_t v = 0; v + 1 < x_.size(); ++v) {
    const Double4 external = accelerations_[v], shown = (v_[v] - last_velocities_[v]) / step_s;
    const double size2 = external[0] * external[0] + external[1] * external[1] + external[2] * external[2];
    const double along = shown[0] * external[0] + shown[1] * external[1] + shown[2] * external[2];
    const double share = size2 > 0 ? std::clamp(along / size2, 0.0, 1.0) : 0;
    inertial_[v] = x_[v] + step_s * (v_[v] + step_s * external);
    x_[v] += step_s * (v_[v] + (step_s * share) * external);
  }
}

void BlockDescent::sweep(double step_s, std::span<const simulation::ContactForce> contacts) {
  const auto h = static_cast<float>(step_s);
  for (const Colour& colour : colours_) {
    for (const std::uint32_t v : colour.vertices) systems_[v] = {};
    add_elements(colour);
    for (const RivalPin& pin : pins_) {
      const Float4 pull = pin.stiffness * __builtin_convertvector(pin.target - x_[pin.vertex], Float4);
      systems_[pin.vertex].first += Float8{pull[0], pull[1], pull[2], pin.stiffness, 0, pin.stiffness, 0, 0};
      systems_[pin.vertex].kzz += pin.stiffness;
    }
    for (const std::uint32_t v : colour.vertices) {
      System& s = systems_[v];
      for (const std::uint32_t c : contacts_at_[v]) add_contact(v, h, contacts[c], s);
      const float inertia = masses_[v] / (h * h);
      const Float4 pull = inertia * __builtin_convertvector(inertial_[v] - x_[v], Float4);
      const float fx = s.first[0] + pull[0], fy = s.first[1] + pull[1], fz = s.first[2] + pull[2];
      const float xx = s.first[3] + inertia, yx = s.first[4], yy = s.first[5] + inertia, zx = s.first[6],
                  zy = s.first[7], zz = s.kzz + inertia;
      const float c0 = yy * zz - zy * zy, c1 = zy * zx - yx * zz, c2 = yx * zy - yy * zx;
      const float inverse = 1 / (xx * c0 + yx * c1 + zx * c2);
      x_[v] +=
          Double4{static_cast<double>(inverse * (c0 * fx + c1 * fy + c2 * fz)),
                  static_cast<double>(inverse * (c1 * fx + (xx * zz - zx * zx) * fy + (yx * zx - xx * zy) * fz)),
                  static_cast<double>(inverse * (c2 * fx + (yx * zx - xx * zy) * fy + (xx * yy - yx * yx) * fz)), 0};
    }
  }
}

void BlockDescent::add_elements(const Colour& colour) {
  for (const Face8& face : colour.faces) {
    const Strain8 e(face, x_, table_);
    const Moduli8& k = e.moduli;
    const Float8 a = face.du[0], b = face.dv[0];
    const Float8 s00 = k.c11 * e.g00 + k.c12 * e.g11, s11 = k.c12 * e.g00 + k.c22 * e.g11, s01 = k.c33 * e.g01;
    const Vector8 force = (-face.area * (a * s00 + b * s01)) * e.xu + (-face.area * (a * s01 + b * s11)) * e.xv;
    // The diagonal block of stretching_stiffness(): p u u^T + q v v^T + r (u v^T + v u^T) + t 1.
    const Float8 tension_u = max(e.g00, Float8{}), tension_v = max(e.g11, Float8{});
    const Float8 shear = 0.5f * k.c33;
    const Float8 p = face.area * (a * a * k.c11 + b * b * shear), q = face.area * (b * b * k.c22 + a * a * shear),
                 r = face.area * a * b * (k.c12 + shear),
                 t = face.area * (a * a * (k.c11 * tension_u + k.c12 * tension_v) +
                                  b * b * (k.c22 * tension_v + k.c12 * tension_u));
    const Vector8 &u = e.xu, &v = e.xv;
    const Vector8 pu = p * u + r * v, qv = r * u + q * v;
    add(face.v[0],
        {force.x, force.y, force.z, pu.x * u.x + qv.x * v.x + t, pu.y * u.x + qv.y * v.x, pu.y * u.y + qv.y * v.y + t,
         pu.z * u.x + qv.z * v.x, pu.z * u.y + qv.z * v.y, pu.z * u.z + qv.z * v.z + t});
  }
  for (const Hinge8& hinge : colour.edge_ends) add_hinge(hinge, 0);
  for (const Hinge8& hinge : colour.wings) add_hinge(hinge, 2);
}

void BlockDescent::add_hinge(const Hinge8& hinge, std::size_t corner) {
  const Angle8 angle(hinge, x_);
  const Vector8& g = angle.gradient[corner];
  const Vector8 kg = angle.stiffness * g, force = -angle.theta * kg;
  add(hinge.v[corner],
      {force.x, force.y, force.z, kg.x * g.x, kg.y * g.x, kg.y * g.y, kg.z * g.x, kg.z * g.y, kg.z * g.z});
}

void BlockDescent::add(const Lanes& vertices, const Float8 (&values)[9]) {
  const Float8 columns[8] = {values[0], values[1], values[2], values[3], values[4], values[5], values[6], values[7]};
  Float8 rows[8];
  transpose(columns, rows);
  for (std::size_t lane = 0; lane < kLanes; ++lane) {
    systems_[vertices[lane]].first += rows[lane];
    systems_[vertices[lane]].kzz += values[8][static_cast<int>(lane)];
  }
}

// The repulsion linearised as the step began, and friction as a viscosity, over the motion of the step so far.
void BlockDescent::add_contact(std::uint32_t vertex, float h, const simulation::ContactForce& contact,
                               System& system) const {
  Float4 moved{};
  float weight = 0;
  for (std::size_t k = 0; k < 4; ++k) {
    const std::uint32_t v = contact.vertices[k];
    if (v == kNone) continue;
    moved += contact.weights[k] * __builtin_convertvector(x_[v] - step_start_[v], Float4);
    if (v == vertex) weight = contact.weights[k];
  }
  const Float4 n = to_float4(contact.normal);
  const float along = moved[0] * n[0] + moved[1] * n[1] + moved[2] * n[2], viscous = contact.friction / h;
  const Float4 force = weight * ((contact.force - (contact.stiffness - viscous) * along) * n - viscous * moved);
  const float normal = weight * weight * (contact.stiffness - viscous), all = weight * weight * viscous;
  system.first += Float8{force[0],
                         force[1],
                         force[2],
                         normal * n[0] * n[0] + all,
                         normal * n[1] * n[0],
                         normal * n[1] * n[1] + all,
                         normal * n[2] * n[0],
                         normal * n[2] * n[1]};
  system.kzz += normal * n[2] * n[2] + all;
}

}  // namespace pleat::bench
