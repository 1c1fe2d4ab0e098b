# SPDX-License-Identifier: GPL-3.0-or-later
# What is installed beside the library and the compiled module.
set(package ${GR_PYTHON_DIR}/gnuradio/wiforce)
set(without_caches PATTERN __pycache__ EXCLUDE PATTERN bindings EXCLUDE)

install(DIRECTORY python/wiforce/ DESTINATION ${package} FILES_MATCHING PATTERN *.py ${without_caches})
install(DIRECTORY gr-wiforce/wiforce_app gr-wiforce/software_n210 DESTINATION ${GR_PYTHON_DIR} ${without_caches})
install(DIRECTORY gr-wiforce/ DESTINATION ${WIFORCE_DATA_DIR}
  PATTERN wiforce_app EXCLUDE PATTERN software_n210 EXCLUDE PATTERN completions EXCLUDE
  PATTERN systemd EXCLUDE ${without_caches})
install(DIRECTORY grc/ DESTINATION ${GRC_BLOCKS_DIR} FILES_MATCHING PATTERN *.yml)
install(DIRECTORY include/gnuradio/wiforce DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/gnuradio)
install(DIRECTORY lib/kernel DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/gnuradio/wiforce
  FILES_MATCHING PATTERN *.h PATTERN clones.h EXCLUDE)

install(FILES docs/gr-wiforce.1 DESTINATION ${CMAKE_INSTALL_MANDIR}/man1)
install(FILES gr-wiforce/completions/gr-wiforce.bash RENAME gr-wiforce
  DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions)
install(FILES gr-wiforce/completions/gr-wiforce.zsh RENAME _gr-wiforce
  DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/site-functions)
install(FILES gr-wiforce/completions/gr-wiforce.fish
  DESTINATION ${CMAKE_INSTALL_DATADIR}/fish/vendor_completions.d)

set(GR_WIFORCE_COMMAND ${CMAKE_INSTALL_FULL_BINDIR}/gr-wiforce)
configure_file(gr-wiforce/systemd/gr-wiforce-live@.service.in
  ${PROJECT_BINARY_DIR}/install/gr-wiforce-live@.service @ONLY)
# Where systemd searches below /usr and below /usr/local.
install(FILES ${PROJECT_BINARY_DIR}/install/gr-wiforce-live@.service DESTINATION lib/systemd/system)

# Relative, so that an installed tree can be moved.
file(RELATIVE_PATH DATA_FROM_PACKAGE /${package} /${WIFORCE_DATA_DIR})
configure_file(cmake/_config.py.in ${PROJECT_BINARY_DIR}/install/_config.py @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/install/_config.py DESTINATION ${package})

file(RELATIVE_PATH PACKAGES_FROM_BIN /${CMAKE_INSTALL_BINDIR} /${GR_PYTHON_DIR})
set(LAUNCHER_INTERPRETER ${PYTHON_EXECUTABLE})
configure_file(cmake/gr-wiforce.in ${PROJECT_BINARY_DIR}/install/gr-wiforce @ONLY)
install(PROGRAMS ${PROJECT_BINARY_DIR}/install/gr-wiforce DESTINATION ${CMAKE_INSTALL_BINDIR})

include(CMakePackageConfigHelpers)
set(config_dir ${CMAKE_INSTALL_LIBDIR}/cmake/gnuradio-wiforce)
configure_package_config_file(cmake/gnuradio-wiforceConfig.cmake.in
  ${PROJECT_BINARY_DIR}/install/gnuradio-wiforceConfig.cmake INSTALL_DESTINATION ${config_dir})
write_basic_package_version_file(
  ${PROJECT_BINARY_DIR}/install/gnuradio-wiforceConfigVersion.cmake
  COMPATIBILITY SameMajorVersion)
install(FILES ${PROJECT_BINARY_DIR}/install/gnuradio-wiforceConfig.cmake
  ${PROJECT_BINARY_DIR}/install/gnuradio-wiforceConfigVersion.cmake DESTINATION ${config_dir})
install(EXPORT gnuradio-wiforceTargets NAMESPACE gnuradio:: DESTINATION ${config_dir})

# The build tree as a package: -Dgnuradio-wiforce_DIR=.../build/package
set(tree_package ${PROJECT_BINARY_DIR}/package)
configure_package_config_file(cmake/gnuradio-wiforceConfig.cmake.in
  ${tree_package}/gnuradio-wiforceConfig.cmake INSTALL_DESTINATION ${tree_package}
  INSTALL_PREFIX ${PROJECT_BINARY_DIR})
configure_file(${PROJECT_BINARY_DIR}/install/gnuradio-wiforceConfigVersion.cmake
  ${tree_package}/gnuradio-wiforceConfigVersion.cmake COPYONLY)
export(EXPORT gnuradio-wiforceTargets NAMESPACE gnuradio::
  FILE ${tree_package}/gnuradio-wiforceTargets.cmake)

configure_file(cmake/SayPaths.cmake.in ${PROJECT_BINARY_DIR}/install/SayPaths.cmake @ONLY)
install(SCRIPT ${PROJECT_BINARY_DIR}/install/SayPaths.cmake)
