# pleat_library(NAME SOURCES... LINK PUBLIC_LIBS...): a static library with our include root, warnings and -march.
function(pleat_common_options target)
  target_include_directories(${target} PUBLIC ${PROJECT_SOURCE_DIR})
  pleat_private_options(${target})
endfunction()

# Warnings, -march, sanitizers and coverage: what nobody who links the target inherits.
function(pleat_private_options target)
  target_link_libraries(${target} PRIVATE pleat_warnings)
  if(PLEAT_ARCH)
    target_compile_options(${target} PRIVATE -march=${PLEAT_ARCH})
  endif()
  if(PLEAT_SANITIZE)
    target_compile_options(${target} PRIVATE -fsanitize=${PLEAT_SANITIZE} -fno-omit-frame-pointer)
    target_link_options(${target} PUBLIC -fsanitize=${PLEAT_SANITIZE})
  endif()
  if(PLEAT_COVERAGE)
    target_compile_options(${target} PRIVATE --coverage -fprofile-update=atomic)
    target_link_options(${target} PUBLIC --coverage)
  endif()
endfunction()

function(pleat_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;LINK" ${ARGN})
  add_library(${name} STATIC ${ARG_SOURCES})
  target_link_libraries(${name} PUBLIC ${ARG_LINK})
  pleat_common_options(${name})
endfunction()

# pleat_executable(NAME SOURCES... LINK LIBS... [PACKAGE NAME]): lands in build/bin. The target `programs` builds all of
# them; those of services/ are installed, with their manual pages and completions (common/base/manual.hpp), as part of
# PACKAGE (default: a package of their own).
add_custom_target(programs)
function(pleat_executable name)
  cmake_parse_arguments(ARG "" "PACKAGE" "SOURCES;LINK" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE ${ARG_LINK})
  pleat_common_options(${name})
  add_dependencies(programs ${name})
  if(CMAKE_CURRENT_SOURCE_DIR MATCHES "^${PROJECT_SOURCE_DIR}/services/")
    if(NOT ARG_PACKAGE)
      set(ARG_PACKAGE ${name})
    endif()
    install(TARGETS ${name} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT ${ARG_PACKAGE})
    set(manual ${PROJECT_BINARY_DIR}/manual/${name})
    add_custom_command(OUTPUT ${manual}.stamp
      COMMAND ${CMAKE_COMMAND} -E rm -rf ${manual}
      COMMAND ${CMAKE_COMMAND} -E env ASAN_OPTIONS=detect_leaks=0 $<TARGET_FILE:${name}> --write-manual ${manual}
      COMMAND gzip -9nr ${manual}/man
      COMMAND ${CMAKE_COMMAND} -E touch ${manual}.stamp
      DEPENDS ${name} VERBATIM)
    add_custom_target(manual-${name} ALL DEPENDS ${manual}.stamp)
    add_dependencies(programs manual-${name})
    install(DIRECTORY ${manual}/ DESTINATION ${CMAKE_INSTALL_DATADIR} COMPONENT ${ARG_PACKAGE})
  endif()
endfunction()

# pleat_test(NAME SOURCES... LINK LIBS...): a GoogleTest program, one CTest entry each, run from the source root.
function(pleat_test name)
  cmake_parse_arguments(ARG "" "TIMEOUT" "SOURCES;LINK" ${ARGN})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 240)
  endif()
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE ${ARG_LINK} GTest::gtest GTest::gmock GTest::gtest_main)
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/tests)
  pleat_common_options(${name})
  add_test(NAME ${name} COMMAND ${name} WORKING_DIRECTORY ${PROJECT_SOURCE_DIR})
  set_tests_properties(${name} PROPERTIES TIMEOUT ${ARG_TIMEOUT}
    ENVIRONMENT "PLEAT_SOURCE_DIR=${PROJECT_SOURCE_DIR};PLEAT_BINARY_DIR=${PROJECT_BINARY_DIR}")
endfunction()

# pleat_add_rooms(DIR...): adds the folders that exist below the current one.
function(pleat_add_rooms)
  foreach(room ${ARGN})
    if(EXISTS ${CMAKE_CURRENT_SOURCE_DIR}/${room}/CMakeLists.txt)
      add_subdirectory(${room})
    endif()
  endforeach()
endfunction()
