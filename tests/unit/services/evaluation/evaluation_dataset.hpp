// A data set of two short sequences whose figures are known.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>

#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::test {

inline constexpr float kOffset = 0.02f;

inline Topology sheet() {
  Topology t;
  constexpr int n = 4;
  t.rest_positions.resize(n * n, 3);
  t.uv.resize(n * n, 2);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      t.rest_positions.row(j * n + i) << static_cast<float>(i) / 3, 0, -static_cast<float>(j) / 3;
      t.uv.row(j * n + i) << static_cast<float>(i) / 3, static_cast<float>(j) / 3;
    }
  }
  t.faces.resize(18, 3);
  for (std::uint32_t j = 0, f = 0; j < 3; ++j) {
    for (std::uint32_t i = 0; i < 3; ++i) {
      const std::uint32_t a = j * n + i;
      t.faces.row(f++) << a, a + 1, a + n + 1;
      t.faces.row(f++) << a, a + n + 1, a + n;
    }
  }
  t.uv_faces = t.faces;
  return t;
}

/// Two frames a sequence; the fine cloth lies kOffset above the upsampled coarse one, which is held at every vertex,
/// and a sphere touches the latter.
class EvaluationDataset : public testing::Test {
 protected:
  void SetUp() override {
    master_.time_step_s = 0.005;
    master_.frame_time_s = 0.04;
    master_.topology = pair_of(sheet());
    master_.sequences = {"learn", "fall"};
    master_.normalization = ChannelRanges{std::vector<float>(9, -1), std::vector<float>(9, 2)};
    write_dataset_master(folder_, master_);
    write_sequence("learn", "train", master_.topology, kOffset);
    write_sequence("fall", "test", master_.topology, kOffset);
  }

  static MeshPair pair_of(const Topology& coarse) {
    const Subdivision subdivision = subdivide(coarse, 2);
    return {coarse, subdivision.fine, subdivision.feature_vertices};
  }

  /// A test sequence of a garment of its own, twice as wide: the fine cloth lies 2 kOffset above the coarse one.
  void add_garment() {
    Topology wide = sheet();
    wide.rest_positions.col(0) *= 2;
    master_.sequences.push_back("wide");
    write_dataset_master(folder_, master_);
    write_sequence("wide", "test", pair_of(wide), 2 * kOffset, true);
  }

  void write_sequence(const std::string& name, const std::string& split, const MeshPair& meshes, float offset,
                      bool own = false) {
    SequenceOptions options;
    options.name = name;
    options.scene =
        R"({"handles": [{"vertices": [0, 1, 2, 3, 4, 5, 6, 7]}, {"vertices": [8, 9, 10, 11, 12, 13, 14, 15]}]})";
    options.split = split;
    options.frames = 2;
    options.coarse_vertices = meshes.coarse.vertex_count();
    options.fine_vertices = meshes.fine.vertex_count();
    options.topology_hash = topology_hash(meshes.fine);
    if (own) options.meshes = std::make_shared<MeshPair>(meshes);
    options.obstacles = {{"ball", {}}};
    options.obstacle_vertices = {0};
    SequenceWriter writer(folder_, options);
    for (int k = 0; k < 2; ++k) {
      SequenceFrame frame;
      frame.time_s = 0.04 * k;
      frame.coarse = meshes.coarse.rest_positions;
      frame.fine = meshes.fine.rest_positions;
      frame.fine.col(1).array() += offset;
      frame.obstacles.resize(1);
      frame.obstacles[0].name = "ball";
      frame.obstacles[0].center = {0.5f, -0.1f, -0.5f};
      frame.obstacles[0].radius = 0.11f;  // reaches 1 cm through the coarse sheet, and stays below the fine one
      writer.append(frame);
    }
    writer.finish();
  }

  DatasetMaster master_;
  const pleat::test::TemporaryFolder temporary_;
  const std::filesystem::path folder_ = temporary_.path();
};

}  // namespace pleat::test
