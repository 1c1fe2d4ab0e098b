# SPDX-License-Identifier: GPL-3.0-or-later
# What is built: all, or without GNU Radio the library and the commands that need no flowgraph.
set(WIFORCE_GNURADIO AUTO CACHE STRING
  "Build the GNU Radio blocks: ON, OFF, or AUTO when GNU Radio is installed")
set_property(CACHE WIFORCE_GNURADIO PROPERTY STRINGS AUTO ON OFF)

# GNU Radio comes first: it names the interpreter it was built for (PYTHON_EXECUTABLE).
if(WIFORCE_GNURADIO STREQUAL "AUTO")
  find_package(Gnuradio "3.10" QUIET COMPONENTS runtime)
elseif(WIFORCE_GNURADIO)
  find_package(Gnuradio "3.10" REQUIRED COMPONENTS runtime)
endif()

if(Gnuradio_FOUND)
  set(WIFORCE_BLOCKS TRUE)
  if(NOT CMAKE_CROSSCOMPILING)
    include(CheckGnuradioPython)
  endif()
else()
  set(WIFORCE_BLOCKS FALSE)
  if(WIFORCE_GNURADIO STREQUAL "AUTO")
    message(WARNING
      "GNU Radio 3.10 was not found, so its blocks are not built, only the library and the "
      "commands that need no flowgraph. For the blocks, install GNU Radio's development files "
      "(Debian, Ubuntu: apt install gnuradio-dev); -DWIFORCE_GNURADIO=OFF silences this warning.")
  endif()
  find_package(Python 3.10 REQUIRED COMPONENTS Interpreter Development.Module)
  set(PYTHON_EXECUTABLE ${Python_EXECUTABLE})
endif()
