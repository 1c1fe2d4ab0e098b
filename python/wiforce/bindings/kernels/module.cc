// SPDX-License-Identifier: GPL-3.0-or-later
// Plain kernels for NumPy: nothing here needs GNU Radio's runtime.
#include "kernels.h"

#include <kernel/timing/device_settings.h>
#include <kernel/timing/timeline.h>

#include <exception>
#include <memory>
#include <unistd.h>

using namespace gr::wiforce::kernel;

static int exit_status = 0;

// UHD's blocks throw when they are stopped without their device. GNU Radio stops blocks
// in a destructor, out of which no exception can be caught.
static void exit_on_terminate(int status)
{
    exit_status = status;
    std::set_terminate([] { _exit(exit_status); });
}

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

PYBIND11_MODULE(wiforce_kernels, m)
{
    py::register_local_exception_translator(translate_refusal);
    bind_inversion(m);
    bind_phases(m);
    bind_press(m);
    bind_recordings(m);
    bind_separation(m);
    bind_tones(m);
    m.def("exit_on_terminate",
          &exit_on_terminate,
          "From now on, an exception that nothing catches in C++ ends the process with "
          "this "
          "status, without a message and without a core dump.");
    py::class_<timeline>(m, "timeline", "Times on a stream of samples; see Timeline.")
        .def(py::init<double>())
        .def("note", &note)
        .def_property_readonly("lost", &timeline::lost)
        .def("time_at", &time_at);
    py::class_<device_settings>(
        m,
        "device_settings",
        "Rate and carrier of a stream of samples; see DeviceSettings.")
        .def(py::init([](double sample_rate, double carrier) {
            auto settings = std::make_unique<device_settings>(sample_rate);
            settings->expect_carrier(carrier);
            return settings;
        }))
        .def("expect_carrier", &device_settings::expect_carrier)
        .def("note_rate", &device_settings::note_rate)
        .def("note_carrier", &device_settings::note_carrier)
        .def("refused_carrier", &device_settings::refused_carrier)
        .def("usable", &device_settings::usable)
        .def("carrier", &device_settings::carrier);
}
