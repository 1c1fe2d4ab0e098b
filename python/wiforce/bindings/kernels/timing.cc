// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/timing/timeline.h>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

// Samples lost just before an item, 0 unless its time says so.
static std::uint64_t
note(timeline& times, std::uint64_t item, std::uint64_t seconds, double fraction)
{
    const auto [verdict, off] = times.note(item, { seconds, fraction });
    return verdict == timeline::verdict::ignored ? 0 : static_cast<std::uint64_t>(off);
}

static py::object time_at(const timeline& times, std::uint64_t item)
{
    const auto time = times.time_at(item);
    return time ? py::make_tuple(time->seconds, time->fraction) : py::object(py::none());
}

void bind_timing(py::module& m)
{
    py::class_<timeline>(m, "timeline", "Times on a stream of samples; see Timeline.")
        .def(py::init<double>(), "sample_rate"_a)
        .def("note", &note, "item"_a, "seconds"_a, "fraction"_a)
        .def("time_at", &time_at, "item"_a);
}
