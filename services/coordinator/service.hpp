// The gRPC service pleat.v1.Coordinator over jobs and live sessions.
#pragma once

#include <atomic>
#include <filesystem>
#include <memory>
#include <string>

#include "common/base/runtime_folder.hpp"
#include "common/rpc/channel.hpp"
#include "common/telemetry/metrics.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"
#include "services/coordinator/job_runner.hpp"
#include "services/coordinator/live_session.hpp"

namespace pleat::coordinator {

struct CoordinatorOptions {
  /// Comma-separated addresses: the replicas of each service.
  std::string simulation = default_address("simulation");
  std::string conversion = default_address("conversion");
  std::string superres = default_address("superres");
  std::string refinement = default_address("refinement");
  std::string data = "pleat-data";  ///< folder of the jobs
  rpc::TlsOptions service_tls;      ///< towards the services
  double give_up_s = 30;            ///< a service that is away this long fails its sessions
  double answer_timeout_s = 60;     ///< longest wait for one frame, or for a session to open
  JobSettings jobs;
  LiveSettings live;
};

class CoordinatorService final : public v1::Coordinator::WithCallbackMethod_Enhance<v1::Coordinator::Service> {
 public:
  /// Reads the data folder and takes up unfinished jobs. Throws kInvalidArgument (an option, the folder).
  /// metrics may be null and must outlive the service.
  CoordinatorService(const CoordinatorOptions& options, telemetry::Metrics* metrics);

  grpc::Status CreateJob(grpc::ServerContext* context, const v1::CreateJobRequest* request, v1::Job* job) override;
  grpc::Status WatchJob(grpc::ServerContext* context, const v1::WatchJobRequest* request,
                        grpc::ServerWriter<v1::JobEvent>* writer) override;
  grpc::Status CancelJob(grpc::ServerContext* context, const v1::CancelJobRequest* request, v1::Job* job) override;
  grpc::Status ListJobs(grpc::ServerContext* context, const v1::ListJobsRequest* request,
                        v1::ListJobsResponse* response) override;
  grpc::Status GetJob(grpc::ServerContext* context, const v1::GetJobRequest* request, v1::Job* job) override;
  grpc::ServerBidiReactor<v1::EnhanceRequest, v1::EnhanceResponse>* Enhance(
      grpc::CallbackServerContext* context) override;

  /// Jobs stop where they are (and go on at the next start), sessions end after the frames in flight. Returns at once.
  void drain();

 private:
  class Watcher;

  v1::Job to_job(const JobRecord& record) const;

  std::atomic<bool> draining_{false};
  JobTable table_;
  JobRunner runner_;
  LiveSessions live_;
};

}  // namespace pleat::coordinator
