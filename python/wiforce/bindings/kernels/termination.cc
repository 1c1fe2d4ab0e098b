// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <exception>
#include <unistd.h>

namespace py = pybind11;
using namespace py::literals;

static int exit_status = 0;

// UHD's blocks throw when they are stopped without their device. GNU Radio stops blocks
// in a destructor, out of which no exception can be caught.
static void exit_on_terminate(int status)
{
    exit_status = status;
    std::set_terminate([] { _exit(exit_status); });
}

void bind_termination(py::module& m)
{
    m.def("exit_on_terminate",
          &exit_on_terminate,
          "From now on, an exception that nothing catches in C++ ends the process with "
          "this "
          "status, without a message and without a core dump.",
          "status"_a);
}
