// Who may do what with whose jobs and sessions.
#pragma once

#include "common/rpc/caller.hpp"
#include "services/coordinator/job.hpp"

namespace pleat::coordinator {

/// The owner, watchers and admins.
bool may_read(const rpc::Caller& caller, const JobRecord& job);

/// Throws kNotFound unless may_read(): whose job it is, and that there is one, is nobody else's business.
void require_reader(const rpc::Caller& caller, const JobRecord& job);

/// Cancelling and removing is for owner and admins. Throws kNotFound where the job may not even be read,
/// CallRefused (PERMISSION_DENIED) where it may.
void require_owner(const rpc::Caller& caller, const JobRecord& job);

/// Throws CallRefused (PERMISSION_DENIED) for a watcher. what: "make jobs".
void require_maker(const rpc::Caller& caller, const std::string& what);

/// One line in the log, whatever its level: who did what to whose job, "audit: job a of alice cancelled by bob (admin)
/// at ipv4:10.0.0.7".
void audit(const rpc::Caller& caller, const JobRecord& job, const std::string& done);

}  // namespace pleat::coordinator
