#include "services/dataset/workers.hpp"

#include <poll.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstring>
#include <new>

namespace pleat::dataset {
namespace {

/// What a worker writes to its pipe: one of these per event, smaller than PIPE_BUF so that it arrives whole.
struct Record {
  WorkerEvent::Kind kind = WorkerEvent::Kind::kFrame;
  ErrorCode code = ErrorCode::kInternal;
  std::uint64_t frames = 0;
  char text[488] = {};
};

void send(int pipe, const Record& record) {
  const ssize_t written = write(pipe, &record, sizeof(record));
  if (written != static_cast<ssize_t>(sizeof(record))) _exit(1);  // the parent has gone
}

Record record_of(const SequenceReport& report) {
  Record record;
  if (report.interrupted) {
    record.kind = WorkerEvent::Kind::kInterrupted;
  } else if (!report.dropped.empty()) {
    record.kind = WorkerEvent::Kind::kDropped;
    std::snprintf(record.text, sizeof(record.text), "%s", report.dropped.c_str());
  } else {
    record.kind = WorkerEvent::Kind::kDone;
    std::snprintf(record.text, sizeof(record.text), "%.0f ms coarse and %.0f ms fine a frame, %llu steps cut",
                  report.coarse_ms, report.fine_ms, static_cast<unsigned long long>(report.cut_steps));
  }
  return record;
}

Record failure(ErrorCode code, const char* text) {
  Record record;
  record.kind = WorkerEvent::Kind::kFailed;
  record.code = code;
  std::snprintf(record.text, sizeof(record.text), "%s", text);
  return record;
}

std::string how_it_ended(int status) {
  return WIFSIGNALED(status) ? std::string(strsignal(WTERMSIG(status)))
                             : "exit code " + std::to_string(WEXITSTATUS(status));
}

}  // namespace

struct WorkerPool::Flag {
  std::atomic<bool> set{false};
};

WorkerPool::WorkerPool(Signals signals) : signals_(signals), stopped_(nullptr) {
  void* memory = mmap(nullptr, sizeof(Flag), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) throw Error(ErrorCode::kResourceExhausted, "no memory to share with workers");
  stopped_ = new (memory) Flag;
}

WorkerPool::~WorkerPool() {
  for (const Worker& worker : workers_) {
    ::kill(worker.process, SIGKILL);
    waitpid(worker.process, nullptr, 0);
    close(worker.pipe);
  }
  munmap(stopped_, sizeof(Flag));
}

void WorkerPool::run(const Job& job, int pipe, pid_t parent) const {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(1);
  if (signals_ == Signals::kIgnored) {
    for (const int number : {SIGINT, SIGTERM, SIGHUP}) signal(number, SIG_IGN);
  }
  Record last;
  try {
    last = record_of(job(
        [&](std::uint64_t frames) {
          Record record;
          record.frames = frames;
          send(pipe, record);
        },
        [this] { return stopped_->set.load(); }));
  } catch (const Error& error) {
    last = failure(error.code(), error.what());
  } catch (const std::exception& error) {
    last = failure(ErrorCode::kInternal, error.what());
  }
  send(pipe, last);
  _exit(last.kind == WorkerEvent::Kind::kFailed ? 1 : 0);
}

void WorkerPool::start(std::size_t plan, const Job& job) {
  int ends[2];
  if (pipe(ends) != 0) throw Error(ErrorCode::kResourceExhausted, "no pipe for a worker");
  const pid_t parent = getpid();
  const pid_t process = fork();
  if (process < 0) {
    close(ends[0]);
    close(ends[1]);
    throw Error(ErrorCode::kResourceExhausted, "no process for a worker");
  }
  if (process == 0) {
    close(ends[0]);
    run(job, ends[1], parent);
  }
  close(ends[1]);
  workers_.push_back({plan, process, ends[0], false});
}

std::optional<WorkerEvent> WorkerPool::read_event(Worker& worker) {
  WorkerEvent event;
  event.plan = worker.plan;
  Record record;
  if (read(worker.pipe, &record, sizeof(record)) == static_cast<ssize_t>(sizeof(record))) {
    event.kind = record.kind;
    event.frames = record.frames;
    event.text = record.text;
    if (record.kind == WorkerEvent::Kind::kFailed) event.error.emplace(record.code, record.text);
    worker.ended = record.kind != WorkerEvent::Kind::kFrame;
    return event;
  }
  int status = 0;
  waitpid(worker.process, &status, 0);
  close(worker.pipe);
  worker.process = -1;
  if (worker.ended) return std::nullopt;
  event.kind = WorkerEvent::Kind::kFailed;
  event.text = "its process ended with " + how_it_ended(status);
  event.error.emplace(ErrorCode::kInternal, event.text);
  return event;
}

void WorkerPool::wait(std::chrono::milliseconds timeout, const std::function<void(const WorkerEvent&)>& on_event) {
  std::vector<pollfd> polled;
  for (const Worker& worker : workers_) polled.push_back({worker.pipe, POLLIN, 0});
  if (poll(polled.data(), polled.size(), timeout.count() < 0 ? -1 : static_cast<int>(timeout.count())) <= 0) return;
  std::vector<WorkerEvent> events;
  for (std::size_t i = workers_.size(); i-- > 0;) {
    if (polled[i].revents == 0) continue;
    if (auto event = read_event(workers_[i])) events.push_back(std::move(*event));
    if (workers_[i].process < 0) workers_.erase(workers_.begin() + static_cast<std::ptrdiff_t>(i));
  }
  for (const WorkerEvent& event : events) on_event(event);
}

void WorkerPool::stop() { stopped_->set = true; }

void WorkerPool::kill(std::size_t plan) {
  const auto found = std::find_if(workers_.begin(), workers_.end(), [&](const Worker& w) { return w.plan == plan; });
  if (found == workers_.end()) return;
  ::kill(found->process, SIGKILL);
  waitpid(found->process, nullptr, 0);
  close(found->pipe);
  workers_.erase(found);
}

}  // namespace pleat::dataset
