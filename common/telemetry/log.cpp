#include "common/telemetry/log.hpp"

#include <spdlog/formatter.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>

#include <chrono>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/telemetry/trace.hpp"

namespace pleat::telemetry {
namespace {

/// One JSON object a line; messages may hold any bytes.
class JsonFormatter : public spdlog::formatter {
 public:
  explicit JsonFormatter(std::string service) : service_(std::move(service)) {}

  void format(const spdlog::details::log_msg& message, spdlog::memory_buf_t& target) override {
    const auto since_epoch = message.time.time_since_epoch();
    nlohmann::ordered_json line;
    line["time"] = std::chrono::duration<double>(since_epoch).count();
    line["level"] = std::string(spdlog::level::to_string_view(message.level).data());
    line["service"] = service_;
    line["thread"] = message.thread_id;
    if (const auto trace = current_trace_id(); !trace.empty()) line["trace"] = trace;
    line["message"] = std::string(message.payload.data(), message.payload.size());
    const std::string text = line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
    target.append(text.data(), text.data() + text.size());
  }

  std::unique_ptr<spdlog::formatter> clone() const override { return std::make_unique<JsonFormatter>(service_); }

 private:
  std::string service_;
};

/// " trace=ID" where the line belongs to one. The logger formats in the thread that logs.
class TraceFlag : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg&, const std::tm&, spdlog::memory_buf_t& target) override {
    const std::string_view trace = current_trace_id(), name = " trace=";
    if (trace.empty()) return;
    target.append(name.data(), name.data() + name.size());
    target.append(trace.data(), trace.data() + trace.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override { return std::make_unique<TraceFlag>(); }
};

}  // namespace

void set_up_logging(const std::string& service, const LogOptions& options) {
  const auto level = spdlog::level::from_str(options.level);
  if (level == spdlog::level::off && options.level != "off") {
    throw_invalid_argument("unknown log level '" + options.level + "'");
  }
  const auto sink = std::make_shared<spdlog::sinks::stderr_color_sink_mt>();
  auto logger = std::make_shared<spdlog::logger>(service, sink);
  logger->set_level(level);
  logger->flush_on(spdlog::level::warn);
  if (options.format == "json") {
    logger->set_formatter(std::make_unique<JsonFormatter>(service));
  } else if (options.format == "console") {
    auto formatter = std::make_unique<spdlog::pattern_formatter>();
    formatter->add_flag<TraceFlag>('*').set_pattern("%H:%M:%S.%e %^%l%$ %n: %v%*");
    logger->set_formatter(std::move(formatter));
  } else {
    throw_invalid_argument("unknown log format '" + options.format + "', console or json");
  }
  spdlog::set_default_logger(logger);
}

void audit(const std::string& line) {
  const auto logger = spdlog::default_logger();
  const std::string text = "audit: " + line;
  const spdlog::details::log_msg message(logger->name(), spdlog::level::info, text);
  for (const auto& sink : logger->sinks()) {
    sink->log(message);
    sink->flush();
  }
}

}  // namespace pleat::telemetry
