// All jobs of a coordinator, in memory and in its data folder.
#pragma once

#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "services/coordinator/job.hpp"

namespace pleat::coordinator {

/// What a client asked for when it made a job. `request` is kept byte for byte, so that a restarted coordinator can go
/// on.
struct JobRequest {
  std::string id;  ///< empty: chosen here
  std::string scene_name;
  std::uint32_t frames = 0;
  bool reference = false;
  std::string model;
  std::string request;
  std::string owner = {};
  std::uint64_t bytes = 0;  ///< that the job's files will take at most
  telemetry::TraceContext trace = {};
};

/// Folder layout: DATA/jobs/ID/{job.json, request.pb, result.h5, checkpoint.bin, ...}, folders of mode 0700. Records
/// are replaced by rename, so that a process killed at any moment leaves whole ones. Thread-safe.
class JobTable {
 public:
  /// Makes the folder if need be, locks it, and reads every record. Unreadable records are left alone and listed in
  /// warnings(). Throws kInvalidArgument if the folder can't be made or written, kUnavailable if another coordinator
  /// has it: two would work on the same jobs. The lock goes with the process, however that ends.
  explicit JobTable(const std::filesystem::path& data);
  ~JobTable();
  JobTable(const JobTable&) = delete;
  JobTable& operator=(const JobTable&) = delete;

  const std::vector<std::string>& warnings() const { return warnings_; }

  /// Makes a job and its folder. A known id with an equal request gives the existing job and false; with another
  /// request, or of another owner, it throws kAlreadyExists. Throws kInvalidArgument (bad id), kResourceExhausted
  /// (disk; file named).
  std::pair<JobRecord, bool> create(const JobRequest& request);

  /// Removes a job that has ended: its record and the files that coordinators make, also after a kill -9 in between.
  /// What else lies in its folder stays there. Throws kFailedPrecondition if it has not ended.
  JobRecord remove(const std::string& id);

  /// What an owner's jobs hold: those that have not ended, and the bytes of all.
  struct Holdings {
    std::size_t unfinished = 0;
    std::uint64_t bytes = 0;
  };
  Holdings holdings(const std::string& owner) const;
  /// What the unfinished jobs of all may still write, bytes.
  std::uint64_t promised_bytes() const;
  /// Free on the data folder's file system, bytes.
  std::uint64_t free_bytes() const;

  bool contains(const std::string& id) const;
  /// Throws kNotFound, as all members that take an id.
  JobRecord get(const std::string& id) const;
  std::vector<JobRecord> list() const;        ///< newest first
  std::vector<JobRecord> unfinished() const;  ///< oldest first
  std::string request(const std::string& id) const;
  std::filesystem::path folder(const std::string& id) const;
  /// The same for a job that may be gone meanwhile.
  std::filesystem::path folder_of(const std::string& id) const { return jobs_ / id; }

  /// Changes a record and wakes the waiters. A change of state must be allowed by may_become, else kFailedPrecondition
  /// and nothing changes. On disk at once after a change of state, otherwise at most once a second.
  JobRecord update(const std::string& id, const std::function<void(JobRecord&)>& change);

  /// Waits until the job's revision is beyond `revision`, or the time is over. Returns record and revision.
  std::pair<JobRecord, std::uint64_t> wait(const std::string& id, std::uint64_t revision,
                                           std::chrono::milliseconds timeout) const;

 private:
  struct Entry {
    JobRecord record;
    std::uint64_t revision = 1;
    std::chrono::steady_clock::time_point saved{};
  };
  const Entry& find(const std::string& id) const;
  void save(Entry& entry);
  void finish_removal(const std::filesystem::path& folder);
  void give_back(const std::filesystem::path& doomed, const std::string& id);

  std::filesystem::path jobs_;
  int lock_ = -1;
  std::vector<std::string> warnings_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  std::map<std::string, Entry> entries_;
  std::uint64_t next_order_ = 1;
};

/// The content, or nothing if there is no such file. Throws kDataLoss if it can't be read.
std::optional<std::string> read_file(const std::filesystem::path& path);

}  // namespace pleat::coordinator
