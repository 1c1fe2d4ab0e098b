# SPDX-License-Identifier: GPL-3.0-or-later
# Sets WIFORCE_PYBIND11_DEFINITIONS, with which the Python modules that share types with GNU Radio are
# compiled.
include(CheckPybind11)
execute_process(
  COMMAND ${PYTHON_EXECUTABLE} -c "from gnuradio.gr import gr_python; print(gr_python.__file__)"
  OUTPUT_VARIABLE gnuradio_module OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
set(gnuradio_id "")
if(gnuradio_module)
  wiforce_pybind11_id(${gnuradio_module} gnuradio_id)
endif()

# Compiled, since the identifier follows from the headers, the compiler and its options.
set(probe ${PROJECT_BINARY_DIR}/CMakeFiles/pybind11_id)
file(WRITE ${probe}.cc
  "#include <pybind11/detail/internals.h>\nextern const char id[];\nconst char id[] = PYBIND11_INTERNALS_ID;\n")
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
try_compile(has_probe ${probe} ${probe}.cc LINK_LIBRARIES pybind11::module COPY_FILE ${probe}.a)
unset(CMAKE_TRY_COMPILE_TARGET_TYPE)
set(own_id "")
if(has_probe)
  wiforce_pybind11_id(${probe}.a own_id)
endif()
unset(has_probe CACHE) # compiled anew when pybind11 or the compiler changes
wiforce_match_pybind11("${gnuradio_id}" "${own_id}" "${pybind11_VERSION}" WIFORCE_PYBIND11_DEFINITIONS)
