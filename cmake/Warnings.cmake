# One target carries the warnings, so that they reach our code and nothing generated or imported.
add_library(pleat_warnings INTERFACE)
target_compile_options(pleat_warnings INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Wold-style-cast -Woverloaded-virtual
  -Wcast-align -Wunused -Wimplicit-fallthrough)
option(PLEAT_WERROR "treat warnings as errors" OFF)
if(PLEAT_WERROR)
  target_compile_options(pleat_warnings INTERFACE -Werror)
endif()
