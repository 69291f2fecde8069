#include "services/coordinator/active_job.hpp"

#include <utility>

namespace pleat::coordinator {

void ActiveJob::abort(const Error& cause) {
  const std::lock_guard lock(mutex_);
  if (cause_) return;
  cause_ = cause;
  for (const auto& interrupt : interrupts_) interrupt(cause);
}

std::optional<Error> ActiveJob::cause() const {
  const std::lock_guard lock(mutex_);
  return cause_;
}

ActiveJob::Interrupt::Interrupt(ActiveJob& job, std::function<void(const Error&)> interrupt) : job_(job) {
  const std::lock_guard lock(job_.mutex_);
  if (job_.cause_) interrupt(*job_.cause_);
  place_ = job_.interrupts_.insert(job_.interrupts_.end(), std::move(interrupt));
}

ActiveJob::Interrupt::~Interrupt() {
  const std::lock_guard lock(job_.mutex_);
  job_.interrupts_.erase(place_);
}

}  // namespace pleat::coordinator
