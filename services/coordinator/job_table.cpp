#include "services/coordinator/job_table.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <random>
#include <sstream>

#include "common/base/error.hpp"
#include "common/base/own_file.hpp"
#include "common/base/whole_file.hpp"

namespace pleat::coordinator {
namespace {

namespace fs = std::filesystem;

constexpr auto kSaveInterval = std::chrono::seconds(1);

/// Every file that a coordinator makes in a job's folder; the record is last, because it says whose folder it is.
constexpr const char* kJobFiles[] = {"result.h5",
                                     "result.h5.partial",
                                     "bundle.pb",
                                     "checkpoint.bin",
                                     "reference.h5.partial",
                                     "reference_checkpoint.bin",
                                     "request.pb",
                                     "job.json"};
constexpr const char* kRemoving = ".removing-";

/// Takes away what is a coordinator's own. What else lies there stays, and so does the folder then.
void remove_job_files(const fs::path& folder) {
  std::error_code ignored;
  for (const char* name : kJobFiles) fs::remove(folder / name, ignored);
  fs::remove(folder, ignored);
}

std::uint64_t bytes_in(const fs::path& folder) {
  std::uint64_t bytes = 0;
  std::error_code ignored;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, ignored)) {
    const auto size = entry.is_regular_file(ignored) ? entry.file_size(ignored) : 0;
    if (!ignored) bytes += size;
  }
  return bytes;
}

double unix_time_s() {
  return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
}

bool make_private_folder(const fs::path& folder) { return ::mkdir(folder.c_str(), 0700) == 0 || errno == EEXIST; }

std::string random_id(const std::string& scene_name) {
  std::random_device device;
  std::string id = scene_name.substr(0, 40);
  if (!id.empty()) id += '-';
  constexpr char kDigits[] = "0123456789abcdefghijklmnopqrstuvwxyz";
  for (int i = 0; i < 10; ++i) id += kDigits[device() % 36];
  return id;
}

}  // namespace

std::optional<std::string> read_file(const fs::path& path) {
  if (!fs::exists(path)) return std::nullopt;
  std::ifstream in(path, std::ios::binary);
  std::ostringstream content;
  content << in.rdbuf();
  if (!in) throw_data_loss(path.string() + ": can't be read");
  return std::move(content).str();
}

JobTable::JobTable(const fs::path& data) : jobs_(data / "jobs") {
  std::error_code error;
  fs::create_directories(data, error);
  if (!error && !make_private_folder(jobs_)) error.assign(errno, std::generic_category());
  if (error || ::access(jobs_.c_str(), W_OK | X_OK) != 0) {
    throw_invalid_argument("data folder " + data.string() +
                           " can't be written: " + (error ? error.message() : std::strerror(errno)));
  }
  lock_ = ::open((jobs_ / ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (lock_ < 0) throw_invalid_argument("data folder " + data.string() + " can't be locked: " + std::strerror(errno));
  if (::flock(lock_, LOCK_EX | LOCK_NB) != 0) {
    ::close(lock_);
    throw Error(ErrorCode::kUnavailable, "data folder " + data.string() + " is in use by another coordinator");
  }
  struct stat status {};
  if (::stat(jobs_.c_str(), &status) == 0 && (status.st_mode & 077) != 0) {
    warnings_.push_back(jobs_.string() + ": is open to other users of this host; chmod 700 it");
  }
  for (const auto& folder : fs::directory_iterator(jobs_)) {
    if (folder.path().filename().string().starts_with(kRemoving)) finish_removal(folder.path());
    if (!is_valid_job_id(folder.path().filename().string())) continue;
    const fs::path file = folder.path() / "job.json";
    try {
      const auto text = read_file(file);
      if (!text) continue;
      Entry entry;
      entry.record = job_from_json(*text, file.string());
      if (entry.record.id != folder.path().filename()) throw_data_loss(file.string() + ": belongs to another job");
      next_order_ = std::max(next_order_, entry.record.order + 1);
      entries_.emplace(entry.record.id, std::move(entry));
    } catch (const Error& e) {
      warnings_.emplace_back(e.what());
    }
  }
}

JobTable::~JobTable() { ::close(lock_); }

std::pair<JobRecord, bool> JobTable::create(const JobRequest& request) {
  if (!request.id.empty() && !is_valid_job_id(request.id)) {
    throw_invalid_argument("job_id '" + request.id + "': 1 to 64 letters, digits, '-' or '_'");
  }
  const std::lock_guard lock(mutex_);
  if (const auto known = entries_.find(request.id); known != entries_.end()) {
    if (known->second.record.owner != request.owner) {
      throw Error(ErrorCode::kAlreadyExists, "the id " + request.id + " is taken");
    }
    if (read_file(jobs_ / request.id / "request.pb") != request.request) {
      throw Error(ErrorCode::kAlreadyExists, "job " + request.id + " exists and was made by another request");
    }
    return {known->second.record, false};
  }
  Entry entry;
  entry.record.id = request.id;
  while (entry.record.id.empty() || entries_.contains(entry.record.id)) {
    entry.record.id = random_id(is_valid_job_id(request.scene_name) ? request.scene_name : "");
  }
  entry.record.scene_name = request.scene_name;
  entry.record.frames = request.frames;
  entry.record.reference = request.reference;
  entry.record.model = request.model;
  entry.record.owner = request.owner;
  entry.record.bytes = request.bytes;
  entry.record.trace = request.trace;
  entry.record.created_s = unix_time_s();
  entry.record.order = next_order_++;
  const fs::path folder = jobs_ / entry.record.id;
  // What lies there without being a job is of a request that never came to be, damaged, or somebody's.
  set_aside(folder);
  std::error_code error;
  if (!make_private_folder(folder)) error.assign(errno, std::generic_category());
  if (error) throw Error(ErrorCode::kResourceExhausted, folder.string() + ": " + error.message());
  // The record comes last: a folder without one is no job.
  write_whole_file(folder / "request.pb", request.request);
  save(entry);
  const auto made = entries_.emplace(entry.record.id, std::move(entry)).first;
  changed_.notify_all();
  return {made->second.record, true};
}

JobRecord JobTable::remove(const std::string& id) {
  JobRecord record;
  fs::path doomed;
  {
    const std::lock_guard lock(mutex_);
    record = find(id).record;
    if (!has_ended(record.state)) {
      throw Error(ErrorCode::kFailedPrecondition,
                  "job " + id + " is " + std::string(to_string(record.state)) + "; cancel it first");
    }
    doomed = jobs_ / (kRemoving + id);
    if (::rename((jobs_ / id).c_str(), doomed.c_str()) != 0 && errno != ENOENT) {
      throw Error(ErrorCode::kResourceExhausted, (jobs_ / id).string() + ": can't be removed: " + std::strerror(errno));
    }
    entries_.erase(id);
    changed_.notify_all();
  }
  remove_job_files(doomed);
  give_back(doomed, id);
  return record;
}

/// A folder that holds more than a job's files gets its name back: it is somebody's.
void JobTable::give_back(const fs::path& doomed, const std::string& id) {
  const std::lock_guard lock(mutex_);
  ::renameat2(AT_FDCWD, doomed.c_str(), AT_FDCWD, (jobs_ / id).c_str(), RENAME_NOREPLACE);
}

/// What a coordinator was killed in: the record says that the folder is a job's.
void JobTable::finish_removal(const fs::path& folder) {
  try {
    const auto text = read_file(folder / "job.json");
    if (!text) return;
    const JobRecord record = job_from_json(*text, (folder / "job.json").string());
    if (folder.filename() != kRemoving + record.id) return;
    remove_job_files(folder);
    give_back(folder, record.id);
  } catch (const Error& e) {
    warnings_.emplace_back(e.what());
  }
}

JobTable::Holdings JobTable::holdings(const std::string& owner) const {
  const std::lock_guard lock(mutex_);
  Holdings holdings;
  for (const auto& [id, entry] : entries_) {
    if (entry.record.owner != owner) continue;
    if (!has_ended(entry.record.state)) ++holdings.unfinished;
    holdings.bytes += entry.record.bytes;
  }
  return holdings;
}

std::uint64_t JobTable::promised_bytes() const {
  const std::lock_guard lock(mutex_);
  double bytes = 0;
  for (const auto& [id, entry] : entries_) {
    const JobRecord& record = entry.record;
    if (has_ended(record.state) || record.frames == 0) continue;
    bytes += static_cast<double>(record.bytes) * (1 - static_cast<double>(record.frames_complete) / record.frames);
  }
  return static_cast<std::uint64_t>(bytes);
}

std::uint64_t JobTable::free_bytes() const { return fs::space(jobs_).available; }

bool JobTable::contains(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  return entries_.contains(id);
}

JobRecord JobTable::get(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  return find(id).record;
}

std::vector<JobRecord> JobTable::list() const {
  std::vector<JobRecord> records;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, entry] : entries_) records.push_back(entry.record);
  }
  std::sort(records.begin(), records.end(), [](const auto& a, const auto& b) { return a.order > b.order; });
  return records;
}

std::vector<JobRecord> JobTable::unfinished() const {
  std::vector<JobRecord> records = list();
  std::erase_if(records, [](const JobRecord& record) { return has_ended(record.state); });
  std::reverse(records.begin(), records.end());
  return records;
}

std::string JobTable::request(const std::string& id) const {
  const fs::path file = folder(id) / "request.pb";
  auto content = read_file(file);
  if (!content) throw_data_loss(file.string() + ": is missing");
  return *std::move(content);
}

fs::path JobTable::folder(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  return jobs_ / find(id).record.id;
}

JobRecord JobTable::update(const std::string& id, const std::function<void(JobRecord&)>& change) {
  const std::lock_guard lock(mutex_);
  Entry& entry = const_cast<Entry&>(find(id));
  JobRecord record = entry.record;
  change(record);
  const bool state_changed = record.state != entry.record.state;
  if (state_changed && !may_become(entry.record.state, record.state)) {
    throw Error(ErrorCode::kFailedPrecondition, "job " + id + " is " + std::string(to_string(entry.record.state)) +
                                                    " and can't become " + std::string(to_string(record.state)));
  }
  if (state_changed && has_ended(record.state)) {
    record.ended_s = unix_time_s();
    record.bytes = bytes_in(jobs_ / id);
  }
  entry.record = std::move(record);
  ++entry.revision;
  changed_.notify_all();
  if (state_changed || std::chrono::steady_clock::now() - entry.saved >= kSaveInterval) save(entry);
  return entry.record;
}

std::pair<JobRecord, std::uint64_t> JobTable::wait(const std::string& id, std::uint64_t revision,
                                                   std::chrono::milliseconds timeout) const {
  std::unique_lock lock(mutex_);
  const Entry& entry = find(id);
  changed_.wait_for(lock, timeout, [&] { return entry.revision > revision; });
  return {entry.record, entry.revision};
}

const JobTable::Entry& JobTable::find(const std::string& id) const {
  const auto found = entries_.find(id);
  if (found == entries_.end()) throw_not_found("no job '" + id + "'");
  return found->second;
}

void JobTable::save(Entry& entry) {
  write_whole_file(jobs_ / entry.record.id / "job.json", to_json(entry.record));
  entry.saved = std::chrono::steady_clock::now();
}

}  // namespace pleat::coordinator
