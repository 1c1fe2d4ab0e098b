// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/inversion/press_reading.h>
#include <kernel/phases/sensor_groups.h>
#include <kernel/press/press_filter.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <list>
#include <memory>

using namespace gr::wiforce::kernel;

namespace {

using outcome = press_outcome;

py::array_t<outcome> take(press_filter& filter, const array<press_observation>& groups)
{
    std::vector<outcome> rows;
    {
        py::gil_scoped_release others_may_run;
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
    }
    return copy(rows);
}

using group_reading = press_reading::reading;

py::array_t<group_reading> read_groups(const press_reading& sensor,
                                       const array<outcome>& found,
                                       const array<sensor_group>& groups,
                                       bool wanted,
                                       py::ssize_t begin)
{
    py::array_t<group_reading> readings(groups.size());
    const outcome *next = found.data(), *const end = next + found.size();
    press_posterior::workspace work;
    group_reading* const said = readings.mutable_data();
    py::gil_scoped_release others_may_run;
    for (py::ssize_t row = 0; row < groups.size(); row++) {
        const sensor_group& of = groups.data()[row];
        next = std::find_if(
            next, end, [=](const outcome& each) { return each.row >= begin + row; });
        const outcome* const first = next;
        next = std::find_if(
            first, end, [=](const outcome& each) { return each.row > begin + row; });
        said[row] = sensor.read(of, first, next, wanted, work);
    }
    return readings;
}

// Fields of a `Reading` in order, None where they are not known.
py::list fields_of(const array<group_reading>& readings,
                   const std::vector<py::str>& sensors,
                   double period_s,
                   double start_s,
                   const py::function& flag_words)
{
    const py::ssize_t count = sensors.size();
    if (readings.ndim() != 2 || readings.shape(1) != count)
        throw std::invalid_argument("readings must have shape (G, S)");
    const auto known = [](double value) {
        return std::isnan(value) ? py::object(py::none()) : py::float_(value);
    };
    py::list rows(readings.size());
    for (py::ssize_t i = 0; i < readings.size(); i++) {
        const auto& of = readings.data()[i];
        rows[i] =
            py::make_tuple((of.group + 0.5) * period_s + start_s,
                           sensors[i % count],
                           of.touch < 0 ? py::object(py::none()) : py::int_(of.touch),
                           known(of.force_n),
                           known(of.force_std_n),
                           known(of.location_mm),
                           known(of.location_std_mm),
                           known(of.phases_deg[0]),
                           known(of.phases_deg[1]),
                           known(of.snr_db),
                           flag_words(of.flags),
                           of.group,
                           of.interference);
    }
    return rows;
}

py::tuple groups_of_sensor(const sensor_groups& by,
                           const py::dict& groups,
                           py::ssize_t sensor,
                           const array<double>& receiver)
{
    const auto ratios = groups["ratios"].cast<complex_array>();
    if (ratios.ndim() != 2 || sensor < 0 || 2 * sensor + 1 >= ratios.shape(1))
        throw std::invalid_argument("ratios must have shape (G, 2S)");
    const py::ssize_t count = ratios.shape(0), ends = ratios.shape(1), tags = ends / 2;
    require_shape(receiver, { count, 3 }, "receiver must have shape (G, 3)");
    std::list<py::array> kept;
    const auto rows = [&](const char* name, py::ssize_t columns, auto kind) {
        const auto values = groups[name].cast<array<decltype(kind)>>();
        if (values.size() != count * columns)
            throw std::invalid_argument(std::string(name) + " must have " +
                                        std::to_string(count) + " x " +
                                        std::to_string(columns) + " values");
        kept.push_back(values);
        return values.data();
    };
    stage_arrays of{};
    of.groups = count;
    of.sensors = tags;
    of.ratios = ratios.data();
    of.phase_std_deg = rows("phase_std_deg", ends, double());
    of.snr_db = groups.contains("snr_db") ? rows("snr_db", ends, double()) : nullptr;
    of.in_reference = rows("in_reference", ends, bool());
    of.late_reference = rows("late_reference", ends, bool());
    of.reshaped = rows("reshaped", ends, bool());
    of.locked = rows("locked", tags, bool());
    of.overlapping = rows("overlapping", tags, bool());
    of.disturbed =
        groups.contains("disturbed") ? rows("disturbed", tags, bool()) : nullptr;
    of.index = rows("index", 1, std::int64_t());
    of.missing = rows("missing", 1, std::int64_t());
    of.saturated = rows("saturated", 1, bool());
    of.retuned = rows("retuned", 1, bool());
    of.in_tare = rows("in_tare", 1, bool());
    of.common_std_deg = rows("common_std_deg", 1, double());
    of.interference = rows("interference", 1, double());
    py::array_t<press_observation> seen(count);
    py::array_t<sensor_group> known(count);
    by.of(of, sensor, receiver.data(), seen.mutable_data(), known.mutable_data());
    return py::make_tuple(seen, known);
}

} // namespace

void bind_press(py::module& m)
{
    PYBIND11_NUMPY_DTYPE(average_of_groups, phase, amplitude, variance, weight);
    PYBIND11_NUMPY_DTYPE(press_outcome,
                         row,
                         weight,
                         is,
                         known,
                         turns,
                         in_part,
                         baseline,
                         amplitude,
                         common_variance,
                         difference_variance,
                         covariance,
                         mean);
    PYBIND11_NUMPY_DTYPE(press_parameters,
                         period_s,
                         settling_s,
                         release,
                         exchange,
                         unexplained,
                         change_s,
                         steady_deg,
                         steady_s,
                         turns,
                         turns_per_s,
                         expected_s,
                         turn_deg,
                         turn_np,
                         hands,
                         steps,
                         rarest,
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
        "ratios. spread: rad, by which models are wrong.\n"
        "parameters: of press_parameters.h. untouched: both phases, rad; off: both off\n"
        "states, and their standard deviation (off_states.h).")
        .def(py::init([](const array<double>& change,
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
                                         spread),
                                     *parameters.data(),
                                     off_states(untouched, off, off_std));
             }),
             "change"_a,
             "spread"_a,
             "parameters"_a,
             "untouched"_a,
             "off"_a,
             "off_std"_a)
        .def_property_readonly("off_states_differ", &press_filter::off_states_differ)
        .def("__copy__", [](const press_filter& filter) { return filter; })
        .def("take",
             &take,
             "groups: of press_observation; gives outcomes of the group before each.")
        .def(
            "newest",
            [](const press_filter& filter) { return copy(filter.newest()); },
            "The outcomes of the newest group, as far as they are known yet.")
        .def("claim_untouched", &press_filter::claim_untouched)
        .def(
            "change_reference",
            &press_filter::change_reference,
            "By how much both phases (rad) and amplitudes (Np) of all groups are larger\n"
            "than against the former reference.");
    m.attr("press_outcome") = py::dtype::of<outcome>();
    const press_parameters defaults;
    m.attr("press_parameters") = py::array_t<press_parameters>(1, &defaults);
    py::class_<press_reading>(
        m,
        "press_reading",
        "Touch, force, location and flags of a sensor's groups; see "
        "press/sensor_readout.py.\n\n"
        "bits: of transition, weak, ambiguous, force_unobservable, inconsistent, "
        "extrapolated, moved.\nlimits: standard deviations in deg and N above which a "
        "reading is weak, and the probability\nof an alternative that is named.")
        .def(py::init([](const press_posterior& posterior,
                         const std::array<double, 2>& untouched_rad,
                         const std::array<std::complex<double>, 2>& off,
                         double off_std,
                         bool off_states_differ,
                         double tag_ratio,
                         double ruler_mm2,
                         const std::array<std::int64_t, 7>& bits,
                         const std::array<double, 3>& limits) {
                 if (posterior.phases() != 2)
                     throw std::invalid_argument("posterior must be of one carrier");
                 return press_reading(
                     posterior,
                     { untouched_rad,
                       off,
                       off_std,
                       off_states_differ,
                       tag_ratio,
                       ruler_mm2 },
                     { bits[0], bits[1], bits[2], bits[3], bits[4], bits[5], bits[6] },
                     { limits[0], limits[1], limits[2] });
             }),
             py::keep_alive<1, 2>())
        .def("read",
             &read_groups,
             "found"_a,
             "groups"_a,
             "wanted"_a,
             "begin"_a = 0,
             "What groups say, (G,).\n\nfound: (m,) press_outcome, rows rising. groups: "
             "(G,), of\nsensor_groups. wanted: whether force and location are. begin: "
             "row, in\nfound, "
             "of the first group.");
    PYBIND11_NUMPY_DTYPE(group_reading,
                         touch,
                         force_n,
                         force_std_n,
                         location_mm,
                         location_std_mm,
                         phases_deg,
                         snr_db,
                         flags,
                         group,
                         interference,
                         psi_std_deg,
                         level,
                         clear,
                         unexplained,
                         doubtful);
    m.attr("group_reading") = py::dtype::of<group_reading>();
    m.def(
        "reading_fields",
        &fields_of,
        "readings: (G, S). sensors: their names. start_s: time at which group 0 begins.\n"
        "flag_words: gives the words of a sum of flags.\n"
        "Gives G x S tuples of the fields of a Reading.");
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
    m.attr("press_observation") = py::dtype::of<press_observation>();
    PYBIND11_NUMPY_DTYPE(sensor_group,
                         group,
                         flags,
                         snr_db,
                         interference,
                         common_variance,
                         readable,
                         overlapping,
                         disturbed);
    m.attr("sensor_group") = py::dtype::of<sensor_group>();
    py::class_<sensor_groups>(
        m,
        "sensor_groups",
        "What the stages before the press filter say of a sensor's groups.\n\nbits: of "
        "reference, gap, saturated, moved, inconsistent. claimed: probability that the\n"
        "sensor is untouched in its reference. least_snr_db: below which something is\n"
        "received on the tag's own lines, as it is where it is in_lamps.")
        .def(py::init([](double period_s,
                         const std::array<std::int64_t, 5>& bits,
                         double claimed,
                         double least_snr_db,
                         bool in_lamps) {
            return sensor_groups{ period_s, bits, claimed, least_snr_db, in_lamps };
        }))
        .def("of",
             &groups_of_sensor,
             "Observations for the filter, whose phases are NaN where a group cannot be "
             "read,\nand what else is known of the groups, (G,) each.\n\ngroups: arrays "
             "by name, as in Groups. receiver: (G, 3), of receiver_steps.");
}
