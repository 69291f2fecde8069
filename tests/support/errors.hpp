// What code under test refuses.
#pragma once

#include <gtest/gtest.h>

#include "common/base/error.hpp"

namespace pleat::test {

/// The error that body() throws. Throwing none fails the test.
template <typename Body>
Error error_of(const Body& body) {
  try {
    body();
  } catch (const Error& error) {
    return error;
  }
  ADD_FAILURE() << "no error was thrown";
  return Error(ErrorCode::kInternal, "none");
}

}  // namespace pleat::test
