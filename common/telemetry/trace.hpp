// W3C trace context (https://www.w3.org/TR/trace-context/): to which request of a client the work of all services
// belongs. A call carries it in its metadata; a log line shows its id while a TraceScope lives.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace pleat::telemetry {

/// What a caller says of the trace that its call belongs to. Empty: of none.
struct TraceContext {
  std::string trace_id;    ///< 32 hexadecimal digits in lower case, not all 0
  std::string parent_id;   ///< 16 of them: the caller's span
  std::uint8_t flags = 0;  ///< kSampled, kRandomId
  std::string state;       ///< `tracestate`: other systems' own words, handed on as they are

  bool empty() const { return trace_id.empty(); }
  bool operator==(const TraceContext&) const = default;
};

/// The flags that the specification defines; others are not handed on.
inline constexpr std::uint8_t kSampled = 0x01, kRandomId = 0x02;

/// "00-TRACE-PARENT-FLAGS", or what a later version has begun so. Nothing for what the specification calls invalid:
/// another length, an upper-case digit, an id of zeros, version ff.
std::optional<TraceContext> parse_traceparent(std::string_view text);
/// In version 00.
std::string to_traceparent(const TraceContext& context);

/// Handed on only if it has at most 512 printable characters, as the specification demands it; else empty.
std::string checked_tracestate(std::string text);

/// A trace of its own, with random ids.
TraceContext new_trace();
/// The same trace, with a random span for a call that is made on its behalf.
TraceContext child_of(const TraceContext& context);

/// While it lives, the log lines of this thread carry the trace's id, unless it is empty. Scopes nest.
class TraceScope {
 public:
  explicit TraceScope(const TraceContext& context);
  ~TraceScope();
  TraceScope(const TraceScope&) = delete;
  TraceScope& operator=(const TraceScope&) = delete;

 private:
  const std::string id_;
  const std::string* const outer_;
};

/// Of the innermost scope of this thread; empty outside of any.
std::string_view current_trace_id();

}  // namespace pleat::telemetry
