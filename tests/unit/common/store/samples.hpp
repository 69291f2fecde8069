// Small meshes and frames for the tests of the store.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "common/store/result.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::testing_store {

using test::TemporaryFolder;

/// A grid of n x n squares, one metre wide, with material coordinates.
inline MeshPair sample_meshes(int n = 2) {
  Topology coarse;
  const int side = n + 1;
  coarse.rest_positions.resize(side * side, 3);
  coarse.uv.resize(side * side, 2);
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      const float u = static_cast<float>(i) / static_cast<float>(n), v = static_cast<float>(j) / static_cast<float>(n);
      coarse.rest_positions.row(i * side + j) << u, 0, -v;
      coarse.uv.row(i * side + j) << u, v;
    }
  }
  coarse.faces.resize(2 * n * n, 3);
  for (int i = 0, f = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const auto a = static_cast<std::uint32_t>(i * side + j), b = a + static_cast<std::uint32_t>(side);
      coarse.faces.row(f++) << a, b, b + 1;
      coarse.faces.row(f++) << a, b + 1, a + 1;
    }
  }
  coarse.uv_faces = coarse.faces;
  MeshPair pair;
  pair.coarse = coarse;
  const Subdivision subdivision = subdivide(coarse);
  pair.fine = subdivision.fine;
  pair.feature_vertices = subdivision.feature_vertices;
  return pair;
}

inline Positions moved(const Positions& rest, std::uint64_t frame) {
  Positions positions = rest;
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    positions(v, 1) += 0.1f * std::sin(0.7f * static_cast<float>(frame) + 0.3f * static_cast<float>(v));
  }
  return positions;
}

inline std::vector<ObstacleShape> sample_obstacle_shapes() {
  ObstacleShape sphere, mesh, capsules;
  sphere.name = "zz-sphere";  // not in alphabetical order: the order given must come back
  mesh.name = "box";
  mesh.faces.resize(2, 3);
  mesh.faces << 0, 1, 2, 0, 2, 3;
  capsules.name = "limbs";
  capsules.capsules = 2;
  return {sphere, mesh, capsules};
}

inline std::vector<ObstacleFrame> sample_obstacles(std::uint64_t frame) {
  ObstacleFrame sphere, mesh, capsules;
  sphere.name = "zz-sphere";
  sphere.center << 1, static_cast<float>(frame), 3;
  sphere.radius = 0.25f;
  mesh.name = "box";
  mesh.positions.resize(4, 3);
  mesh.positions.setConstant(static_cast<float>(frame));
  capsules.name = "limbs";
  capsules.capsule_ends = Positions::Constant(4, 3, 1 + static_cast<float>(frame));
  capsules.capsule_ends(2, 1) = -1;
  capsules.capsule_radii = {0.1f, 0.2f + static_cast<float>(frame)};
  return {sphere, mesh, capsules};
}

inline SequenceOptions sample_sequence(const MeshPair& meshes, const std::string& name, std::uint64_t frames) {
  SequenceOptions options;
  options.name = name;
  options.split = "train";
  options.scene = R"({"name":"sample"})";
  options.frames = frames;
  options.coarse_vertices = meshes.coarse.vertex_count();
  options.fine_vertices = meshes.fine.vertex_count();
  options.obstacles = sample_obstacle_shapes();
  options.obstacle_vertices = {0, 4, 0};
  options.topology_hash = topology_hash(meshes.fine);
  return options;
}

inline SequenceFrame sample_frame(const MeshPair& meshes, std::uint64_t k) {
  SequenceFrame frame;
  frame.time_s = 0.04 * static_cast<double>(k);
  frame.coarse = moved(meshes.coarse.rest_positions, k);
  frame.fine = moved(meshes.fine.rest_positions, k);
  frame.obstacles = sample_obstacles(k);
  return frame;
}

inline DatasetMaster sample_master(const MeshPair& meshes, std::vector<std::string> sequences) {
  DatasetMaster master;
  master.time_step_s = 0.005;
  master.frame_time_s = 0.04;
  master.seed = 7;
  master.git_revision = "abc";
  master.topology = meshes;
  master.sequences = std::move(sequences);
  return master;
}

/// Runs `action` and returns the code of the pleat::Error that it throws; the message must contain `part`.
inline ErrorCode code_of(const std::function<void()>& action, const std::string& part) {
  try {
    action();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    return error.code();
  }
  ADD_FAILURE() << "no error";
  return ErrorCode::kInternal;
}

}  // namespace pleat::testing_store
