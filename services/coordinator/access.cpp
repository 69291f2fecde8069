#include "services/coordinator/access.hpp"

#include "common/telemetry/log.hpp"

namespace pleat::coordinator {

using rpc::Role;

bool may_read(const rpc::Caller& caller, const JobRecord& job) {
  return caller.role != Role::kUser || caller.name == job.owner;
}

void require_reader(const rpc::Caller& caller, const JobRecord& job) {
  if (!may_read(caller, job)) throw_not_found("no job '" + job.id + "'");
}

void require_owner(const rpc::Caller& caller, const JobRecord& job) {
  require_reader(caller, job);
  if (caller.role == Role::kAdmin || (caller.role == Role::kUser && caller.name == job.owner)) return;
  throw rpc::CallRefused(grpc::StatusCode::PERMISSION_DENIED,
                         "job " + job.id + " is not for " + caller.describe() + " to change");
}

void require_maker(const rpc::Caller& caller, const std::string& what) {
  if (caller.role != Role::kWatcher) return;
  throw rpc::CallRefused(grpc::StatusCode::PERMISSION_DENIED, caller.describe() + " may not " + what);
}

void audit(const rpc::Caller& caller, const JobRecord& job, const std::string& done) {
  telemetry::audit("job " + job.id + " of " + (job.owner.empty() ? "nobody" : job.owner) + " " + done + " by " +
                   caller.describe());
}

}  // namespace pleat::coordinator
