# `cmake --install`: programs in bin/ (pleat_executable), what comes with them in share/pleat, where they look for it
# (common/base/process.hpp: shipped_file). A component is a Debian package (Packages.cmake).
include(GNUInstallDirs)
set(CMAKE_INSTALL_RPATH_USE_LINK_PATH ON)  # a LibTorch that lies elsewhere stays found
install(DIRECTORY deploy/bodies deploy/garments deploy/materials deploy/models deploy/scenes
  DESTINATION ${CMAKE_INSTALL_DATADIR}/pleat COMPONENT pleat-data PATTERN "*.py" EXCLUDE)
install(DIRECTORY deploy/blender/pleat DESTINATION ${CMAKE_INSTALL_DATADIR}/pleat/blender COMPONENT pleat-data
  PATTERN "__pycache__" EXCLUDE)
install(FILES LICENSE README.md CHANGELOG.md DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT doc)
