// The gRPC service pleat.v1.Coordinator over jobs and live sessions.
#pragma once

#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <memory>
#include <mutex>
#include <set>
#include <string>

#include "common/rpc/caller.hpp"
#include "common/telemetry/metrics.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"
#include "services/coordinator/client_quota.hpp"
#include "services/coordinator/coordinator_options.hpp"
#include "services/coordinator/job_runner.hpp"
#include "services/coordinator/live_session.hpp"

namespace pleat::coordinator {

/// Streams have threads of their own: those of gRPC stay free for unary calls and health checks.
class CoordinatorService final : public v1::Coordinator::WithCallbackMethod_Enhance<
                                     v1::Coordinator::WithCallbackMethod_WatchJob<v1::Coordinator::Service>> {
 public:
  /// Reads the data folder and takes up unfinished jobs. Throws kInvalidArgument (an option, the folder).
  /// metrics may be null and must outlive the service.
  CoordinatorService(const CoordinatorOptions& options, telemetry::Metrics* metrics);
  /// Waits until the last stream has ended; call drain() and stop the server first.
  ~CoordinatorService() override;

  grpc::Status CreateJob(grpc::ServerContext* context, const v1::CreateJobRequest* request, v1::Job* job) override;
  grpc::Status CreateJobInParts(grpc::ServerContext* context, grpc::ServerReader<v1::CreateJobPart>* reader,
                                v1::Job* job) override;
  grpc::ServerWriteReactor<v1::JobEvent>* WatchJob(grpc::CallbackServerContext* context,
                                                   const v1::WatchJobRequest* request) override;
  grpc::Status CancelJob(grpc::ServerContext* context, const v1::CancelJobRequest* request, v1::Job* job) override;
  grpc::Status ListJobs(grpc::ServerContext* context, const v1::ListJobsRequest* request,
                        v1::ListJobsResponse* response) override;
  grpc::Status GetJob(grpc::ServerContext* context, const v1::GetJobRequest* request, v1::Job* job) override;
  grpc::Status RemoveJob(grpc::ServerContext* context, const v1::RemoveJobRequest* request, v1::Job* job) override;
  grpc::ServerBidiReactor<v1::EnhanceRequest, v1::EnhanceResponse>* Enhance(
      grpc::CallbackServerContext* context) override;

  /// Whether neither another live session nor another job would find room.
  bool has_room() const;

  /// Jobs stop where they are (and go on at the next start), sessions end after the frames in flight. Returns at once.
  void drain();

 private:
  using EventWriter = BlockingWriter<v1::JobEvent>;
  class Watcher;

  JobRecord receive_job(grpc::ServerContext& context, grpc::ServerReader<v1::CreateJobPart>& reader,
                        const std::string& owner, const telemetry::TraceContext& trace);
  void watch(EventWriter& writer, const rpc::Caller& caller, const v1::WatchJobRequest& request);
  bool watch_session(EventWriter& writer, const v1::WatchJobRequest& request);
  /// Of a job or live session. Throws kNotFound.
  JobRecord record_of(const std::string& id) const;
  v1::Job to_job(const JobRecord& record) const;

  const std::shared_ptr<std::atomic<bool>> draining_ = std::make_shared<std::atomic<bool>>(false);
  const rpc::Callers callers_;
  JobTable table_;
  const LinkOptions link_;  ///< one for all, so that placement knows of all frames and sessions
  JobRunner runner_;
  LiveSessions live_;
  telemetry::Metrics* const metrics_;
  const std::chrono::milliseconds reader_timeout_;
  std::mutex watchers_mutex_;
  std::condition_variable watchers_changed_;
  std::set<std::shared_ptr<EventWriter>> watchers_;
  ClientQuota watcher_quota_;
  const std::chrono::milliseconds idle_timeout_;
  std::mutex uploads_mutex_;
  ClientQuota upload_quota_;
};

}  // namespace pleat::coordinator
