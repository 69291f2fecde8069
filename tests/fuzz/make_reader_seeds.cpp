// Writes the seeds of the readers' corpora: small files of every format. Usage: fuzz_make_reader_seeds FOLDER
#include <minizip/zip.h>

#include <bit>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <string>
#include <vector>

#include "common/mesh/obj.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "common/store/result.hpp"
#include "services/superres/bundle/metadata.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::fuzz {
namespace {

namespace fs = std::filesystem;

void write(const fs::path& file, const std::string& content) {
  fs::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary) << content;
}

std::string content(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

template <typename T>
std::string bytes(T value, bool big_endian = false) {
  std::string text(sizeof value, '\0');
  std::memcpy(text.data(), &value, sizeof value);
  return big_endian ? std::string(text.rbegin(), text.rend()) : text;
}

void mesh_seeds(const fs::path& folder) {
  fs::create_directories(folder / "obj");
  write_obj(folder / "obj/sheet", test::square_sheet(2, 1));
  write(folder / "obj/forms",
        "\xef\xbb\xbf# comment\r\nmtllib a.mtl\r\no cloth\r\nv 0 0 0\r\nv 1 0 0 0.5\r\nv 1 0 1\r\nv 0 0 1\r\nvt 0 "
        "0\r\nvt 1 0\r\n"
        "vt 1 1\r\nvt 0 1 0\r\nvn 0 1 0\r\ng a\r\ns off\r\nf 1/1/1 2/2/1 \\\r\n3/3/1 -1/-1/-1\r\n");
  write(folder / "obj/polygon", "v 0 0 0\nv 2 0 0\nv 2 0 2\nv 1 0 1\nv 0 0 2\nf 1 2 3 4 5\n");
  const std::string head =
      "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float s\nproperty float t\n"
      "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
  write(folder / "ply/text", "ply\nformat ascii 1.0\ncomment made by hand\n" + head +
                                 "0 0 0 0 0\n1 0 0 1 0\n1 0 1 1 1\n0 0 1 0 1\n4 0 1 2 3\n");
  for (const bool big : {false, true}) {
    std::string body;
    for (const float value : {0, 0, 0, 0, 0, 1, 0, 0, 1, 0, 1, 0, 1, 1, 1, 0, 0, 1, 0, 1}) body += bytes(value, big);
    body += '\4';
    for (const std::int32_t corner : {0, 1, 2, 3}) body += bytes(corner, big);
    write(folder / (big ? "ply/big-endian" : "ply/little-endian"),
          std::string("ply\nformat binary_") + (big ? "big" : "little") + "_endian 1.0\n" + head + body);
  }
}

void point_seeds(const fs::path& folder) {
  constexpr std::int32_t kPoints = 3, kFrames = 2;
  for (const bool big : {false, true}) {
    std::string floats;
    for (int i = 0; i < 3 * kPoints * kFrames; ++i) floats += bytes(0.25F * static_cast<float>(i), big);
    const std::string pc2 = std::string("POINTCACHE2\0", 12) + bytes(std::int32_t{1}, big) + bytes(kPoints, big) +
                            bytes(0.0F, big) + bytes(1.0F, big) + bytes(kFrames, big);
    write(folder / (big ? "points/pc2-big" : "points/pc2"), '\0' + pc2 + floats);
    if (big) {
      write(folder / "points/mdd",
            '\1' + bytes(kFrames, true) + bytes(kPoints, true) + bytes(0.0F, true) + bytes(0.04F, true) + floats);
    }
    std::string header =
        std::string("{'descr': '") + (big ? ">" : "<") + "f4', 'fortran_order': False, 'shape': (2, 3, 3), }";
    header.resize(117, ' ');
    header += '\n';
    write(folder / (big ? "points/npy-big" : "points/npy"),
          '\2' + std::string("\x93NUMPY\1\0", 8) + bytes(static_cast<std::uint16_t>(header.size())) + header + floats);
  }
}

void hdf5_seeds(const fs::path& folder) {
  const Topology coarse = test::square_sheet(1, 1);
  const Subdivision subdivision = subdivide(coarse, 1);
  const test::ClosedMesh cube = test::cube(0.2F);
  const MeshPair topology{coarse, subdivision.fine, subdivision.feature_vertices};
  const std::vector<ObstacleShape> shapes{{"ball", {}}, {"cube", cube.faces}};
  const std::vector<Eigen::Index> obstacle_vertices{0, cube.positions.rows()};
  ObstacleFrame block;
  block.name = "cube";
  block.positions = cube.positions;
  const std::vector<ObstacleFrame> obstacles{test::sphere("ball", {0, -1, 0}, 0.5F), block};
  fs::create_directories(folder / "hdf5");
  for (const bool deflate : {false, true}) {
    ResultOptions options;
    options.topology = topology;
    options.frames = 2;
    options.frame_time_s = 0.04;
    options.model = "model";
    options.scene = "{}";
    options.obstacles = shapes;
    options.obstacle_vertices = obstacle_vertices;
    options.stages = {"superres"};
    options.counts = {"penetrations"};
    options.deflate = deflate;
    ResultWriter writer(folder / (deflate ? "hdf5/result-deflated" : "hdf5/result"), options);
    for (int i = 0; i < 2; ++i) {
      ResultFrame frame;
      frame.time_s = 0.04 * i;
      frame.coarse = coarse.rest_positions;
      frame.enhanced = subdivision.fine.rest_positions;
      frame.obstacles = obstacles;
      frame.stages_ms = {1};
      frame.counts = {0};
      writer.append(frame);
    }
    writer.finish();
  }
  const fs::path scratch = folder / "scratch";
  DatasetMaster master;
  master.time_step_s = 0.005;
  master.frame_time_s = 0.04;
  master.topology = topology;
  master.sequences = {"one"};
  write_dataset_master(scratch, master);
  SequenceOptions sequence;
  sequence.name = "one";
  sequence.split = "train";
  sequence.scene = "{}";
  sequence.frames = 1;
  sequence.coarse_vertices = coarse.vertex_count();
  sequence.fine_vertices = subdivision.fine.vertex_count();
  sequence.obstacles = shapes;
  sequence.obstacle_vertices = obstacle_vertices;
  sequence.topology_hash = topology_hash(subdivision.fine);
  SequenceWriter writer(scratch, sequence);
  writer.append(
      {.time_s = 0, .coarse = coarse.rest_positions, .fine = subdivision.fine.rest_positions, .obstacles = obstacles});
  writer.finish();
  fs::copy_file(scratch / "dataset.h5", folder / "hdf5/dataset", fs::copy_options::overwrite_existing);
  fs::copy_file(scratch / "sequences/one.h5", folder / "hdf5/sequence", fs::copy_options::overwrite_existing);
  fs::remove_all(scratch);
}

void text_seeds(const fs::path& folder) {
  write(folder / "scene/small",
        R"({"name": "fall", "garment_file": "cloth.obj", "frames": 3, "frame_time_s": 0.04, "time_step_s": 0.005,
            "isotropic": {"density": 375, "youngs_modulus": 7.5e5, "poissons_ratio": 0.3, "thickness": 4e-4}})");
  write(folder / "scene/large",
        R"({"name": "all", "garment_file": "cloth.obj", "frames": 2, "gravity": [0, -9.81, 0],
            "wind": {"velocity": [1, 0, 0], "density": 1.2},
            "handles": [{"vertices": [0, 1], "start_s": 0, "end_s": 0.1}],
            "obstacles": [{"name": "ball", "sphere": {"center": [0, -1, 0], "radius": 0.5}},
                          {"name": "arms", "capsules": {"capsules": [{"a": [0, 0, 0], "b": [0, 1, 0], "radius": 0.1}]}}],
            "material_options": {"damping": 0.001}, "contact": {"thickness": 0.001}, "subdivision_rounds": 1})");
  for (const char* name : {"gray-interlock", "silk"}) {
    write(folder / "material" / name, '\0' + content(fs::path("deploy/materials") / (std::string(name) + ".json")));
  }
  superres::Metadata metadata;
  metadata.name = "small";
  metadata.architecture = superres::complete({"mfsr", R"({"blocks": 1, "layers": 2, "growth": 4, "features": 8})"});
  conversion::GeometryImageSpec spec;
  spec.image.coarse_width = 6;
  spec.image.coarse_height = 5;
  metadata.representation.kind = spec;
  metadata.input = metadata.output = {std::vector<float>(9, -1), std::vector<float>(9, 2), 0};
  metadata.metrics = {{"psnr_db", 70}};
  write(folder / "material/bundle", '\1' + superres::to_json(metadata));
}

void archive_seed(const fs::path& folder) {
  fs::create_directories(folder / "archive");
  const zipFile archive = zipOpen64((folder / "archive/two-records").c_str(), APPEND_STATUS_CREATE);
  for (const char* name : {"bundle/data.pkl", "bundle/extra/pleat.json"}) {
    const zip_fileinfo info{};
    zipOpenNewFileInZip64(archive, name, &info, nullptr, 0, nullptr, 0, nullptr, 0, 0, 0);
    zipWriteInFileInZip(archive, name, static_cast<unsigned>(std::strlen(name)));
    zipCloseFileInZip(archive);
  }
  zipClose(archive, nullptr);
}

}  // namespace
}  // namespace pleat::fuzz

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: fuzz_make_reader_seeds FOLDER   (from the root of the tree)\n";
    return 2;
  }
  pleat::fuzz::mesh_seeds(argv[1]);
  pleat::fuzz::point_seeds(argv[1]);
  pleat::fuzz::hdf5_seeds(argv[1]);
  pleat::fuzz::text_seeds(argv[1]);
  pleat::fuzz::archive_seed(argv[1]);
  return 0;
}
