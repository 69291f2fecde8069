// Folders for files that nobody shall keep.
#pragma once

#include <filesystem>
#include <string>

namespace pleat {

/// A fresh folder PARENT/PREFIX-XXXXXX of mode 0700, removed with the object. In it lies the marker `.pleat-scratch`,
///     pleat.scratch 1
///     user UID
///     folder INODE
/// under an flock as long as the process lives. The next process that makes one with this parent and prefix removes
/// those of killed processes: folders (not links) of this user, whose marker names this format, this user and this very
/// folder, and whose lock is free. Nothing else is ever removed: neither other folders of such a name nor copies.
class ScratchFolder {
 public:
  /// The parent must exist. Throws kResourceExhausted, naming the folder, if it can't be made.
  ScratchFolder(const std::filesystem::path& parent, const std::string& prefix);
  /// Removes it if it is still this one.
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  int lock_ = -1;
};

}  // namespace pleat
