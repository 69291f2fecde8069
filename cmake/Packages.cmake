# `make deb`: Debian packages by CPack, one for each service, the command, its data, the SDK and the Python package.
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME pleat)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_CONTACT "The Pleat authors <pleat@localhost>")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_OUTPUT_FILE_PREFIX ${PROJECT_BINARY_DIR}/packages)
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
  OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS ON)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)

# What Debian's policy wants to be in each package, and `make install` does not.
set(package_files ${PROJECT_BINARY_DIR}/package-files)
configure_file(cmake/copyright.in ${package_files}/copyright @ONLY)
# Debian's own changelog has a form of its own and is dated; ours is with the documents of the command.
string(TIMESTAMP package_date "%a, %d %b %Y %H:%M:%S +0000" UTC)
configure_file(cmake/changelog.in ${package_files}/changelog @ONLY)
execute_process(COMMAND gzip -9nc ${package_files}/changelog OUTPUT_FILE ${package_files}/changelog.gz)
file(WRITE ${package_files}/triggers "activate-noawait ldconfig\n")

# pleat_package(NAME COMPONENT SECTION TITLE TEXT [ARCHITECTURE all] [DEPENDS ...] [RECOMMENDS ...])
function(pleat_package name component section title text)
  cmake_parse_arguments(ARG "" "ARCHITECTURE;DEPENDS;RECOMMENDS" "" ${ARGN})
  string(TOUPPER ${component} key)
  set(prefix CPACK_DEBIAN_${key})
  macro(publish variable)
    set(${variable} "${ARGN}" PARENT_SCOPE)
  endmacro()
  publish(${prefix}_PACKAGE_NAME ${name})
  publish(${prefix}_PACKAGE_SECTION ${section})
  publish(${prefix}_DESCRIPTION "${title}\n${text}")
  if(ARG_ARCHITECTURE)
    publish(${prefix}_PACKAGE_ARCHITECTURE ${ARG_ARCHITECTURE})
    publish(${prefix}_PACKAGE_SHLIBDEPS OFF)
  endif()
  string(REPLACE "=own" "(= ${PROJECT_VERSION})" depends "${ARG_DEPENDS}")
  publish(${prefix}_PACKAGE_DEPENDS "${depends}")
  publish(${prefix}_PACKAGE_RECOMMENDS "${ARG_RECOMMENDS}")
  install(FILES ${package_files}/copyright ${package_files}/changelog.gz DESTINATION share/doc/${name}
    COMPONENT ${component} EXCLUDE_FROM_ALL)
  list(APPEND CPACK_COMPONENTS_ALL ${component})
  set(CPACK_COMPONENTS_ALL ${CPACK_COMPONENTS_ALL} PARENT_SCOPE)
endfunction()

# CPack indents the lines, and makes a dot of an empty one.
set(about "Pleat turns a cheap coarse cloth simulation into a detailed, wrinkled,\ncollision-free fine mesh, frame by frame.")
pleat_package(pleat pleat graphics "command that makes fine cloth of coarse cloth"
  "${about}\n\nThis is the command, which starts the services itself, and the generator of\ndata sets."
  DEPENDS "pleat-data =own, pleat-simulation =own, pleat-fold =own, pleat-refinement =own, pleat-coordinator =own"
  RECOMMENDS "pleat-conversion, pleat-superres")
pleat_package(pleat-data pleat-data graphics "scenes, garments, fabrics, bodies and networks for Pleat"
  "${about}\n\nWhat comes with the command." ARCHITECTURE all)
pleat_package(pleat-simulation pleat-simulation graphics "cloth simulation service of Pleat"
  "${about}\n\nThis service simulates cloth: coarse, and fine for comparison.")
pleat_package(pleat-conversion pleat-conversion graphics "service of Pleat between meshes and tensors"
  "${about}\n\nThis service turns meshes into geometry images or vertex features, and back.")
pleat_package(pleat-fold pleat-fold graphics "service of Pleat that makes wrinkles by physics"
  "${about}\n\nThis service makes fine frames by physics that is held to the coarse cloth.")
pleat_package(pleat-refinement pleat-refinement graphics "service of Pleat that makes cloth collision-free"
  "${about}\n\nThis service removes penetrations and self-intersections.")
pleat_package(pleat-coordinator pleat-coordinator graphics "service of Pleat that runs jobs and live sessions"
  "${about}\n\nThis service sequences the others, and has the public interface.")
if(TARGET pleat-superres)
  pleat_package(pleat-superres pleat-superres graphics "neural network service of Pleat, and its trainer"
    "${about}\n\nThis service infers detail by a network; pleat-train trains one.")
endif()
set(soversion ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
pleat_package(libpleat-client${soversion} libpleat-client libs "client library of Pleat"
  "${about}\n\nPrograms in C++ enhance cloth and run jobs through this library.")
set(CPACK_DEBIAN_LIBPLEAT-CLIENT_PACKAGE_CONTROL_EXTRA ${package_files}/triggers)
pleat_package(libpleat-client-dev libpleat-client-dev libdevel "client library of Pleat, for development"
  "${about}\n\nHeaders, CMake and pkg-config files, and the wire contract."
  DEPENDS "libpleat-client${soversion} =own, libgrpc++-dev, libprotobuf-dev")
if(TARGET pleat_python)
  pleat_package(python3-pleat python3-pleat python "client of Pleat for Python"
    "${about}\n\nEnhances cloth in numpy arrays, runs jobs, reads results and data sets."
    ARCHITECTURE all DEPENDS "python3, python3-grpcio, python3-protobuf, python3-numpy, python3-h5py" RECOMMENDS "pleat")
endif()
include(CPack)
