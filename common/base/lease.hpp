// Who works on what in a folder that several machines share: claims that end by themselves when their holder is gone.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>

namespace pleat {

/// A claim that this process holds. Move-only; the destructor leaves it to expire, as a killed process does.
class Lease {
 public:
  Lease(Lease&&) noexcept = default;
  Lease& operator=(Lease&&) noexcept = default;

  const std::string& name() const { return name_; }
  /// From 1, one more for each holder after another: larger than that of any earlier holder of the name.
  std::uint64_t generation() const { return generation_; }

  /// Tells the others that we are alive; to be called a few times within the expiry. False if another process has taken
  /// over in the meantime: it is theirs then, and what we still write must not meet what they write. A file that can't
  /// be written is no reason to end: the others decide.
  bool renew();
  /// Lets others have it at once.
  void release();

 private:
  friend class LeaseFolder;
  Lease() = default;
  bool write(const char* state, bool create);

  std::filesystem::path folder_;
  std::string name_, owner_;
  std::uint64_t generation_ = 0, beats_ = 0;
  std::chrono::milliseconds expiry_{0};
};

/// What is known of a name that we did not get.
enum class Holder {
  kUnknown,  ///< somebody's, not yet seen to live
  kAlive,    ///< somebody's who has renewed it while we looked
};

/// The claims of a folder: FOLDER/NAME.GENERATION, each a small text file.
///
/// One winner. A claim is a file that O_EXCL makes, which NFS since version 3 and the parallel file systems grant to
/// one process only. To take over is to make the file of the next generation, so two that take over at once have one
/// winner, too, and nobody ever removes another's claim. No file is locked.
///
/// Expiry. A holder changes its file; a watcher that sees it unchanged for the expiry that the holder wrote in it, by
/// the watcher's own steady clock, takes over. Clocks of machines are never compared. A holder that was stopped or cut
/// off for longer does not know that it lost until it renews: the work must be written beside and renamed.
class LeaseFolder {
 public:
  using Clock = std::function<std::chrono::steady_clock::time_point()>;

  /// Makes the folder if need be. `expiry`: of the claims made here. Throws kInvalidArgument (folder, expiry).
  LeaseFolder(std::filesystem::path folder, std::chrono::milliseconds expiry,
              Clock clock = &std::chrono::steady_clock::now);

  /// The name, if nobody holds it, its holder released it, or calls over at least its expiry saw no renewal. Else
  /// nothing: call again later. Names are file names. Throws kInvalidArgument (name), kResourceExhausted, naming the
  /// file, if it can't be made.
  std::optional<Lease> claim(const std::string& name);

  /// What earlier calls of claim() found out about the holder.
  Holder holder(const std::string& name) const;

 private:
  struct Seen {
    std::uint64_t generation = 0;
    std::string text;
    std::chrono::steady_clock::time_point since;
    bool renewed = false;
  };

  /// Whether the claim of this generation may be followed by the next.
  bool is_over(const std::string& name, std::uint64_t generation);

  std::filesystem::path folder_;
  std::string owner_;
  std::chrono::milliseconds expiry_;
  Clock clock_;
  std::map<std::string, Seen> seen_;
};

}  // namespace pleat
