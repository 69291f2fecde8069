// Ctrl-C and SIGTERM as a question that long work asks.
#pragma once

namespace pleat {

/// The first SIGINT, SIGTERM or SIGHUP makes interrupted() true; a second one ends the process at once with
/// 128 + its number (children that the launcher started end with it). SIGPIPE is ignored. Call once, at the start.
void install_signal_handlers();

bool interrupted() noexcept;

/// Back to the system's reactions: a signal ends the process.
void restore_signal_handlers();

}  // namespace pleat
