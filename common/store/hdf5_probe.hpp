// Whether an HDF5 file from elsewhere can be opened without harm.
#pragma once

#include <filesystem>

namespace pleat::hdf5 {

/// Reads the structure of `path`, the attributes, and a first and last row of each array, in a process of its own:
/// libhdf5 1.10 ends the process on some damaged files, one changed byte is enough. Throws kDataLoss, naming the file,
/// if that process was lost, did not end within 4 s of processor time, or needed more than 2 GiB. Whatever merely
/// can't be read is left to the reader, which says what it wanted. With hdf5::lock(); about 1 ms for a file of ours.
void require_harmless(const std::filesystem::path& path);

}  // namespace pleat::hdf5
