// What both sides of a connection agree on.
#pragma once

namespace pleat::rpc {

/// The largest frame of HTTP/2 that a side takes: a fine mesh in one piece, not in nine of 16 KB each.
inline constexpr int kHttp2FrameBytes = 1 << 20;

}  // namespace pleat::rpc
