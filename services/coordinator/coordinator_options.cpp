#include "services/coordinator/coordinator_options.hpp"

namespace pleat::coordinator {

void add_options(config::Options& options, CoordinatorOptions& coordinator) {
  options.add("simulation", coordinator.simulation, "address of the simulation service, or several with commas")
      .add("conversion", coordinator.conversion, "addresses of the conversion service")
      .add("superres", coordinator.superres, "addresses of the super-resolution service")
      .add("fold", coordinator.fold, "addresses of the fold service")
      .add("refinement", coordinator.refinement, "addresses of the refinement service")
      .add("service-tls-ca", coordinator.service_tls.ca_file, "PEM file, for services on other hosts")
      .add("service-tls-certificate", coordinator.service_tls.certificate_file, "PEM file")
      .add("service-tls-key", coordinator.service_tls.key_file, "PEM file")
      .add("token-file", coordinator.token_file, "file of NAME ROLE TOKEN: who may call without a certificate")
      .add("data", coordinator.data, "folder of the jobs and their results")
      .add("give-up-s", coordinator.give_up_s, "a service that is away this long fails its jobs and sessions")
      .add("answer-timeout-s", coordinator.answer_timeout_s, "a service that does not answer this long is reconnected")
      .add("jobs", coordinator.jobs.concurrency, "jobs at the same time")
      .add("max-queued", coordinator.jobs.max_queued, "jobs that wait; more are refused")
      .add("max-jobs-each", coordinator.jobs.max_jobs_each, "of one owner that have not ended; 0: no limit")
      .add("max-gb-each", coordinator.jobs.max_gb_each, "of one owner's jobs on disk; 0: no limit")
      .add("keep-days", coordinator.jobs.keep_days, "jobs that ended longer ago are removed; 0: never")
      .add("jobs-yield", coordinator.jobs.yield, "where processors are short, live sessions have them first")
      .add("window", coordinator.jobs.window, "frames of a job in flight per stage and replica, 1 to 64")
      .add("checkpoint-interval", coordinator.jobs.checkpoint_interval, "frames between check-points of a simulation")
      .add("max-frames", coordinator.jobs.max_frames, "longest job")
      .add("compress", coordinator.jobs.compress, "compress finished result files")
      .add("max-sessions", coordinator.live.max_sessions, "live sessions at the same time")
      .add("max-sessions-each", coordinator.live.max_sessions_each, "of one client; 0: as many as all together")
      .add("max-live-gb", coordinator.live.max_live_gb, "frames in flight of all live sessions together")
      .add("max-watchers", coordinator.max_watchers, "calls of WatchJob at the same time")
      .add("max-watchers-each", coordinator.max_watchers_each, "of one client; 0: as many as all together")
      .add("max-uploads", coordinator.max_uploads, "jobs whose animations are on their way in parts at the same time")
      .add("max-vertices", coordinator.jobs.max_vertices, "largest fine mesh of a session or job")
      .add("open-timeout-s", coordinator.live.open_timeout_s, "a session that sends no `open` this long is ended")
      .add("idle-timeout-s", coordinator.live.idle_timeout_s, "a session that sends no frame this long is ended")
      .add("reader-timeout-s", coordinator.live.reader_timeout_s,
           "a client that does not take what it asked for this long is cut off");
}

}  // namespace pleat::coordinator
