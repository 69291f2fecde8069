// A small paired data set on disk: a sheet of 9 x 7 vertices with waves, for tests.
#pragma once

#include <cmath>
#include <filesystem>
#include <memory>
#include <string>

#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"

namespace pleat::superres {

inline constexpr int kFrames = 7;

/// A flat sheet of columns x rows quads, each cut in two, 0.1 m wide.
inline Topology sheet(int columns, int rows) {
  Topology mesh;
  const int stride = columns + 1;
  mesh.rest_positions.resize(stride * (rows + 1), 3);
  mesh.uv.resize(stride * (rows + 1), 2);
  for (int r = 0; r <= rows; ++r) {
    for (int c = 0; c <= columns; ++c) {
      mesh.rest_positions.row(r * stride + c) << 0.1F * static_cast<float>(c), 0.0F, -0.1F * static_cast<float>(r);
      mesh.uv.row(r * stride + c) << 0.1F * static_cast<float>(c), 0.1F * static_cast<float>(r);
    }
  }
  mesh.faces.resize(2 * columns * rows, 3);
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      const auto i = static_cast<std::uint32_t>(r * stride + c);
      const auto s = static_cast<std::uint32_t>(stride);
      mesh.faces.row(2 * (r * columns + c)) << i, i + 1, i + s + 1;
      mesh.faces.row(2 * (r * columns + c) + 1) << i, i + s + 1, i + s;
    }
  }
  mesh.uv_faces = mesh.faces;
  return mesh;
}

inline Positions wave(const Positions& rest, int frame, int sequence, bool detail) {
  Positions result = rest;
  for (Eigen::Index i = 0; i < rest.rows(); ++i) {
    const float x = rest(i, 0), z = rest(i, 2), t = static_cast<float>(frame) * 0.2F + static_cast<float>(sequence);
    result(i, 1) += 0.1F * std::sin(5 * x + t) + 0.05F * std::cos(4 * z - t);
    result(i, 0) += 0.02F * t;
    if (detail) result(i, 1) += 0.01F * std::sin(25 * x + t);
  }
  return result;
}

inline DatasetMaster example_master() {
  const Topology coarse = sheet(8, 6);
  const Subdivision subdivision = subdivide(coarse, 2);
  DatasetMaster master;
  master.time_step_s = 0.005;
  master.frame_time_s = 0.04;
  master.topology = {coarse, subdivision.fine, subdivision.feature_vertices};
  return master;
}

/// Sequence `name`; recorded: frames that are written, kFrames to finish it. own: the file holds the meshes.
inline void write_sequence(const std::filesystem::path& folder, const DatasetMaster& master, const std::string& name,
                           const std::string& split, int phase, int recorded = kFrames, bool own = false) {
  SequenceOptions options;
  if (own) options.meshes = std::make_shared<MeshPair>(master.topology);
  options.name = name;
  options.split = split;
  options.scene = "{}";
  options.frames = kFrames;
  options.coarse_vertices = master.topology.coarse.vertex_count();
  options.fine_vertices = master.topology.fine.vertex_count();
  options.topology_hash = topology_hash(master.topology.fine);
  SequenceWriter writer(folder, options);
  for (int f = 0; f < recorded; ++f) {
    SequenceFrame frame;
    frame.time_s = 0.04 * f;
    frame.coarse = wave(master.topology.coarse.rest_positions, f, phase, false);
    frame.fine = wave(master.topology.fine.rest_positions, f, phase, true);
    writer.append(frame);
  }
  if (recorded == kFrames) writer.finish();
}

inline ChannelRanges example_range() {
  ChannelRanges range;
  for (std::size_t c = 0; c < 9; ++c) {
    const float reach = c < 3 ? 0.5F : c < 6 ? 1.0F : 2.0F;
    range.offset.push_back(-reach);
    range.scale.push_back(2 * reach);
  }
  return range;
}

/// "a" to train on, "b" to test.
inline void write_example_dataset(const std::filesystem::path& folder, DatasetMaster master, bool normalized = true) {
  master.sequences = {"a", "b"};
  if (normalized) master.normalization = example_range();
  write_dataset_master(folder, master);
  write_sequence(folder, master, "a", "train", 0);
  write_sequence(folder, master, "b", "test", 1);
}

/// "a" and "b" as in write_example_dataset; "c" to train on and "d" to test, of a sheet of other size and edges.
inline void write_two_meshes(const std::filesystem::path& folder) {
  DatasetMaster master = example_master(), other = master;
  master.sequences = {"a", "b", "c", "d"};
  write_dataset_master(folder, master);
  write_sequence(folder, master, "a", "train", 0);
  write_sequence(folder, master, "b", "test", 1);
  other.topology.coarse = sheet(10, 4);
  other.topology.coarse.rest_positions *= 0.5F, other.topology.coarse.uv *= 0.5F;
  const Subdivision subdivision = subdivide(other.topology.coarse, 2);
  other.topology.fine = subdivision.fine, other.topology.feature_vertices = subdivision.feature_vertices;
  write_sequence(folder, other, "c", "train", 2, kFrames, true);
  write_sequence(folder, other, "d", "test", 3, kFrames, true);
}

}  // namespace pleat::superres
