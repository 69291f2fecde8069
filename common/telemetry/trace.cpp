#include "common/telemetry/trace.hpp"

#include <algorithm>
#include <random>

namespace pleat::telemetry {
namespace {

constexpr std::size_t kVersion = 2, kTraceId = 32, kParentId = 16, kFlags = 2;
constexpr std::size_t kTraceAt = kVersion + 1, kParentAt = kTraceAt + kTraceId + 1,
                      kFlagsAt = kParentAt + kParentId + 1;
constexpr std::size_t kLength = kFlagsAt + kFlags;
constexpr std::size_t kMaxState = 512;
constexpr std::string_view kDigits = "0123456789abcdef";

thread_local const std::string* current = nullptr;

bool is_hex(std::string_view text) { return text.find_first_not_of(kDigits) == std::string_view::npos; }

/// Zeros stand for no id.
bool is_id(std::string_view text) { return is_hex(text) && text.find_first_not_of('0') != std::string_view::npos; }

std::string random_id(std::size_t digits) {
  std::random_device device;
  std::string id(digits, '0');
  do {
    for (char& digit : id) digit = kDigits[device() % kDigits.size()];
  } while (!is_id(id));
  return id;
}

}  // namespace

std::optional<TraceContext> parse_traceparent(std::string_view text) {
  if (text.size() < kLength) return std::nullopt;
  const std::string_view version = text.substr(0, kVersion), trace = text.substr(kTraceAt, kTraceId),
                         parent = text.substr(kParentAt, kParentId), flags = text.substr(kFlagsAt, kFlags);
  if (!is_hex(version) || version == "ff" || !is_id(trace) || !is_id(parent) || !is_hex(flags)) return std::nullopt;
  for (const std::size_t dash : {kTraceAt, kParentAt, kFlagsAt}) {
    if (text[dash - 1] != '-') return std::nullopt;
  }
  // A later version may say more behind another dash.
  if (text.size() > kLength && (version == "00" || text[kLength] != '-')) return std::nullopt;
  TraceContext context{std::string(trace), std::string(parent), 0, {}};
  context.flags = static_cast<std::uint8_t>(kDigits.find(flags[0]) << 4 | kDigits.find(flags[1]));
  context.flags &= kSampled | kRandomId;
  return context;
}

std::string to_traceparent(const TraceContext& context) {
  return "00-" + context.trace_id + '-' + context.parent_id + '-' + kDigits[context.flags >> 4] +
         kDigits[context.flags & 0xF];
}

std::string checked_tracestate(std::string text) {
  const bool printable = std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; });
  return printable && text.size() <= kMaxState ? std::move(text) : std::string();
}

TraceContext new_trace() { return {random_id(kTraceId), random_id(kParentId), kRandomId, {}}; }

TraceContext child_of(const TraceContext& context) {
  TraceContext child = context;
  child.parent_id = random_id(kParentId);
  return child;
}

TraceScope::TraceScope(const TraceContext& context) : id_(context.trace_id), outer_(current) { current = &id_; }
TraceScope::~TraceScope() { current = outer_; }

std::string_view current_trace_id() { return current == nullptr ? std::string_view() : std::string_view(*current); }

}  // namespace pleat::telemetry
