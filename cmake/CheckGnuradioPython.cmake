# SPDX-License-Identifier: GPL-3.0-or-later
# GNU Radio's interpreter must import GNU Radio. Anything else fails later, and less clearly.
execute_process(
  COMMAND ${PYTHON_EXECUTABLE} -c
          "import numpy, gnuradio.gr as gr; print(gr.version(), numpy.__version__)"
  RESULT_VARIABLE status OUTPUT_VARIABLE versions ERROR_VARIABLE reason
  OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_STRIP_TRAILING_WHITESPACE)
if(NOT status EQUAL 0)
  message(FATAL_ERROR
    "${PYTHON_EXECUTABLE} cannot import GNU Radio:\n${reason}\n"
    "Install GNU Radio's Python part for this interpreter (Debian, Ubuntu: apt install gnuradio), "
    "or name the right one with -DPYTHON_EXECUTABLE=/usr/bin/python3. "
    "An error that mentions numpy means that a NumPy from pip hides the system's.")
endif()
message(STATUS "GNU Radio and NumPy of ${PYTHON_EXECUTABLE}: ${versions}")
