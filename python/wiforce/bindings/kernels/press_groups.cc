// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/phases/sensor_groups.h>

#include <pybind11/stl.h>

#include <list>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

namespace {

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

void bind_press_groups(py::module& m)
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
             }),
             "period_s"_a,
             "bits"_a,
             "claimed"_a,
             "least_snr_db"_a = -std::numeric_limits<double>::infinity(),
             "in_lamps"_a = false)
        .def("of",
             &groups_of_sensor,
             "groups"_a,
             "sensor"_a,
             "receiver"_a,
             "Observations for the filter, whose phases are NaN where a group cannot be "
             "read,\nand what else is known of the groups, (G,) each.\n\ngroups: arrays "
             "by name, as in Groups. receiver: (G, 3), of receiver_steps.");
}
