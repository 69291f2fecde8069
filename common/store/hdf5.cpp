#include "common/store/hdf5.hpp"

#include <algorithm>
#include <cerrno>
#include <system_error>

#include "common/base/own_file.hpp"
#include "common/store/hdf5_probe.hpp"

namespace pleat::hdf5 {
namespace {

/// Error printing is a setting of the thread: switched off where HDF5 is used, not once in main.
void silence() { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

struct Cause {
  bool full = false;
  std::string text;
};

herr_t note_cause(unsigned /*depth*/, const H5E_error2_t* error, void* data) {
  auto& cause = *static_cast<Cause*>(data);
  const std::string text = error->desc != nullptr ? error->desc : "";
  for (const int number : {ENOSPC, EFBIG, EDQUOT}) {
    if (text.find("errno = " + std::to_string(number) + ",") != std::string::npos) {
      cause.full = true;
      cause.text = std::generic_category().message(number);
    }
  }
  // The walk goes from the innermost failure outwards: the first text says most.
  if (cause.text.empty()) cause.text = text.substr(0, text.find('\n'));
  return 0;
}

Handle properties(hid_t kind) { return {H5Pcreate(kind), H5Pclose}; }

Handle access_properties(bool writable) {
  Handle access = properties(H5P_FILE_ACCESS);
  // Reading while another process records is wanted: recorded frames are complete by construction. HDF5's own file
  // locks would forbid it; Recording keeps two writers apart itself.
  H5Pset_file_locking(access.get(), false, true);
  H5Pset_fclose_degree(access.get(), H5F_CLOSE_STRONG);
  // While recording nothing is kept back: data reach the system before the attribute that declares them valid.
  H5Pset_cache(access.get(), 0, 521, writable ? 0 : std::size_t{8} << 20, 1.0);
  H5Pset_sieve_buf_size(access.get(), writable ? 1 : 65536);
  return access;
}

hid_t file_type(hid_t memory_type) {
  if (H5Tequal(memory_type, H5T_NATIVE_FLOAT) > 0) return H5T_IEEE_F32LE;
  if (H5Tequal(memory_type, H5T_NATIVE_DOUBLE) > 0) return H5T_IEEE_F64LE;
  if (H5Tequal(memory_type, H5T_NATIVE_UINT32) > 0) return H5T_STD_U32LE;
  return H5T_STD_U64LE;
}

Handle string_type() {
  Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
  H5Tset_size(type.get(), H5T_VARIABLE);
  H5Tset_cset(type.get(), H5T_CSET_UTF8);
  return type;
}

}  // namespace

std::unique_lock<std::recursive_mutex> lock() {
  static std::recursive_mutex mutex;
  std::unique_lock result(mutex);
  silence();
  return result;
}

void fail(ErrorCode code, const std::filesystem::path& path, const std::string& what) {
  Cause cause;
  H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, note_cause, &cause);
  H5Eclear2(H5E_DEFAULT);
  std::string message = path.string() + ": " + what;
  if (!cause.text.empty()) message += " (" + cause.text + ")";
  throw Error(cause.full ? ErrorCode::kResourceExhausted : code, message);
}

std::string why_unreadable(hid_t dataset) {
  const Handle creation(H5Dget_create_plist(dataset), H5Pclose);
  if (!creation || H5Pget_layout(creation.get()) == H5D_VIRTUAL || H5Pget_external_count(creation.get()) != 0) {
    return " lies in another file";
  }
  for (int i = 0; i < H5Pget_nfilters(creation.get()); ++i) {
    unsigned flags = 0, settings = 0;
    std::size_t values = 0;
    const H5Z_filter_t filter =
        H5Pget_filter2(creation.get(), static_cast<unsigned>(i), &flags, &values, nullptr, 0, nullptr, &settings);
    if (filter != H5Z_FILTER_DEFLATE && filter != H5Z_FILTER_SHUFFLE && filter != H5Z_FILTER_FLETCHER32) {
      return " is packed in a way that is not read (HDF5's filter " + std::to_string(filter) + ")";
    }
  }
  return "";
}

bool is_own(const std::filesystem::path& path) {
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(std::filesystem::symlink_status(path, ignored))) return false;
  const auto lock = hdf5::lock();
  try {
    return File::open(path, false).string_attribute("/", "format").starts_with("pleat.");
  } catch (const Error& error) {
    if (error.code() == ErrorCode::kResourceExhausted) throw;  // it could not be examined
    return false;
  }
}

File File::create(const std::filesystem::path& path) {
  std::error_code ignored;
  if (is_own(path)) {
    std::filesystem::remove(path, ignored);  // of a process that was killed
  } else {
    set_aside(path);
  }
  const Handle access = access_properties(true);
  const Handle creation = properties(H5P_FILE_CREATE);
  Handle file(H5Fcreate(path.c_str(), H5F_ACC_EXCL, creation.get(), access.get()), H5Fclose);
  if (!file) fail(ErrorCode::kInvalidArgument, path, "can't be created");
  return {path, std::move(file)};
}

File File::open(const std::filesystem::path& path, bool writable) {
  std::error_code error;
  if (std::filesystem::is_regular_file(path, error)) require_harmless(path);
  return open_own(path, writable);
}

File File::open_own(const std::filesystem::path& path, bool writable) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) throw_not_found(path.string() + ": no such file");
  const Handle access = access_properties(writable);
  Handle file(H5Fopen(path.c_str(), writable ? H5F_ACC_RDWR : H5F_ACC_RDONLY, access.get()), H5Fclose);
  if (!file) {
    H5Eclear2(H5E_DEFAULT);
    if (H5Fis_hdf5(path.c_str()) == 0) throw_invalid_argument(path.string() + ": not an HDF5 file");
    Handle again(H5Fopen(path.c_str(), writable ? H5F_ACC_RDWR : H5F_ACC_RDONLY, access.get()), H5Fclose);
    fail(ErrorCode::kDataLoss, path, "can't be opened, truncated or corrupt");
  }
  return {path, std::move(file)};
}

void File::flush() {
  if (H5Fflush(file_.get(), H5F_SCOPE_LOCAL) < 0) fail(ErrorCode::kInternal, path_, "can't be flushed");
}

void File::close() {
  flush();
  file_.reset();
}

void File::rename(const std::filesystem::path& path) {
  // No fsync: arrays have room for every planned frame, and a cancelled job would wait for the disk to take it all.
  std::error_code error;
  std::filesystem::rename(path_, path, error);
  if (error) {
    throw Error(ErrorCode::kInternal,
                path_.string() + ": can't be renamed to " + path.string() + " (" + error.message() + ")");
  }
  path_ = path;
}

bool File::exists(const std::string& object) const {
  // H5Lexists wants every group above to exist. Links are not followed: a file from elsewhere must not choose what we
  // read.
  std::size_t end = 0;
  while (end != std::string::npos) {
    end = object.find('/', end + 1);
    const std::string part = object.substr(0, end);
    if (part.empty() || part == "/") continue;
    if (H5Lexists(file_.get(), part.c_str(), H5P_DEFAULT) <= 0) return false;
    H5L_info_t link;
    if (H5Lget_info(file_.get(), part.c_str(), &link, H5P_DEFAULT) < 0 || link.type != H5L_TYPE_HARD) {
      throw_data_loss(path_.string() + ": " + part + " is a link");
    }
  }
  return true;
}

void File::make_group(const std::string& group) {
  if (exists(group)) return;
  const Handle links = properties(H5P_LINK_CREATE);
  H5Pset_create_intermediate_group(links.get(), 1);
  const Handle made(H5Gcreate2(file_.get(), group.c_str(), links.get(), H5P_DEFAULT, H5P_DEFAULT), H5Gclose);
  if (!made) fail(ErrorCode::kInternal, path_, "can't make group " + group);
}

std::vector<std::string> File::list(const std::string& group) const {
  std::vector<std::string> names;
  if (!exists(group)) return names;
  const Handle opened(H5Gopen2(file_.get(), group.c_str(), H5P_DEFAULT), H5Gclose);
  if (!opened) fail(ErrorCode::kDataLoss, path_, group + " is no group");
  const auto add = [](hid_t, const char* name, const H5L_info_t*, void* data) -> herr_t {
    static_cast<std::vector<std::string>*>(data)->emplace_back(name);
    return 0;
  };
  if (H5Literate(opened.get(), H5_INDEX_NAME, H5_ITER_INC, nullptr, add, &names) < 0) {
    fail(ErrorCode::kDataLoss, path_, "can't list " + group);
  }
  return names;
}

Handle File::open_object(const std::string& object) const {
  if (!exists(object)) throw_data_loss(path_.string() + ": has no " + object);
  Handle opened(H5Oopen(file_.get(), object.c_str(), H5P_DEFAULT), H5Oclose);
  if (!opened) fail(ErrorCode::kDataLoss, path_, "has no " + object);
  return opened;
}

Handle File::open_dataset(const std::string& dataset) const {
  H5O_info_t info;
  if (!exists(dataset)) throw_data_loss(path_.string() + ": has no " + dataset);
  if (H5Oget_info_by_name(file_.get(), dataset.c_str(), &info, H5P_DEFAULT) < 0 || info.type != H5O_TYPE_DATASET) {
    fail(ErrorCode::kDataLoss, path_, dataset + " is no array");
  }
  Handle opened(H5Dopen2(file_.get(), dataset.c_str(), H5P_DEFAULT), H5Dclose);
  if (!opened) fail(ErrorCode::kDataLoss, path_, "can't open " + dataset);
  if (const std::string why = why_unreadable(opened.get()); !why.empty()) {
    throw_data_loss(path_.string() + ": " + dataset + why);
  }
  return opened;
}

namespace {

void write_attribute(const File& file, hid_t object, const std::string& name, hid_t memory_type, hid_t stored_type,
                     const void* value) {
  Handle attribute;
  if (H5Aexists(object, name.c_str()) > 0) {
    attribute = Handle(H5Aopen(object, name.c_str(), H5P_DEFAULT), H5Aclose);
  } else {
    const Handle scalar(H5Screate(H5S_SCALAR), H5Sclose);
    attribute = Handle(H5Acreate2(object, name.c_str(), stored_type, scalar.get(), H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
  }
  if (!attribute || H5Awrite(attribute.get(), memory_type, value) < 0) {
    fail(ErrorCode::kInternal, file.path(), "can't write attribute " + name);
  }
}

Handle open_attribute(const File& file, hid_t object, const std::string& name, H5T_class_t kind) {
  if (H5Aexists(object, name.c_str()) <= 0) throw_data_loss(file.path().string() + ": has no attribute " + name);
  Handle attribute(H5Aopen(object, name.c_str(), H5P_DEFAULT), H5Aclose);
  if (!attribute) fail(ErrorCode::kDataLoss, file.path(), "can't open attribute " + name);
  const Handle space(H5Aget_space(attribute.get()), H5Sclose);
  const Handle type(H5Aget_type(attribute.get()), H5Tclose);
  if (H5Sget_simple_extent_npoints(space.get()) != 1 || H5Tget_class(type.get()) != kind) {
    throw_data_loss(file.path().string() + ": attribute " + name + " is of another kind");
  }
  return attribute;
}

}  // namespace

void File::set_attribute(const std::string& object, const std::string& name, const std::string& value) {
  const Handle type = string_type();
  const char* text = value.c_str();
  write_attribute(*this, open_object(object).get(), name, type.get(), type.get(), &text);
}

void File::set_attribute(const std::string& object, const std::string& name, double value) {
  write_attribute(*this, open_object(object).get(), name, H5T_NATIVE_DOUBLE, H5T_IEEE_F64LE, &value);
}

void File::set_attribute(const std::string& object, const std::string& name, std::uint64_t value) {
  write_attribute(*this, open_object(object).get(), name, H5T_NATIVE_UINT64, H5T_STD_U64LE, &value);
}

std::string File::string_attribute(const std::string& object, const std::string& name) const {
  const Handle opened = open_object(object);
  const Handle attribute = open_attribute(*this, opened.get(), name, H5T_STRING);
  const Handle stored(H5Aget_type(attribute.get()), H5Tclose);
  if (H5Tis_variable_str(stored.get()) <= 0) {
    // Written by other programs, for example h5py with numpy strings.
    const std::size_t size = H5Tget_size(stored.get());
    std::string text(std::min<std::size_t>(size, 1 << 20), '\0');
    if (size != text.size() || H5Aread(attribute.get(), stored.get(), text.data()) < 0) {
      fail(ErrorCode::kDataLoss, path_, "can't read attribute " + name);
    }
    text.resize(text.find('\0') == std::string::npos ? text.size() : text.find('\0'));
    return text;
  }
  const Handle type(H5Tcopy(stored.get()), H5Tclose);
  char* text = nullptr;
  if (H5Aread(attribute.get(), type.get(), &text) < 0)
    fail(ErrorCode::kDataLoss, path_, "can't read attribute " + name);
  std::string value = text != nullptr ? text : "";
  H5free_memory(text);
  return value;
}

double File::number_attribute(const std::string& object, const std::string& name) const {
  const Handle opened = open_object(object);
  const Handle attribute = open_attribute(*this, opened.get(), name, H5T_FLOAT);
  double value = 0;
  if (H5Aread(attribute.get(), H5T_NATIVE_DOUBLE, &value) < 0) {
    fail(ErrorCode::kDataLoss, path_, "can't read attribute " + name);
  }
  return value;
}

std::uint64_t File::integer_attribute(const std::string& object, const std::string& name) const {
  const Handle opened = open_object(object);
  const Handle attribute = open_attribute(*this, opened.get(), name, H5T_INTEGER);
  std::uint64_t value = 0;
  if (H5Aread(attribute.get(), H5T_NATIVE_UINT64, &value) < 0) {
    fail(ErrorCode::kDataLoss, path_, "can't read attribute " + name);
  }
  return value;
}

bool File::has_attribute(const std::string& object, const std::string& name) const {
  return exists(object) && H5Aexists(open_object(object).get(), name.c_str()) > 0;
}

namespace {

Handle make_dataset(const File& file, const std::string& dataset, hid_t memory_type,
                    const std::vector<hsize_t>& extents, hsize_t rows_per_chunk, bool deflate) {
  const Handle space(H5Screate_simple(static_cast<int>(extents.size()), extents.data(), nullptr), H5Sclose);
  const Handle creation = properties(H5P_DATASET_CREATE);
  H5Pset_obj_track_times(creation.get(), 0);  // equal runs give equal files
  H5Pset_fill_time(creation.get(), H5D_FILL_TIME_NEVER);
  if (rows_per_chunk > 0) {
    std::vector<hsize_t> chunk = extents;
    chunk[0] = std::min(chunk[0], rows_per_chunk);
    H5Pset_chunk(creation.get(), static_cast<int>(chunk.size()), chunk.data());
  }
  if (deflate) {
    H5Pset_shuffle(creation.get());
    H5Pset_deflate(creation.get(), 1);
  } else {
    H5Pset_alloc_time(creation.get(), H5D_ALLOC_TIME_EARLY);
  }
  const Handle links = properties(H5P_LINK_CREATE);
  H5Pset_create_intermediate_group(links.get(), 1);
  Handle made(H5Dcreate2(file.id(), dataset.c_str(), file_type(memory_type), space.get(), links.get(), creation.get(),
                         H5P_DEFAULT),
              H5Dclose);
  if (!made) fail(ErrorCode::kInternal, file.path(), "can't make " + dataset);
  return made;
}

}  // namespace

void File::write_array(const std::string& dataset, hid_t memory_type, const std::vector<hsize_t>& extents,
                       const void* data) {
  const Handle made = make_dataset(*this, dataset, memory_type, extents, 0, false);
  for (const hsize_t extent : extents) {
    if (extent == 0) return;
  }
  if (H5Dwrite(made.get(), memory_type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) < 0) {
    fail(ErrorCode::kInternal, path_, "can't write " + dataset);
  }
}

void File::make_rows(const std::string& dataset, hid_t memory_type, const std::vector<hsize_t>& extents,
                     hsize_t rows_per_chunk, bool deflate) {
  make_dataset(*this, dataset, memory_type, extents, rows_per_chunk, deflate);
}

Rows File::rows(const std::string& dataset) const { return {path_, dataset, open_dataset(dataset)}; }

namespace {

struct RowSelection {
  Handle file_space, memory_space;
};

RowSelection select_rows(const std::filesystem::path& path, hid_t dataset, const std::string& name, hsize_t first,
                         hsize_t count) {
  RowSelection selection;
  selection.file_space = Handle(H5Dget_space(dataset), H5Sclose);
  const int rank = H5Sget_simple_extent_ndims(selection.file_space.get());
  std::vector<hsize_t> extents(static_cast<std::size_t>(std::max(rank, 1)));
  H5Sget_simple_extent_dims(selection.file_space.get(), extents.data(), nullptr);
  if (rank < 1 || first > extents[0] || count > extents[0] - first) {
    throw_data_loss(path.string() + ": " + name + " has no rows " + std::to_string(first) + " to " +
                    std::to_string(first + count));
  }
  std::vector<hsize_t> start(extents.size(), 0);
  start[0] = first;
  extents[0] = count;
  H5Sselect_hyperslab(selection.file_space.get(), H5S_SELECT_SET, start.data(), nullptr, extents.data(), nullptr);
  selection.memory_space = Handle(H5Screate_simple(rank, extents.data(), nullptr), H5Sclose);
  return selection;
}

}  // namespace

void Rows::write(hid_t memory_type, hsize_t first, hsize_t count, const void* data) {
  const RowSelection rows = select_rows(path_, dataset_.get(), name_, first, count);
  if (H5Dwrite(dataset_.get(), memory_type, rows.memory_space.get(), rows.file_space.get(), H5P_DEFAULT, data) < 0) {
    fail(ErrorCode::kInternal, path_, "can't write " + name_);
  }
}

void Rows::read(hid_t memory_type, hsize_t first, hsize_t count, void* data) const {
  if (count == 0) return;
  const RowSelection rows = select_rows(path_, dataset_.get(), name_, first, count);
  if (H5Dread(dataset_.get(), memory_type, rows.memory_space.get(), rows.file_space.get(), H5P_DEFAULT, data) < 0) {
    fail(ErrorCode::kDataLoss, path_, "can't read " + name_);
  }
}

void File::cut_rows(const std::string& dataset, hsize_t rows) {
  const Handle opened = open_dataset(dataset);
  const Handle space(H5Dget_space(opened.get()), H5Sclose);
  std::vector<hsize_t> extents(static_cast<std::size_t>(H5Sget_simple_extent_ndims(space.get())));
  H5Sget_simple_extent_dims(space.get(), extents.data(), nullptr);
  extents[0] = rows;
  if (H5Dset_extent(opened.get(), extents.data()) < 0) fail(ErrorCode::kInternal, path_, "can't cut " + dataset);
}

std::vector<hsize_t> File::extents(const std::string& dataset, int rank, hsize_t limit) const {
  const Handle opened = open_dataset(dataset);
  const Handle type(H5Dget_type(opened.get()), H5Tclose);
  const H5T_class_t kind = H5Tget_class(type.get());
  if (kind != H5T_FLOAT && kind != H5T_INTEGER) throw_data_loss(path_.string() + ": " + dataset + " is not numeric");
  const Handle space(H5Dget_space(opened.get()), H5Sclose);
  if (H5Sget_simple_extent_ndims(space.get()) != rank) {
    throw_data_loss(path_.string() + ": " + dataset + " should have " + std::to_string(rank) + " extents");
  }
  std::vector<hsize_t> result(static_cast<std::size_t>(rank));
  H5Sget_simple_extent_dims(space.get(), result.data(), nullptr);
  hsize_t values = 1;
  for (const hsize_t extent : result) {
    if (extent != 0 && values > limit / extent) throw_data_loss(path_.string() + ": " + dataset + " is too large");
    values *= extent;
  }
  return result;
}

bool File::is_array(const std::string& dataset) const {
  if (!exists(dataset)) return false;
  H5O_info_t info;
  return H5Oget_info_by_name(file_.get(), dataset.c_str(), &info, H5P_DEFAULT) >= 0 && info.type == H5O_TYPE_DATASET;
}

}  // namespace pleat::hdf5
