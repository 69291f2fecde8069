#include "services/coordinator/access.hpp"

#include <gtest/gtest.h>

#include "tests/support/errors.hpp"

namespace pleat::coordinator {
namespace {

using rpc::Caller;
using rpc::Role;

const Caller kAlice{"alice", Role::kUser, "unix"}, kBob{"bob", Role::kUser, "unix"};
const Caller kWatcher{"dashboard", Role::kWatcher, "unix"}, kAdmin{"root", Role::kAdmin, "unix"};

JobRecord job_of(const std::string& owner) {
  JobRecord record;
  record.id = "secret";
  record.owner = owner;
  return record;
}

TEST(Access, AJobIsItsOwners) {
  const JobRecord job = job_of("alice");
  EXPECT_TRUE(may_read(kAlice, job));
  EXPECT_FALSE(may_read(kBob, job));
  EXPECT_NO_THROW(require_owner(kAlice, job));
  EXPECT_EQ(test::error_of([&] { require_reader(kBob, job); }).code(), ErrorCode::kNotFound);
  const Error error = test::error_of([&] { require_owner(kBob, job); });
  EXPECT_EQ(error.code(), ErrorCode::kNotFound) << "that it exists is not told";
  EXPECT_EQ(std::string(error.what()).find("alice"), std::string::npos);
}

TEST(Access, WatchersReadAllAndChangeNothing) {
  const JobRecord job = job_of("alice");
  EXPECT_TRUE(may_read(kWatcher, job));
  EXPECT_EQ(test::error_of([&] { require_owner(kWatcher, job); }).code(), ErrorCode::kFailedPrecondition);
  EXPECT_EQ(test::error_of([&] { require_owner(kWatcher, job_of("dashboard")); }).code(),
            ErrorCode::kFailedPrecondition)
      << "not even what is named after it";
  EXPECT_EQ(test::error_of([&] { require_maker(kWatcher, "make jobs"); }).code(), ErrorCode::kFailedPrecondition);
  EXPECT_NO_THROW(require_maker(kAlice, "make jobs"));
}

TEST(Access, AdminsMayDoAllWithAllJobs) {
  for (const char* owner : {"alice", ""}) {
    EXPECT_NO_THROW(require_reader(kAdmin, job_of(owner)));
    EXPECT_NO_THROW(require_owner(kAdmin, job_of(owner)));
  }
  EXPECT_NO_THROW(require_maker(kAdmin, "make jobs"));
  EXPECT_FALSE(may_read(kAlice, job_of(""))) << "of a time without owners: for admins and watchers";
}

}  // namespace
}  // namespace pleat::coordinator
