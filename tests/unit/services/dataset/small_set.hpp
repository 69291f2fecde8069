// A data set that takes a moment: a small cloth, few frames.
#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <string>

#include "common/base/error.hpp"
#include "common/mesh/obj.hpp"
#include "services/dataset/generate.hpp"
#include "services/dataset/verify.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::dataset {

class SmallSet : public ::testing::Test {
 protected:
  SmallSet() {
    write_obj(root / "cloth.obj", cloth(7, 5));
    options.folder = root / "set";
    options.scenes.garment = root / "cloth.obj";
    options.scenes.material =
        std::filesystem::path(getenv("PLEAT_SOURCE_DIR") != nullptr ? getenv("PLEAT_SOURCE_DIR") : ".") /
        "deploy/materials/gray-interlock.json";
    options.scenes.train = 2;
    options.scenes.test = 1;
    options.scenes.frames = 5;
    options.workers = 2;
    options.git_revision = "abc";
  }

  /// Columns x rows vertices, 5 cm apart, flat as the tablecloth is.
  static Topology cloth(int columns, int rows) {
    Topology mesh;
    mesh.rest_positions.resize(columns * rows, 3);
    mesh.uv.resize(columns * rows, 2);
    mesh.faces.resize(2 * (columns - 1) * (rows - 1), 3);
    Eigen::Index face = 0;
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i) {
        const float u = 0.05f * static_cast<float>(i), v = 0.05f * static_cast<float>(j);
        mesh.rest_positions.row(j * columns + i) << u, 0, -v;
        mesh.uv.row(j * columns + i) << u, v;
        if (i + 1 == columns || j + 1 == rows) continue;
        const auto a = static_cast<std::uint32_t>(j * columns + i), b = a + static_cast<std::uint32_t>(columns);
        mesh.faces.row(face++) << a, a + 1, b + 1;
        mesh.faces.row(face++) << a, b + 1, b;
      }
    }
    mesh.uv_faces = mesh.faces;
    return mesh;
  }

  void make() {
    generate(options, [](const Progress&) {});
  }
  VerifyReport check() {
    return verify(options.folder, {}, [](const std::string&) {});
  }
  std::filesystem::path sequence(const std::string& name) { return options.folder / "sequences" / (name + ".h5"); }

  const test::TemporaryFolder temporary;
  const std::filesystem::path root = temporary.path();
  GenerateOptions options;
};

}  // namespace pleat::dataset
