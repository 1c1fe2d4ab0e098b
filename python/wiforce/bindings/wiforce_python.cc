// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <gnuradio/wiforce/preamble_fold.h>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce;

static void bind_preamble_fold(py::module& m)
{
    py::class_<preamble_fold, gr::block, gr::basic_block, std::shared_ptr<preamble_fold>>(
        m,
        "preamble_fold",
        "Folds the repeated part of each sounding frame into one vector of 64 "
        "samples.\n\n"
        "Input: samples, fc32 or sc16 (scaled by 1/32768). Output: a vector of 64 "
        "complex\n"
        "per frame; the tag `snapshot` holds its index on the frame grid, on the first "
        "one\n"
        "and after every gap that an `rx_time` tag tells of.")
        .def(py::init(&preamble_fold::make),
             "frame_length"_a,
             "first_averaged"_a = 64,
             "repetitions"_a = 4,
             "sample_rate"_a = 12.5e6,
             "frame_offset"_a = 0,
             "item_type"_a = "fc32")
        .def("snapshots", &preamble_fold::snapshots, "Frames folded so far.")
        .def("samples_lost",
             &preamble_fold::samples_lost,
             "Samples lost before the input, by `rx_time`.")
        .def("gaps", &preamble_fold::gaps, "Times that samples were lost.");
}

PYBIND11_MODULE(wiforce_python, m)
{
    // The base classes' Python types.
    py::module::import("gnuradio.gr");
    bind_preamble_fold(m);
}
