// SPDX-License-Identifier: GPL-3.0-or-later
// The block that `gr-wiforce bench speed` measures latency with.
#include "../refusal.h"
#include "paced_source.h"

#include <pybind11/stl.h>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::bench;

PYBIND11_MODULE(wiforce_bench, m)
{
    py::register_local_exception_translator(translate_refusal);
    // The base classes' Python types.
    py::module::import("gnuradio.gr");
    py::class_<paced_source,
               gr::sync_block,
               gr::block,
               gr::basic_block,
               std::shared_ptr<paced_source>>(
        m, "paced_source", "Produces zeros at the rate and in the packets of a radio.")
        .def(py::init(&paced_source::make),
             "packet_length"_a,
             "sample_rate"_a,
             "mark_every"_a,
             "samples"_a,
             "item_size"_a = 8)
        .def("mark_times",
             &paced_source::mark_times,
             "Seconds of time.monotonic() at which each mark_every-th sample went out.");
}
