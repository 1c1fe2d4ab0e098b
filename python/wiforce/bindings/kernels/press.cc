// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/press/press_filter.h>

#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

namespace {

// Explanations with less weight than this change no reading.
constexpr double least_weight = 1e-5;

struct group_row {
    double time_s;
    double phase[2], amplitude[2], variance[2];
    double common_variance;
    double receiver_phase, receiver_amplitude, receiver_variance;
    double retuned, untouched;
};

struct outcome_row {
    double row, weight, is, known, turns;
    double baseline[2];
    double common_variance, difference_variance, amplitude;
    double mean_phase[2], mean_amplitude[2], mean_variance[2];
};

press_parameters parameters_of(const py::dict& values)
{
    static const std::pair<const char*, double press_parameters::*> names[] = {
        { "settling_s", &press_parameters::settling_s },
        { "release", &press_parameters::release },
        { "exchange", &press_parameters::exchange },
        { "jump", &press_parameters::jump },
        { "unexplained", &press_parameters::unexplained },
        { "change_s", &press_parameters::change_s },
        { "steady_s", &press_parameters::steady_s },
        { "turns", &press_parameters::turns },
        { "turns_s", &press_parameters::turns_s },
        { "turn_deg", &press_parameters::turn_deg },
        { "turn_np", &press_parameters::turn_np },
        { "hands", &press_parameters::hands },
        { "near_s", &press_parameters::near_s },
        { "steps", &press_parameters::steps },
        { "contact_np", &press_parameters::contact_np },
        { "aside", &press_parameters::aside },
        { "phase_deg", &press_parameters::phase_deg },
        { "amplitude_np", &press_parameters::amplitude_np },
        { "fading_np", &press_parameters::fading_np },
        { "drift_memory_s", &press_parameters::drift_memory_s },
        { "smoothing_s", &press_parameters::smoothing_s },
        { "drift_deg", &press_parameters::drift_deg },
    };
    press_parameters set;
    for (const auto& [key, value] : values) {
        const auto name = key.cast<std::string>();
        const auto known =
            std::find_if(std::begin(names), std::end(names), [&](const auto& item) {
                return name == item.first;
            });
        if (known == std::end(names))
            throw std::invalid_argument("press_filter: unknown parameter " + name);
        set.*(known->second) = value.cast<double>();
    }
    return set;
}

press_observation observed(const group_row& row)
{
    press_observation group;
    group.time_s = row.time_s;
    for (int e = 0; e < 2; e++) {
        group.phase[e] = row.phase[e];
        group.amplitude[e] = row.amplitude[e];
        group.variance[e] = row.variance[e];
    }
    group.common_variance = row.common_variance;
    group.receiver_phase = row.receiver_phase;
    group.receiver_amplitude = row.receiver_amplitude;
    group.receiver_variance = row.receiver_variance;
    group.retuned = row.retuned != 0;
    group.untouched = row.untouched;
    return group;
}

void add(std::vector<outcome_row>& rows,
         std::size_t row,
         const std::vector<press_filter::weighted_outcome>& found)
{
    for (const auto& [weight, what] : found)
        if (weight > least_weight)
            rows.push_back({ static_cast<double>(row),
                             weight,
                             static_cast<double>(what.is),
                             static_cast<double>(what.known),
                             static_cast<double>(what.turns),
                             { what.baseline[0], what.baseline[1] },
                             what.common_variance,
                             what.difference_variance,
                             what.amplitude,
                             { what.mean.phase[0], what.mean.phase[1] },
                             { what.mean.amplitude[0], what.mean.amplitude[1] },
                             { what.mean.variance[0], what.mean.variance[1] } });
}

py::array_t<double> table(const std::vector<outcome_row>& rows)
{
    constexpr std::size_t columns = sizeof(outcome_row) / sizeof(double);
    py::array_t<double> values(std::vector<std::size_t>{ rows.size(), columns });
    if (!rows.empty())
        std::memcpy(
            values.mutable_data(), rows.data(), rows.size() * sizeof(outcome_row));
    return values;
}

py::array_t<double> take(press_filter& filter, const array<double>& groups)
{
    const auto received = structures<group_row>(groups);
    std::vector<outcome_row> rows;
    for (std::size_t i = 0; i < received.size(); i++) {
        // NaN where the group could not be read.
        const bool readable = !std::isnan(received[i].phase[0]);
        if (readable)
            filter.take(observed(received[i]));
        else
            filter.pass(observed(received[i]));
        add(rows, i, readable ? filter.before_newest() : filter.newest());
    }
    return table(rows);
}

} // namespace

void bind_press(py::module& m)
{
    py::class_<press_filter>(
        m,
        "press_filter",
        "Weighs what may have happened to a sensor, group by group (docs/press.md).\n\n"
        "change: (F, L, 2) changes of both phases by presses, rad; forces rise by equal\n"
        "ratios, of the logarithm log_step. spread: rad, by which models are wrong.\n"
        "parameters: of press_parameters.h, where they differ. untouched: both phases,\n"
        "rad; off: both off states, and their standard deviation (off_states.h).")
        .def(py::init([](const array<double>& change,
                         double log_step,
                         double spread,
                         const py::dict& parameters,
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
                                     parameters_of(parameters),
                                     off_states(untouched, off, off_std));
             }),
             "change"_a,
             "log_step"_a,
             "spread"_a,
             "parameters"_a = py::dict(),
             "untouched"_a = pair_of_ends{},
             "off"_a = std::array<std::complex<double>, 2>{},
             "off_std"_a = 0.0)
        .def(
            "take",
            &take,
            "groups"_a,
            "groups: (n, 13) time, both phases, amplitudes and variances, variance of a\n"
            "rotation of both ends, turn, gain and variance of the receiver, whether it\n"
            "was retuned, probability that the user says it is untouched. Gives (m, "
            "16):\n"
            "i, weight, state, whether the untouched line is known, "
            "whether\n"
            "the tag turns, both phases of the untouched line, variances of their mean\n"
            "and their difference, amplitude; both phases, amplitudes and variances of\n"
            "what was received, averaged; of the group before group i.")
        .def(
            "newest",
            [](const press_filter& filter) {
                std::vector<outcome_row> rows;
                add(rows, 0, filter.newest());
                return table(rows);
            },
            "The same of the newest group, as far as is known yet.")
        .def("claim_untouched", &press_filter::claim_untouched, "probability"_a)
        .def(
            "change_reference",
            [](press_filter& filter,
               const array<double>& phase,
               const array<double>& amplitude) {
                filter.change_reference({ phase.at(0), phase.at(1) },
                                        { amplitude.at(0), amplitude.at(1) });
            },
            "phase"_a,
            "amplitude"_a,
            "By how much both phases (rad) and amplitudes (Np) of all groups are larger\n"
            "than against the former reference.");
}
