# SPDX-License-Identifier: GPL-3.0-or-later
# A build tree that runs with nothing installed: build/python, build/bin and build/run.
set(tree ${PROJECT_BINARY_DIR}/python)
set(package ${tree}/gnuradio/wiforce)
file(MAKE_DIRECTORY ${package})

# The package is a real folder of links, so that it holds the compiled module as well and an
# edited source file counts at once.
file(WRITE ${tree}/gnuradio/__init__.py
  "from pkgutil import extend_path\n__path__ = extend_path(__path__, __name__)\n")
file(GLOB old_links LIST_DIRECTORIES true ${package}/*)
foreach(link ${old_links})
  if(IS_SYMLINK ${link})
    file(REMOVE ${link})
  endif()
endforeach()
file(GLOB entries CONFIGURE_DEPENDS LIST_DIRECTORIES true RELATIVE
  ${PROJECT_SOURCE_DIR}/python/wiforce ${PROJECT_SOURCE_DIR}/python/wiforce/*)
list(REMOVE_ITEM entries bindings __pycache__)
foreach(entry ${entries})
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/python/wiforce/${entry} ${package}/${entry} SYMBOLIC)
endforeach()
foreach(application wiforce_app software_n210)
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/gr-wiforce/${application} ${tree}/${application} SYMBOLIC)
endforeach()

file(RELATIVE_PATH DATA_FROM_PACKAGE ${package} ${PROJECT_SOURCE_DIR}/gr-wiforce)
configure_file(cmake/_config.py.in ${package}/_config.py @ONLY)

# In single quotes, so that a shell takes a $ or a space in a path as it is.
string(REPLACE "'" "'\\''" SOURCE_DIR_IN_SHELL "${PROJECT_SOURCE_DIR}")
set(SOURCE_DIR_IN_SHELL "'${SOURCE_DIR_IN_SHELL}'")
string(REPLACE "'" "'\\''" PYTHON_IN_SHELL "${PYTHON_EXECUTABLE}")
set(PYTHON_IN_SHELL "'${PYTHON_IN_SHELL}'")

set(PACKAGES_FROM_BIN ../python)
set(LAUNCHER_INTERPRETER "/usr/bin/env python3")
configure_file(cmake/gr-wiforce.in ${PROJECT_BINARY_DIR}/bin/gr-wiforce @ONLY)
configure_file(cmake/run.in ${PROJECT_BINARY_DIR}/run @ONLY)
configure_file(cmake/python3.in ${PROJECT_BINARY_DIR}/bin/python3 @ONLY)
configure_file(cmake/pytest.in ${PROJECT_BINARY_DIR}/bin/pytest @ONLY)
file(CHMOD ${PROJECT_BINARY_DIR}/run ${PROJECT_BINARY_DIR}/bin/gr-wiforce
  ${PROJECT_BINARY_DIR}/bin/python3 ${PROJECT_BINARY_DIR}/bin/pytest
  PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
