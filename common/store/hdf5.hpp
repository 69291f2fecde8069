// RAII over HDF5's C API: handles that close themselves, errors as pleat::Error with the file's path, one lock.
// HDF5 itself serialises its calls where it is built thread-safe; the lock makes that true everywhere.
#pragma once

#include <hdf5.h>

#include <cstdint>
#include <filesystem>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "common/base/error.hpp"

namespace pleat::hdf5 {

/// Hold it around every use of this header.
std::unique_lock<std::recursive_mutex> lock();

/// A handle with its closing function.
class Handle {
 public:
  using Close = herr_t (*)(hid_t);
  Handle() = default;
  Handle(hid_t id, Close close) : id_(id), close_(close) {}
  Handle(Handle&& other) noexcept : id_(std::exchange(other.id_, -1)), close_(other.close_) {}
  Handle& operator=(Handle&& other) noexcept {
    std::swap(id_, other.id_);
    std::swap(close_, other.close_);
    return *this;
  }
  ~Handle() { reset(); }
  void reset() {
    if (id_ >= 0) close_(std::exchange(id_, -1));
  }
  hid_t get() const { return id_; }
  explicit operator bool() const { return id_ >= 0; }

 private:
  hid_t id_ = -1;
  Close close_ = nullptr;
};

/// Throws the failure that HDF5's error stack describes: kResourceExhausted for a full disk or a size limit, otherwise
/// `code`; the message names `path` and `what`.
[[noreturn]] void fail(ErrorCode code, const std::filesystem::path& path, const std::string& what);

/// An open array, read and written by rows.
class Rows {
 public:
  Rows(const std::filesystem::path& path, std::string name, Handle dataset)
      : path_(path), name_(std::move(name)), dataset_(std::move(dataset)) {}
  void write(hid_t memory_type, hsize_t first, hsize_t count, const void* data);
  void read(hid_t memory_type, hsize_t first, hsize_t count, void* data) const;

 private:
  std::filesystem::path path_;
  std::string name_;
  Handle dataset_;
};

/// Why an open array is not read, or "": its bytes would come from other files (external storage, a virtual array), or
/// through filters other than those that Pleat and h5py use (shuffle, deflate, Fletcher32).
std::string why_unreadable(hid_t dataset);

/// Whether `path` is a file of ours (a link is none): HDF5 whose attribute `format` begins with "pleat.". Throws
/// kResourceExhausted if that can't be found out.
bool is_own(const std::filesystem::path& path);

/// An open file and what is done with it. Not thread-safe without lock().
class File {
 public:
  /// A new file, for recording: data go to the system at every write. One that is there already is replaced if it is
  /// ours (is_own), set aside (set_aside) otherwise.
  static File create(const std::filesystem::path& path);
  /// A file that may come from elsewhere: examined first (hdf5_probe.hpp). Throws kNotFound, kInvalidArgument (not
  /// HDF5), kDataLoss (truncated, damaged).
  static File open(const std::filesystem::path& path, bool writable);
  /// The same for a file that Pleat has written where nobody else writes, or that was examined before.
  static File open_own(const std::filesystem::path& path, bool writable);

  const std::filesystem::path& path() const { return path_; }
  hid_t id() const { return file_.get(); }
  void flush();
  /// Closes and reports what could not be written.
  void close();
  /// Gives the file, open or closed, another name on the same volume; an existing one is replaced.
  void rename(const std::filesystem::path& path);

  /// Throws kDataLoss where a link that leads out of its group, or of the file, stands in the way.
  bool exists(const std::string& object) const;
  /// Makes the group and those above it.
  void make_group(const std::string& group);
  /// Names of the links in a group, in alphabetical order; empty if it does not exist.
  std::vector<std::string> list(const std::string& group) const;

  /// Attributes of an object ("/" is the root). Reading throws kDataLoss if it is absent or of another kind.
  void set_attribute(const std::string& object, const std::string& name, const std::string& value);
  void set_attribute(const std::string& object, const std::string& name, double value);
  void set_attribute(const std::string& object, const std::string& name, std::uint64_t value);
  std::string string_attribute(const std::string& object, const std::string& name) const;
  double number_attribute(const std::string& object, const std::string& name) const;
  std::uint64_t integer_attribute(const std::string& object, const std::string& name) const;
  bool has_attribute(const std::string& object, const std::string& name) const;

  /// A whole array at once.
  void write_array(const std::string& dataset, hid_t memory_type, const std::vector<hsize_t>& extents,
                   const void* data);
  /// An array with room for extents[0] rows, in chunks of rows_per_chunk rows; reserved at once unless deflated.
  void make_rows(const std::string& dataset, hid_t memory_type, const std::vector<hsize_t>& extents,
                 hsize_t rows_per_chunk, bool deflate);
  /// Opens an array for repeated access. The result must not outlive the file.
  Rows rows(const std::string& dataset) const;
  /// Cuts an array of make_rows to its first rows.
  void cut_rows(const std::string& dataset, hsize_t rows);

  /// Extents of an array. Throws kDataLoss if it is absent, not numeric, of another rank, or larger than `limit`
  /// values.
  std::vector<hsize_t> extents(const std::string& dataset, int rank, hsize_t limit) const;
  bool is_array(const std::string& dataset) const;

 private:
  File(std::filesystem::path path, Handle file) : path_(std::move(path)), file_(std::move(file)) {}
  Handle open_dataset(const std::string& dataset) const;
  Handle open_object(const std::string& object) const;

  std::filesystem::path path_;
  Handle file_;
};

}  // namespace pleat::hdf5
