// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/press/press_filter.h>

#include <pybind11/stl.h>

#include <cmath>
#include <memory>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

namespace {

using outcome = press_filter::outcome;

py::array_t<outcome> array_of(const std::vector<outcome>& rows)
{
    return py::array_t<outcome>(static_cast<py::ssize_t>(rows.size()), rows.data());
}

py::array_t<outcome> take(press_filter& filter, const array<press_observation>& groups)
{
    std::vector<outcome> rows;
    for (py::ssize_t i = 0; i < groups.size(); i++) {
        const auto& group = groups.data()[i];
        // NaN where the group could not be read.
        const bool readable = !std::isnan(group.phase[0]);
        if (readable)
            filter.take(group);
        else
            filter.pass(group);
        for (auto& each : readable ? filter.before_newest() : filter.newest()) {
            each.row = i;
            rows.push_back(each);
        }
    }
    return array_of(rows);
}

} // namespace

void bind_press(py::module& m)
{
    PYBIND11_NUMPY_DTYPE(press_observation,
                         time_s,
                         phase,
                         amplitude,
                         variance,
                         common_variance,
                         receiver_phase,
                         receiver_amplitude,
                         receiver_variance,
                         retuned,
                         untouched);
    PYBIND11_NUMPY_DTYPE(
        press_filter::average_of_groups, phase, amplitude, variance, weight);
    PYBIND11_NUMPY_DTYPE(press_filter::outcome,
                         row,
                         weight,
                         is,
                         known,
                         turns,
                         baseline,
                         common_variance,
                         difference_variance,
                         amplitude,
                         mean);
    PYBIND11_NUMPY_DTYPE(press_parameters,
                         period_s,
                         settling_s,
                         release,
                         exchange,
                         jump,
                         unexplained,
                         change_s,
                         steady_s,
                         turns,
                         turns_s,
                         turn_deg,
                         turn_np,
                         hands,
                         near_s,
                         steps,
                         contact_np,
                         aside,
                         phase_deg,
                         amplitude_np,
                         fading_np,
                         drift_memory_s,
                         smoothing_s,
                         drift_deg);
    py::class_<press_filter>(
        m,
        "press_filter",
        "Weighs what may have happened to a sensor, group by group (docs/press.md).\n\n"
        "change: (F, L, 2) changes of both phases by presses, rad; forces rise by equal\n"
        "ratios, of the logarithm log_step. spread: rad, by which models are wrong.\n"
        "parameters: of press_parameters.h. untouched: both phases, rad; off: both off\n"
        "states, and their standard deviation (off_states.h).")
        .def(py::init([](const array<double>& change,
                         double log_step,
                         double spread,
                         const array<press_parameters>& parameters,
                         const pair_of_ends& untouched,
                         const std::array<std::complex<double>, 2>& off,
                         double off_std) {
                 if (change.ndim() != 3 || change.shape(2) != 2)
                     throw std::invalid_argument(
                         "press_filter: change must have shape (F, L, 2)");
                 return press_filter(std::make_shared<press_image>(
                                         flat(change),
                                         static_cast<std::size_t>(change.shape(0)),
                                         static_cast<std::size_t>(change.shape(1)),
                                         log_step,
                                         spread),
                                     *parameters.data(),
                                     off_states(untouched, off, off_std));
             }),
             "change"_a,
             "log_step"_a,
             "spread"_a,
             "parameters"_a,
             "untouched"_a = pair_of_ends{},
             "off"_a = std::array<std::complex<double>, 2>{},
             "off_std"_a = 0.0)
        .def("take",
             &take,
             "groups"_a,
             "groups: of press_observation; gives outcomes of the group before each.")
        .def(
            "newest",
            [](const press_filter& filter) { return array_of(filter.newest()); },
            "The outcomes of the newest group, as far as they are known yet.")
        .def("claim_untouched", &press_filter::claim_untouched, "probability"_a)
        .def(
            "change_reference",
            &press_filter::change_reference,
            "phase"_a,
            "amplitude"_a,
            "By how much both phases (rad) and amplitudes (Np) of all groups are larger\n"
            "than against the former reference.");
    m.attr("press_observation") = py::dtype::of<press_observation>();
    m.attr("press_outcome") = py::dtype::of<outcome>();
    const press_parameters defaults;
    m.attr("press_parameters") = py::array_t<press_parameters>(1, &defaults);
}
