// Files that appear under their name only when they are complete.
#pragma once

#include <cstdio>
#include <filesystem>
#include <memory>
#include <string_view>

namespace pleat {

/// Writes PATH.tmp-XXXXXX, a file that was not there before; commit() gives it its name. Without commit() the
/// destructor removes it. Whether what has the name before may be replaced is for the caller to know (own_file.hpp);
/// folders and devices never are.
class WholeFile {
 public:
  /// Throws kInvalidArgument, naming the file, if it can't be made.
  explicit WholeFile(std::filesystem::path path);
  ~WholeFile();
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;

  /// Appends; failures show at commit().
  void write(std::string_view bytes) { std::fwrite(bytes.data(), 1, bytes.size(), file_.get()); }
  std::FILE* stream() const { return file_.get(); }
  const std::filesystem::path& path() const { return path_; }

  /// On disk and under its name afterwards. Throws kResourceExhausted if something could not be written.
  void commit();

 private:
  std::filesystem::path path_, temporary_;
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_;
};

/// Puts the finished file `temporary` in the place of `path`: on disk and under its name afterwards. Throws
/// kResourceExhausted, naming the file.
void publish_file(const std::filesystem::path& temporary, const std::filesystem::path& path);

/// The file with this content; makes its folder if need be.
void write_whole_file(const std::filesystem::path& path, std::string_view content);

}  // namespace pleat
