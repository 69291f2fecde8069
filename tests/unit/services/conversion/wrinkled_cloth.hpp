// Garments and wrinkled frames for the tests of this room.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "common/mesh/obj.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::test {

struct Garment {
  Topology coarse;
  Subdivision subdivision;
  const Topology& fine() const { return subdivision.fine; }
};

/// Drops vertices and material coordinates that no face uses.
inline Topology without_unused(const Topology& t) {
  Topology result;
  const auto compact = [](const auto& values, const Faces& faces, auto& kept, Faces& new_faces) {
    std::vector<std::uint32_t> index(static_cast<std::size_t>(values.rows()), 0xffffffffu);
    new_faces.resize(faces.rows(), 3);
    kept.resize(values.rows(), values.cols());
    std::uint32_t count = 0;
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      for (int k = 0; k < 3; ++k) {
        std::uint32_t& i = index[faces(f, k)];
        if (i == 0xffffffffu) {
          i = count++;
          kept.row(i) = values.row(faces(f, k));
        }
        new_faces(f, k) = i;
      }
    }
    kept.conservativeResize(count, Eigen::NoChange);
  };
  compact(t.rest_positions, t.faces, result.rest_positions, result.faces);
  compact(t.uv, t.uv_faces, result.uv, result.uv_faces);
  return result;
}

/// A square tube of four panels, each a chart of its own, rotated by its own angle in the atlas; the second has a hole,
/// the third a cut-off corner, the fourth is mirrored. The panels share the vertices of their seams.
inline Topology four_charts() {
  constexpr int kWide = 9, kHigh = 14;
  constexpr float kEdge = 0.035f;
  const Eigen::Vector3f corners[4] = {
      {0, 0, 0}, {kWide * kEdge, 0, 0}, {kWide * kEdge, 0, -kWide * kEdge}, {0, 0, -kWide * kEdge}};
  Topology t;
  t.rest_positions.resize(4 * kWide * (kHigh + 1), 3);
  t.uv.resize(4 * (kWide + 1) * (kHigh + 1), 2);
  std::vector<std::array<std::uint32_t, 6>> faces;
  for (int panel = 0; panel < 4; ++panel) {
    const Eigen::Rotation2Df turn(0.4f + 1.3f * static_cast<float>(panel));
    const auto vertex = [&](int i, int j) {
      return static_cast<std::uint32_t>(((panel * kWide + i) % (4 * kWide)) * (kHigh + 1) + j);
    };
    const auto coordinate = [&](int i, int j) {
      return static_cast<std::uint32_t>((panel * (kWide + 1) + i) * (kHigh + 1) + j);
    };
    for (int i = 0; i <= kWide; ++i) {
      for (int j = 0; j <= kHigh; ++j) {
        const float along = static_cast<float>(i) / kWide;
        const Eigen::Vector3f p = (1 - along) * corners[panel] + along * corners[(panel + 1) % 4];
        t.rest_positions.row(vertex(i, j)) = p + static_cast<float>(j) * kEdge * Eigen::Vector3f::UnitY();
        const Eigen::Vector2f flat(static_cast<float>(panel == 3 ? -i : i) * kEdge, static_cast<float>(j) * kEdge);
        t.uv.row(coordinate(i, j)) = (turn * flat + Eigen::Vector2f(0.8f * static_cast<float>(panel), 0)).transpose();
      }
    }
    for (int i = 0; i < kWide; ++i) {
      for (int j = 0; j < kHigh; ++j) {
        if ((panel == 1 && i > 2 && i < 6 && j > 4 && j < 10) || (panel == 2 && i + j < 5)) continue;
        faces.push_back({vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), coordinate(i, j), coordinate(i + 1, j),
                         coordinate(i + 1, j + 1)});
        faces.push_back({vertex(i, j), vertex(i + 1, j + 1), vertex(i, j + 1), coordinate(i, j),
                         coordinate(i + 1, j + 1), coordinate(i, j + 1)});
      }
    }
  }
  t.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  t.uv_faces.resize(t.faces.rows(), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    t.faces.row(static_cast<Eigen::Index>(f)) << faces[f][0], faces[f][1], faces[f][2];
    t.uv_faces.row(static_cast<Eigen::Index>(f)) << faces[f][3], faces[f][4], faces[f][5];
  }
  return without_unused(t);
}

/// A strip with half a turn. glued: the ends share their vertices, and no orientation of all faces is left.
inline Topology moebius_strip(bool glued) {
  constexpr int kAround = 64, kAcross = 8;
  constexpr float kRadius = 0.5f, kWidth = 0.3f;
  Topology t;
  t.rest_positions.resize((kAround + 1) * (kAcross + 1), 3);
  t.uv.resize(t.rest_positions.rows(), 2);
  t.faces.resize(2 * kAround * kAcross, 3);
  const auto at = [](int i, int j) { return static_cast<std::uint32_t>(i * (kAcross + 1) + j); };
  for (int i = 0; i <= kAround; ++i) {
    const float angle = 6.2831853f * static_cast<float>(i) / kAround;
    for (int j = 0; j <= kAcross; ++j) {
      const float across = kWidth * (static_cast<float>(j) / kAcross - 0.5f);
      const float r = kRadius + across * std::cos(angle / 2);
      t.rest_positions.row(at(i, j)) << r * std::cos(angle), across * std::sin(angle / 2), r * std::sin(angle);
      t.uv.row(at(i, j)) << kRadius * angle, across;
    }
  }
  for (int i = 0; i < kAround; ++i) {
    for (int j = 0; j < kAcross; ++j) {
      t.faces.row(2 * (i * kAcross + j)) << at(i, j), at(i + 1, j), at(i + 1, j + 1);
      t.faces.row(2 * (i * kAcross + j) + 1) << at(i, j), at(i + 1, j + 1), at(i, j + 1);
    }
  }
  t.uv_faces = t.faces;
  for (Eigen::Index f = 0; glued && f < t.faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t v = t.faces(f, k);
      if (v >= at(kAround, 0)) t.faces(f, k) = at(0, kAcross) - (v - at(kAround, 0));
    }
  }
  return t;
}

/// A sheet in which every tenth face has no area: edges are split by vertices that lie on one of their ends.
inline Topology with_degenerate_faces() {
  constexpr int kSize = 20;
  Topology t;
  t.rest_positions.resize((kSize + 1) * (kSize + 1), 3);
  t.uv.resize(t.rest_positions.rows(), 2);
  const auto at = [](int i, int j) { return static_cast<std::uint32_t>(i * (kSize + 1) + j); };
  for (int i = 0; i <= kSize; ++i) {
    for (int j = 0; j <= kSize; ++j) {
      t.uv.row(at(i, j)) << 0.05f * static_cast<float>(i), 0.05f * static_cast<float>(j);
      t.rest_positions.row(at(i, j)) << t.uv(at(i, j), 0), 0, -t.uv(at(i, j), 1);
    }
  }
  std::vector<std::array<std::uint32_t, 3>> faces;
  std::vector<std::uint32_t> split_at;  // the vertex that each new one repeats
  for (int i = 0; i < kSize; ++i) {
    for (int j = 0; j < kSize; ++j) {
      const std::uint32_t a = at(i, j), b = at(i + 1, j), c = at(i + 1, j + 1), d = at(i, j + 1);
      if ((i * kSize + j) % 9 != 0) {
        faces.insert(faces.end(), {{a, b, c}, {a, c, d}});
        continue;
      }
      const auto m =
          static_cast<std::uint32_t>((kSize + 1) * (kSize + 1)) + static_cast<std::uint32_t>(split_at.size());
      split_at.push_back(a);
      // The diagonal a-c becomes a-m-c, with m on a.
      faces.insert(faces.end(), {{a, b, m}, {m, b, c}, {m, c, d}, {a, m, d}});
    }
  }
  const Eigen::Index regular = t.rest_positions.rows();
  t.rest_positions.conservativeResize(regular + static_cast<Eigen::Index>(split_at.size()), 3);
  t.uv.conservativeResize(t.rest_positions.rows(), 2);
  for (std::size_t i = 0; i < split_at.size(); ++i) {
    t.rest_positions.row(regular + static_cast<Eigen::Index>(i)) = t.rest_positions.row(split_at[i]);
    t.uv.row(regular + static_cast<Eigen::Index>(i)) = t.uv.row(split_at[i]);
  }
  t.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    t.faces.row(static_cast<Eigen::Index>(f)) << faces[f][0], faces[f][1], faces[f][2];
  }
  t.uv_faces = t.faces;
  return t;
}

/// A regular sheet over the material box of another one that lies flat, with rest positions by bilinear interpolation
/// of that one's corners.
inline Topology other_sheet(const Topology& sheet, int wide, int high) {
  const Eigen::RowVector2f low = sheet.uv.colwise().minCoeff(), high_uv = sheet.uv.colwise().maxCoeff();
  const auto rest_at = [&](const Eigen::RowVector2f& p) -> Eigen::RowVector3f {
    Eigen::Index nearest = 0;
    (sheet.uv.rowwise() - p).rowwise().squaredNorm().minCoeff(&nearest);
    for (Eigen::Index f = 0; f < sheet.uv_faces.rows(); ++f) {
      for (int k = 0; k < 3; ++k) {
        if (sheet.uv_faces(f, k) == static_cast<std::uint32_t>(nearest))
          return sheet.rest_positions.row(sheet.faces(f, k));
      }
    }
    return {};
  };
  const Eigen::RowVector3f origin = rest_at(low), u_end = rest_at({high_uv.x(), low.y()}),
                           v_end = rest_at({low.x(), high_uv.y()});
  Topology t;
  t.rest_positions.resize((wide + 1) * (high + 1), 3);
  t.uv.resize(t.rest_positions.rows(), 2);
  t.faces.resize(2 * wide * high, 3);
  const auto at = [&](int i, int j) { return static_cast<std::uint32_t>(i * (high + 1) + j); };
  for (int i = 0; i <= wide; ++i) {
    for (int j = 0; j <= high; ++j) {
      const float u = static_cast<float>(i) / static_cast<float>(wide),
                  v = static_cast<float>(j) / static_cast<float>(high);
      t.rest_positions.row(at(i, j)) = origin + u * (u_end - origin) + v * (v_end - origin);
      t.uv.row(at(i, j)) = low + Eigen::RowVector2f(u, v).cwiseProduct(high_uv - low);
    }
  }
  for (int i = 0; i < wide; ++i) {
    for (int j = 0; j < high; ++j) {
      t.faces.row(2 * (i * high + j)) << at(i, j), at(i + 1, j), at(i + 1, j + 1);
      t.faces.row(2 * (i * high + j) + 1) << at(i, j), at(i + 1, j + 1), at(i, j + 1);
    }
  }
  t.uv_faces = t.faces;
  return t;
}

/// "tablecloth" and "skirt" of deploy/garments; "four charts", "moebius strip", "degenerate faces".
inline Garment load_garment(const std::string& name) {
  Garment garment;
  if (name == "four charts") {
    garment.coarse = four_charts();
  } else if (name == "moebius strip") {
    garment.coarse = moebius_strip(false);
  } else if (name == "degenerate faces") {
    garment.coarse = with_degenerate_faces();
  } else {
    garment.coarse = read_obj("deploy/garments/" + name + ".obj");
  }
  garment.subdivision = subdivide(garment.coarse, 2);
  return garment;
}

inline constexpr const char* kGarments[] = {"tablecloth", "skirt", "four charts", "moebius strip", "degenerate faces"};

/// A smooth deformation of space with folds of 7 to 30 cm and up to 2 cm height, the same for coarse and fine meshes.
inline Eigen::Vector3f wrinkle(const Eigen::Vector3f& p, float phase) {
  const Eigen::Vector3f q(p.x(), p.y() + 0.03f * std::sin(9 * p.x() + 4 * p.z() + phase), p.z());
  const float fold = 0.02f * std::sin(43 * p.x() + 21 * p.y() + 12 * p.z() + 2 * phase) +
                     0.01f * std::sin(70 * p.z() + 50 * p.y() - 31 * p.x() - phase);
  return q + fold * Eigen::Vector3f(0.2f, 1.0f, 0.3f);
}

inline RigidTransform some_motion() {
  RigidTransform motion;
  motion.rotation = Eigen::AngleAxisf(1.1f, Eigen::Vector3f(0.3f, -0.5f, 0.8f).normalized()).toRotationMatrix();
  motion.translation = {0.4f, 1.3f, -0.7f};
  return motion;
}

inline Positions moved(const Positions& positions, const RigidTransform& motion) {
  return (positions * motion.rotation.transpose()).rowwise() + motion.translation.transpose();
}

/// A wrinkled frame of a mesh; velocities are those of a phase that grows by 1 per second.
inline Frame wrinkled_frame(const Topology& topology, float phase) {
  Frame frame;
  frame.positions.resize(topology.vertex_count(), 3);
  frame.velocities.resize(topology.vertex_count(), 3);
  for (Eigen::Index v = 0; v < topology.vertex_count(); ++v) {
    const Eigen::Vector3f p = topology.rest_positions.row(v);
    frame.positions.row(v) = wrinkle(p, phase);
    frame.velocities.row(v) = (wrinkle(p, phase) - wrinkle(p, phase - 0.04f)) / 0.04f;
  }
  return frame;
}

inline double rms(const Positions& a, const Positions& b) {
  return std::sqrt(static_cast<double>((a - b).squaredNorm()) / static_cast<double>(a.rows()));
}

inline double largest(const Positions& a, const Positions& b) {
  return static_cast<double>((a - b).rowwise().norm().maxCoeff());
}

}  // namespace pleat::test
