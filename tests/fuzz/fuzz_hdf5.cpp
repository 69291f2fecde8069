// HDF5: results, sequences of data sets, data sets, plain arrays. libhdf5 may be lost on a file, but only in the
// process that examines it.
#include <algorithm>

#include "common/store/dataset.hpp"
#include "common/store/result.hpp"
#include "services/presentation/input/point_sequence.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

namespace {

using namespace pleat;
namespace fs = std::filesystem;

void read_result(const fs::path& file) {
  const ResultReader reader(file);
  const std::uint64_t frames = std::min<std::uint64_t>(reader.frames_complete(), 2);
  const auto vertices = reader.info().topology.fine.vertex_count();
  for (const Positions& positions : reader.enhanced(0, frames)) fuzz::must(positions.rows() == vertices);
  reader.coarse(0, frames);
  reader.times(0, frames);
  reader.obstacles(0, frames);
  for (const std::string& stage : reader.info().stages) reader.stage_ms(stage, 0, frames);
  for (const std::string& count : reader.info().counts) reader.counts(count, 0, frames);
}

void read_dataset(const fs::path& folder) {
  const DatasetReader reader(folder);
  for (const SequenceInfo& sequence : reader.sequences([](const std::string&, const Error&) {})) {
    const std::uint64_t frames = std::min<std::uint64_t>(sequence.frames_complete, 2);
    for (const Positions& positions : reader.fine(sequence.name, 0, frames)) {
      fuzz::must(positions.rows() == reader.topology().fine.vertex_count());
    }
    reader.coarse(sequence.name, 0, frames);
    reader.times(sequence.name, 0, frames);
    reader.obstacles(sequence.name, 0, frames);
  }
}

void read_array(const std::string& source) {
  const auto points = presentation::open_points(source);
  for (std::size_t i = 0; i < std::min<std::size_t>(points->frame_count(), 2); ++i) {
    fuzz::must(points->positions(i).allFinite());
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const fs::path file = fuzz::file_with(data, size, "dataset.h5");
  fuzz::accept_errors([&] { read_result(file); });
  fuzz::accept_errors([&] { read_dataset(file.parent_path()); });
  fuzz::accept_errors([&] { read_array(file.string()); });
  fuzz::accept_errors([&] { read_array(file.string() + ":/enhanced/positions"); });
  return 0;
}
