// What every program of ours ends with.
#pragma once

#include "common/base/error.hpp"

namespace pleat {

inline constexpr int kExitDone = 0;
inline constexpr int kExitFailed = 1;
inline constexpr int kExitWrongInput = 2;  ///< usage or input
inline constexpr int kExitNotClean = 3;    ///< the result is there, with penetrations or self-intersections
inline constexpr int kExitRunAgain = 75;   ///< not done yet: the same command goes on (EX_TEMPFAIL of sysexits.h)

/// kExitWrongInput where the user's input is to blame, kExitFailed otherwise.
inline int exit_code(ErrorCode code) {
  switch (code) {
    case ErrorCode::kInvalidArgument:
    case ErrorCode::kNotFound:
    case ErrorCode::kAlreadyExists:
    case ErrorCode::kFailedPrecondition:
    case ErrorCode::kDataLoss:
      return kExitWrongInput;
    default:
      return kExitFailed;
  }
}

}  // namespace pleat
