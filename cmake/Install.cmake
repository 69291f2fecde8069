# `cmake --install`: programs in bin/ (pleat_executable), what comes with them in share/pleat, where they look for it
# (common/base/process.hpp: shipped_file).
include(GNUInstallDirs)
set(CMAKE_INSTALL_RPATH_USE_LINK_PATH ON)  # a LibTorch that lies elsewhere stays found
install(DIRECTORY deploy/bodies deploy/garments deploy/materials deploy/models deploy/scenes
  DESTINATION ${CMAKE_INSTALL_DATADIR}/pleat PATTERN "*.py" EXCLUDE)
install(FILES LICENSE README.md DESTINATION ${CMAKE_INSTALL_DOCDIR})
