#include "common/store/hdf5_probe.hpp"

#include <hdf5.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <set>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "common/store/hdf5.hpp"

namespace pleat::hdf5 {
namespace {

constexpr rlim_t kProcessorSeconds = 4;
constexpr rlim_t kMemory = rlim_t{2} << 30;
constexpr hsize_t kMaxRowBytes = hsize_t{256} << 20;
constexpr int kMaxDepth = 32;

/// Everything that a reader may ask of libhdf5, with failures ignored.
class Walk {
 public:
  void file(const char* path) {
    const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
    H5Pset_file_locking(access.get(), false, true);
    const Handle opened(H5Fopen(path, H5F_ACC_RDONLY, access.get()), H5Fclose);
    if (!opened) return;
    const Handle root(H5Gopen2(opened.get(), "/", H5P_DEFAULT), H5Gclose);
    if (root) object(root.get(), 0);
  }

 private:
  void object(hid_t id, int depth) {
    H5O_info_t info;
    if (H5Oget_info(id, &info) < 0 || !seen_.insert(info.addr).second || depth > kMaxDepth) return;
    H5Aiterate2(id, H5_INDEX_NAME, H5_ITER_INC, nullptr, &Walk::attribute, nullptr);
    if (info.type == H5O_TYPE_DATASET) array(id);
    if (info.type != H5O_TYPE_GROUP) return;
    std::vector<std::string> names;
    H5Literate(id, H5_INDEX_NAME, H5_ITER_INC, nullptr, &Walk::link, &names);
    for (const std::string& name : names) {
      const Handle child(H5Oopen(id, name.c_str(), H5P_DEFAULT), H5Oclose);
      if (child) object(child.get(), depth + 1);
    }
  }

  static herr_t link(hid_t, const char* name, const H5L_info_t* info, void* names) {
    // Links out of the group lead to objects that are met elsewhere, or that no reader follows.
    if (info->type == H5L_TYPE_HARD) static_cast<std::vector<std::string>*>(names)->emplace_back(name);
    return 0;
  }

  static herr_t attribute(hid_t id, const char* name, const H5A_info_t*, void*) {
    const Handle attribute(H5Aopen(id, name, H5P_DEFAULT), H5Aclose);
    const Handle type(H5Aget_type(attribute.get()), H5Tclose), space(H5Aget_space(attribute.get()), H5Sclose);
    const hssize_t count = H5Sget_simple_extent_npoints(space.get());
    if (count == 1 && H5Tis_variable_str(type.get()) > 0) {
      char* text = nullptr;
      H5Aread(attribute.get(), type.get(), &text);
    } else if (count == 1 && H5Tget_size(type.get()) <= 1 << 20) {
      std::vector<char> value(std::max<std::size_t>(H5Tget_size(type.get()), 16));
      const H5T_class_t kind = H5Tget_class(type.get());
      const hid_t memory = kind == H5T_FLOAT ? H5T_NATIVE_DOUBLE : kind == H5T_INTEGER ? H5T_NATIVE_UINT64 : type.get();
      if (kind == H5T_FLOAT || kind == H5T_INTEGER || kind == H5T_STRING) {
        H5Aread(attribute.get(), memory, value.data());
      }
    }
    return 0;
  }

  static void array(hid_t id) {
    const Handle type(H5Dget_type(id), H5Tclose), space(H5Dget_space(id), H5Sclose);
    const H5T_class_t kind = H5Tget_class(type.get());
    const int rank = H5Sget_simple_extent_ndims(space.get());
    if ((kind != H5T_FLOAT && kind != H5T_INTEGER) || rank < 1 || rank > 8 || !why_unreadable(id).empty()) return;
    std::vector<hsize_t> extents(static_cast<std::size_t>(rank));
    H5Sget_simple_extent_dims(space.get(), extents.data(), nullptr);
    hsize_t chunks = 0;
    H5Dget_num_chunks(id, space.get(), &chunks);  // all of the index
    hsize_t bytes = sizeof(double);
    for (std::size_t i = 1; i < extents.size(); ++i) {
      if (extents[i] == 0 || bytes > kMaxRowBytes / extents[i]) return;
      bytes *= extents[i];
    }
    const hid_t memory = kind == H5T_FLOAT ? H5T_NATIVE_FLOAT : H5T_NATIVE_UINT32;
    std::vector<char> row(bytes);
    const hsize_t rows = extents[0];
    extents[0] = 1;
    const Handle one(H5Screate_simple(rank, extents.data(), nullptr), H5Sclose);
    for (const hsize_t at : std::set<hsize_t>{0, rows > 0 ? rows - 1 : 0}) {
      std::vector<hsize_t> start(extents.size(), 0);
      start[0] = at;
      if (at >= rows) continue;
      H5Sselect_hyperslab(space.get(), H5S_SELECT_SET, start.data(), nullptr, extents.data(), nullptr);
      H5Dread(id, memory, one.get(), space.get(), H5P_DEFAULT, row.data());
    }
  }

  std::set<haddr_t> seen_;
};

/// The address space that this process has already, in bytes.
rlim_t used_memory() {
  unsigned long pages = 0;
  if (std::FILE* file = std::fopen("/proc/self/statm", "r"); file != nullptr) {
    if (std::fscanf(file, "%lu", &pages) != 1) pages = 0;
    std::fclose(file);
  }
  return rlim_t{pages} * static_cast<rlim_t>(::sysconf(_SC_PAGESIZE));
}

[[noreturn]] void walk_in_child(const std::filesystem::path& path) {
  for (const int fault : {SIGSEGV, SIGBUS, SIGABRT, SIGFPE, SIGILL}) ::signal(fault, SIG_DFL);
  const rlimit no_core{0, 0}, time{kProcessorSeconds, kProcessorSeconds},
      memory{used_memory() + kMemory, used_memory() + kMemory};
  ::setrlimit(RLIMIT_CORE, &no_core);
  ::setrlimit(RLIMIT_CPU, &time);
  ::setrlimit(RLIMIT_AS, &memory);
  try {
    Walk().file(path.c_str());
  } catch (...) {
    ::_exit(1);
  }
  ::_exit(0);
}

}  // namespace

void require_harmless(const std::filesystem::path& path) {
  // The child of a process with threads may use what fork() leaves whole: malloc, and HDF5, whose lock we hold.
  const pid_t child = ::fork();
  if (child < 0) {
    throw Error(ErrorCode::kResourceExhausted,
                path.string() + ": can't be examined, no process to spare: " + std::strerror(errno));
  }
  if (child == 0) walk_in_child(path);
  int status = 0;
  while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return;
  const bool endless = WIFSIGNALED(status) && (WTERMSIG(status) == SIGXCPU || WTERMSIG(status) == SIGKILL);
  throw_data_loss(path.string() + ": damaged: HDF5 " + (endless ? "does not come to an end with it" : "crashes on it"));
}

}  // namespace pleat::hdf5
