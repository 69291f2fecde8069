// Files from elsewhere choose nothing beyond themselves.
#include "common/store/hdf5.hpp"

#include <fstream>
#include <functional>

#include "tests/unit/common/store/samples.hpp"

namespace pleat {
namespace {

using namespace testing_store;

class Elsewhere : public ::testing::Test {
 protected:
  Elsewhere() {
    ResultOptions options;
    options.topology = meshes;
    options.frames = 2;
    options.frame_time_s = 0.04;
    ResultWriter writer(path, options);
    for (std::uint64_t k = 0; k < 2; ++k) {
      ResultFrame frame;
      frame.coarse = moved(meshes.coarse.rest_positions, k);
      frame.enhanced = moved(meshes.fine.rest_positions, k);
      writer.append(frame);
    }
    writer.finish();
    std::filesystem::copy_file(path, other);
    std::ofstream(secret) << std::string(4096, 's');
  }

  /// Changes `path` with HDF5 alone.
  void change(const std::function<void(hid_t)>& action) {
    const auto lock = hdf5::lock();
    const hdf5::Handle file(H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT), H5Fclose);
    ASSERT_TRUE(file);
    action(file.get());
  }
  hdf5::Handle frames_space() const {
    const hsize_t extents[3] = {2, static_cast<hsize_t>(meshes.coarse.vertex_count()), 3};
    return {H5Screate_simple(3, extents, nullptr), H5Sclose};
  }

  TemporaryFolder folder;
  MeshPair meshes = sample_meshes();
  std::filesystem::path path = folder.path() / "result.h5", other = folder.path() / "other.h5",
                        secret = folder.path() / "secret";
};

TEST_F(Elsewhere, BytesOfAnotherFileAreNotPositions) {
  change([&](hid_t file) {
    const hdf5::Handle creation(H5Pcreate(H5P_DATASET_CREATE), H5Pclose), space = frames_space();
    H5Pset_external(creation.get(), secret.c_str(), 0, 24 * static_cast<hsize_t>(meshes.coarse.vertex_count()));
    H5Ldelete(file, "/coarse/positions", H5P_DEFAULT);
    const hdf5::Handle made(
        H5Dcreate2(file, "/coarse/positions", H5T_IEEE_F32LE, space.get(), H5P_DEFAULT, creation.get(), H5P_DEFAULT),
        H5Dclose);
    ASSERT_TRUE(made);
  });
  EXPECT_EQ(code_of([&] { ResultReader(path).coarse(0, 1); }, "another file"), ErrorCode::kDataLoss);
}

TEST_F(Elsewhere, AVirtualArrayIsRefused) {
  change([&](hid_t file) {
    const hdf5::Handle creation(H5Pcreate(H5P_DATASET_CREATE), H5Pclose), space = frames_space();
    H5Pset_virtual(creation.get(), space.get(), other.c_str(), "/coarse/positions", space.get());
    H5Ldelete(file, "/coarse/positions", H5P_DEFAULT);
    const hdf5::Handle made(
        H5Dcreate2(file, "/coarse/positions", H5T_IEEE_F32LE, space.get(), H5P_DEFAULT, creation.get(), H5P_DEFAULT),
        H5Dclose);
    ASSERT_TRUE(made);
  });
  EXPECT_EQ(code_of([&] { ResultReader(path).coarse(0, 1); }, "another file"), ErrorCode::kDataLoss);
}

TEST_F(Elsewhere, LinksAreNotFollowedWhereverTheyAre) {
  const std::string before = other.string();
  for (const char* linked : {"/coarse", "/coarse/positions", "/topology", "/topology/fine"}) {
    std::filesystem::copy_file(other, path, std::filesystem::copy_options::overwrite_existing);
    change([&](hid_t file) {
      H5Ldelete(file, linked, H5P_DEFAULT);
      ASSERT_GE(H5Lcreate_external(other.c_str(), linked, file, linked, H5P_DEFAULT, H5P_DEFAULT), 0);
    });
    EXPECT_EQ(code_of([&] { ResultReader(path).coarse(0, 1); }, "is a link"), ErrorCode::kDataLoss) << linked;
  }
}

TEST_F(Elsewhere, OneChangedBitIsNamed) {
  hsize_t address = 0;
  change([&](hid_t file) {
    const hdf5::Handle array(H5Dopen2(file, "/enhanced/positions", H5P_DEFAULT), H5Dclose);
    const hdf5::Handle space(H5Dget_space(array.get()), H5Sclose);
    hsize_t offset[3], size = 0;
    unsigned mask = 0;
    haddr_t chunk = 0;
    ASSERT_GE(H5Dget_chunk_info(array.get(), space.get(), 1, offset, &mask, &chunk, &size), 0);
    address = chunk + 10;
  });
  std::fstream bytes(path, std::ios::in | std::ios::out | std::ios::binary);
  bytes.seekg(static_cast<std::streamoff>(address));
  const char flipped = static_cast<char>(bytes.get() ^ 0x20);
  bytes.seekp(static_cast<std::streamoff>(address));
  bytes.put(flipped);
  bytes.close();
  const ResultReader reader(path);
  EXPECT_EQ(reader.enhanced(0, 1)[0], moved(meshes.fine.rest_positions, 0));
  EXPECT_EQ(code_of([&] { reader.enhanced(1, 2); }, "frame 1 of /enhanced/positions"), ErrorCode::kDataLoss);
}

TEST_F(Elsewhere, NoChangedByteEndsTheProcess) {
  std::ifstream stream(path, std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(stream)), {});
  // The structure lies at the beginning: this is where libhdf5 crashes.
  const std::filesystem::path damaged = folder.path() / "damaged.h5";
  for (std::size_t at = 0; at < std::min<std::size_t>(whole.size(), 6000); at += 61) {
    std::string bytes = whole;
    bytes[at] = static_cast<char>(at % 2 == 0 ? 0xff : bytes[at] ^ 0x01);
    std::ofstream(damaged, std::ios::binary) << bytes;
    try {
      const ResultReader reader(damaged);
      reader.coarse(0, reader.frames_complete());
      reader.enhanced(0, reader.frames_complete());
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("damaged.h5"), std::string::npos) << at << ": " << error.what();
    }
  }
}

}  // namespace
}  // namespace pleat
