# SPDX-License-Identifier: GPL-3.0-or-later
# Python modules share C++ types only if both carry the same identifier of pybind11's internal data.
# GNU Radio's modules hold theirs as a string; ours follows from the pybind11 found and the compiler.
# Where they differ, the build succeeds and the import fails, with `type "preamble_fold" referenced
# unknown base type "gr::block"`, so that they are compared here.

set(PYBIND11_ID_FORM "__pybind11_internals_v([0-9]+)(_[a-z]+)(_lib[a-z]+)(_cxxabi[0-9]+)__")

# First identifier in a compiled file, empty if there is none.
function(wiforce_pybind11_id file result)
  file(STRINGS ${file} ids REGEX "__pybind11_internals_v[0-9]")
  string(REGEX MATCH "__pybind11_internals_v[0-9]+[A-Za-z0-9_]*__" id "${ids}")
  set(${result} "${id}" PARENT_SCOPE)
endfunction()

# What the modules must define to share types with GNU Radio's. Ends the configuration if nothing
# helps. `version` is the release of pybind11 found, for the message.
function(wiforce_match_pybind11 theirs ours version result)
  set(${result} "" PARENT_SCOPE)
  if(theirs STREQUAL "" OR ours STREQUAL "")
    message(WARNING
      "could not determine with which pybind11 GNU Radio's Python modules were built. If importing "
      "gnuradio.wiforce fails with \"unknown base type\", build with GNU Radio's version of pybind11.")
    return()
  endif()
  if(theirs STREQUAL ours)
    message(STATUS "pybind11 ${version} shares types with GNU Radio's modules: ${ours}")
    return()
  endif()
  string(REGEX MATCH "^${PYBIND11_ID_FORM}$" form "${ours}")
  set(our_data "${CMAKE_MATCH_1}${CMAKE_MATCH_3}")
  string(REGEX MATCH "^${PYBIND11_ID_FORM}$" form "${theirs}")
  if(form AND our_data STREQUAL "${CMAKE_MATCH_1}${CMAKE_MATCH_3}")
    # Compilers that use the same C++ library on Linux lay out types alike. Releases of pybind11
    # before 3.0 assume that they do not (pybind11 pull request 5439).
    message(STATUS "pybind11 ${version} of another compiler (${ours}); compiled as ${theirs}")
    set(${result} PYBIND11_COMPILER_TYPE="${CMAKE_MATCH_2}" PYBIND11_BUILD_ABI="${CMAKE_MATCH_4}"
      PARENT_SCOPE)
    return()
  endif()
  message(FATAL_ERROR
    "GNU Radio's Python modules and pybind11 ${version} cannot share types:\n"
    "  GNU Radio: ${theirs}\n  this build: ${ours}\n"
    "Python could not import gnuradio.wiforce. Build with the pybind11 that GNU Radio was built with, and "
    "name its folder with -Dpybind11_DIR=/usr/lib/cmake/pybind11. Debian, Ubuntu: apt install "
    "pybind11-dev, and remove a pybind11 from pip that hides it. conda: install the pybind11-abi "
    "that GNU Radio's package depends on. GNU Radio from source: use the pybind11 of that build.")
endfunction()
