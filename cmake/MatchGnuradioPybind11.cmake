# SPDX-License-Identifier: GPL-3.0-or-later
# Sets WIFORCE_PYBIND11_DEFINITIONS, which the Python modules are compiled with.
include(CheckPybind11)
execute_process(
  COMMAND ${PYTHON_EXECUTABLE} -c "from gnuradio.gr import gr_python; print(gr_python.__file__)"
  OUTPUT_VARIABLE gnuradio_module OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
set(gnuradio_id "")
if(gnuradio_module)
  wiforce_pybind11_id(${gnuradio_module} gnuradio_id)
endif()

# Compiled, since the identifier follows from the headers and the compiler.
set(probe ${PROJECT_BINARY_DIR}/CMakeFiles/pybind11_id)
file(WRITE ${probe}.cc
  "#include <pybind11/pybind11.h>\nextern const char id[];\nconst char id[] = PYBIND11_INTERNALS_ID;\n")
try_compile(probed ${PROJECT_BINARY_DIR} ${probe}.cc
  LINK_LIBRARIES pybind11::headers CMAKE_FLAGS -DCMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY
  COPY_FILE ${probe}.a OUTPUT_VARIABLE reason)
