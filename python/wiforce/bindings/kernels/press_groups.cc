// SPDX-License-Identifier: GPL-3.0-or-later
#include "press_groups.h"

#include <kernel/press/press_filter.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <optional>
#include <string>

namespace py = pybind11;
using gr::wiforce::kernel::press_observation;

namespace {

// R of an end that was not received is 0, and has no logarithm.
constexpr double least_ratio = std::numeric_limits<double>::min();

double squared_rad(double degrees)
{
    const double rad = degrees * (M_PI / 180);
    return rad * rad;
}

// Rows of an array of a batch, of all sensors or of groups as a whole.
template <class T>
class rows
{
public:
    rows(const py::dict& groups, const char* name, py::ssize_t count, py::ssize_t columns)
        : d_values(groups[name].cast<array<T>>()), d_columns(columns)
    {
        if (d_values.size() != count * columns)
            throw std::invalid_argument(std::string(name) + " must have " +
                                        std::to_string(count) + " x " +
                                        std::to_string(columns) + " values");
    }
    const T* operator[](py::ssize_t row) const
    {
        return d_values.data() + row * d_columns;
    }

private:
    const array<T> d_values;
    const py::ssize_t d_columns;
};

} // namespace

py::tuple groups_of_sensor(const sensor_settings& by,
                           const py::dict& groups,
                           py::ssize_t sensor,
                           const array<double>& receiver)
{
    const auto ratios = groups["ratios"].cast<complex_array>();
    if (ratios.ndim() != 2 || sensor < 0 || 2 * sensor + 1 >= ratios.shape(1))
        throw std::invalid_argument("ratios must have shape (G, 2S)");
    const py::ssize_t count = ratios.shape(0), ends = ratios.shape(1), end = 2 * sensor;
    require_shape(receiver, { count, 3 }, "receiver must have shape (G, 3)");
    const rows<std::int64_t> index(groups, "index", count, 1),
        missing(groups, "missing", count, 1);
    const rows<bool> saturated(groups, "saturated", count, 1),
        retuned(groups, "retuned", count, 1), in_tare(groups, "in_tare", count, 1),
        in_reference(groups, "in_reference", count, ends),
        late(groups, "late_reference", count, ends),
        reshaped(groups, "reshaped", count, ends),
        locked(groups, "locked", count, ends / 2),
        overlapping(groups, "overlapping", count, ends / 2);
    const rows<double> std_deg(groups, "phase_std_deg", count, ends),
        common_deg(groups, "common_std_deg", count, 1),
        interference(groups, "interference", count, 1);
    std::optional<rows<double>> snr_db;
    std::optional<rows<bool>> disturbed;
    if (groups.contains("snr_db"))
        snr_db.emplace(groups, "snr_db", count, ends);
    if (groups.contains("disturbed"))
        disturbed.emplace(groups, "disturbed", count, ends / 2);
    const auto either = [end](const bool* row) { return row[end] || row[end + 1]; };
    py::array_t<press_observation> observations(count);
    py::array_t<sensor_group> known(count);
    for (py::ssize_t row = 0; row < count; row++) {
        const std::complex<double>* const pair = ratios.data(row, end);
        const double* const std = std_deg[row] + end;
        const double* const step = receiver.data(row, 0);
        press_observation& seen = observations.mutable_data()[row] = {};
        sensor_group& of = known.mutable_data()[row];
        of.group = *index[row];
        of.interference = *interference[row];
        of.common_variance = squared_rad(*common_deg[row]);
        of.overlapping = overlapping[row][sensor];
        of.readable = locked[row][sensor] && !of.overlapping;
        of.snr_db = std::numeric_limits<double>::quiet_NaN();
        if (snr_db) {
            const double *const snr = (*snr_db)[row] + end, sum = snr[0] + snr[1];
            of.snr_db = std::isnan(sum) ? sum : std::min(snr[0], snr[1]);
        }
        of.disturbed = by.in_lamps || (disturbed && (*disturbed)[row][sensor]) ||
                       of.snr_db < by.least_snr_db;
        const bool is_late = either(late[row]), learns = either(in_reference[row]);
        const bool raised[] = { learns || *in_tare[row],
                                *missing[row] > 0,
                                *saturated[row],
                                either(reshaped[row]),
                                of.overlapping || is_late };
        of.flags = 0;
        for (std::size_t i = 0; i < by.bits.size(); i++)
            of.flags |= raised[i] ? by.bits[i] : 0;
        seen.time_s = (of.group + 0.5) * by.period_s;
        for (int e = 0; e < 2; e++) {
            seen.phase[e] = std::arg(pair[e]);
            seen.amplitude[e] = std::log(std::max(std::abs(pair[e]), least_ratio));
            seen.variance[e] = squared_rad(std[e]);
            of.readable &= pair[e] != 0.0 && std::isfinite(seen.amplitude[e]) &&
                           std::isfinite(seen.variance[e]);
        }
        seen.common_variance = of.common_variance;
        seen.receiver_phase = step[0];
        seen.receiver_amplitude = step[1];
        seen.receiver_variance = step[2];
        seen.retuned = *retuned[row];
        seen.untouched = learns && !is_late ? by.claimed : 0.0;
        if (!of.readable)
            seen.phase.fill(std::numeric_limits<double>::quiet_NaN());
    }
    return py::make_tuple(observations, known);
}
