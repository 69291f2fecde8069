// Logging of processes: spdlog, on stderr, as lines for people or JSON lines for machines. Libraries do not log. What
// is logged while a TraceScope (trace.hpp) lives ends in " trace=ID", or has the key "trace".
#pragma once

#include <spdlog/spdlog.h>

#include <string>

namespace pleat::telemetry {

struct LogOptions {
  std::string level = "info";      ///< trace, debug, info, warn, error, off
  std::string format = "console";  ///< console or json: {"time":..., "level":..., "service":..., "message":...}
};

/// Sets spdlog's default logger for this process; afterwards spdlog::info(...) and the like work anywhere in adapters.
/// Throws kInvalidArgument for an unknown level or format.
void set_up_logging(const std::string& service, const LogOptions& options);

/// A line "audit: ..." in the log, whatever level was chosen: who did what is kept.
void audit(const std::string& line);

}  // namespace pleat::telemetry
