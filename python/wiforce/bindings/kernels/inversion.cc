// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <pybind11/stl.h>

#include <kernel/inversion/hidden_force.h>
#include <kernel/inversion/phase_inverter.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

static py::ssize_t pairs_in(const array<double>& phases_deg, const array<double>& noise)
{
    const bool alike = phases_deg.ndim() == 2 && phases_deg.shape(1) == 2 &&
                       noise.size() == phases_deg.size();
    if (!alike)
        throw std::invalid_argument("phases and their noise must have shape (n, 2)");
    return phases_deg.shape(0);
}

// Readings (n, 9) in the order of likelihood_profile::reading; NaN where the phases' cell
// has not exactly one row.
static py::array_t<double> read_profile(const likelihood_profile& profile,
                                        const array<double>& phases_deg,
                                        const array<double>& variance_deg2)
{
    constexpr py::ssize_t size = sizeof(likelihood_profile::reading) / sizeof(double);
    const auto count = pairs_in(phases_deg, variance_deg2);
    const double* const psi = phases_deg.data();
    const double* const noise = variance_deg2.data();
    py::array_t<double> readings({ count, size });
    double* out = readings.mutable_data();
    for (py::ssize_t i = 0; i < count; i++, out += size) {
        const auto found = profile.read_turns(
            psi[2 * i], psi[2 * i + 1], noise[2 * i], noise[2 * i + 1]);
        if (found.count == 1)
            std::memcpy(out, &found.first, sizeof(found.first));
        else
            std::fill(out, out + size, NAN);
    }
    return readings;
}

// Values (n, 6): force, location and their covariance; flags (n,); and a list of the
// readings that the tables do not hold.
static py::tuple invert(const phase_inverter& inverter,
                        const array<double>& phases_deg,
                        const array<double>& std_deg)
{
    static_assert(sizeof(phase_inverter::reading) == 6 * sizeof(double));
    const auto count = pairs_in(phases_deg, std_deg);
    py::array_t<double> values({ count, py::ssize_t{ 6 } });
    py::array_t<std::uint8_t> flags(count);
    const double* const psi = phases_deg.data();
    const double* const std = std_deg.data();
    auto* out = reinterpret_cast<phase_inverter::reading*>(values.mutable_data());
    std::uint8_t* const out_flags = flags.mutable_data();
    {
        py::gil_scoped_release others_may_run;
        inverter.read_all(psi, std, count, out, out_flags);
    }
    py::list unknown;
    for (py::ssize_t i = 0; i < count; i++)
        if (out_flags[i] == phase_inverter::unknown)
            unknown.append(i);
    return py::make_tuple(values, flags, unknown);
}

void bind_inversion(py::module& m)
{
    m.attr("HIDDEN_N") = hidden_n;
    m.attr("HIDDEN_RATIO") = hidden_ratio;

    py::class_<likelihood_profile, std::shared_ptr<likelihood_profile>>(
        m,
        "likelihood_profile",
        "Two phases to force and location; see sensor/profile.py.")
        .def(py::init([](const array<double>& force,
                         const array<float>& rows,
                         const array<std::uint8_t>& holds,
                         const array<std::int32_t>& cells) {
                 return likelihood_profile(flat(force),
                                           flat(rows),
                                           flat(holds),
                                           structures<likelihood_profile::cell>(cells));
             }),
             "force_n"_a,
             "rows"_a,
             "holds"_a,
             "cells"_a)
        .def("read", &read_profile, "phases_deg"_a, "variance_deg2"_a);

    py::class_<calibrated_span>(
        m, "calibrated_span", "The forces and locations that a calibration covers.")
        .def(py::init([](const array<double>& location,
                         const array<double>& low,
                         const array<double>& high) {
                 return calibrated_span(flat(location), flat(low), flat(high));
             }),
             "location_mm"_a,
             "low_n"_a,
             "high_n"_a)
        .def("extrapolated",
             &calibrated_span::extrapolated,
             "force_n"_a,
             "location_mm"_a,
             "force_variance"_a,
             "location_variance"_a);

    py::class_<phase_inverter>(
        m, "phase_inverter", "Two phases to force, location and flags; see Inverter.")
        .def(py::init([](const array<double>& rows,
                         const array<std::int32_t>& row_of,
                         std::shared_ptr<likelihood_profile> profile,
                         const calibrated_span& span,
                         std::pair<double, double> force,
                         std::pair<double, double> location,
                         double misfit) {
                 return phase_inverter(
                     inverse_table(structures<inverse_table::row>(rows), flat(row_of)),
                     std::move(profile),
                     span,
                     { force.first,
                       force.second,
                       location.first,
                       location.second,
                       misfit });
             }),
             "rows"_a,
             "row_of"_a,
             "profile"_a,
             "span"_a,
             "force_n"_a,
             "location_mm"_a,
             "misfit"_a)
        .def("invert", &invert, "phases_deg"_a, "std_deg"_a);
}
