// SPDX-License-Identifier: GPL-3.0-or-later
#include "tabulated_model.h"

#include "../clones.h"
#include "../require.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

// Node below a coordinate, in steps of the nodes, and what remains.
struct position {
    std::size_t node;
    double rest;
};

position locate(double steps, std::size_t nodes)
{
    const double inside = std::clamp(steps, 0.0, static_cast<double>(nodes - 1));
    const auto node = std::min(static_cast<std::size_t>(inside), nodes - 2);
    return { node, inside - static_cast<double>(node) };
}

// Weights of the values and slopes at both ends of an interval.
struct hermite {
    double value[2], slope[2];
};

hermite weights(double x)
{
    const double y = 1 - x;
    return { { (1 + 2 * x) * y * y, x * x * (3 - 2 * x) }, { x * y * y, -x * x * y } };
}

hermite derivative_weights(double x)
{
    const double y = 1 - x;
    return { { -6 * x * y, 6 * x * y }, { y * (1 - 3 * x), x * (3 * x - 2) } };
}

} // namespace

tabulated_model::tabulated_model(std::vector<double> force_n,
                                 std::vector<double> location_mm,
                                 const std::vector<double>& table)
    : d_force(std::move(force_n)),
      d_location(std::move(location_mm)),
      d_phases(0),
      d_log_step(0),
      d_location_step(0)
{
    require(d_force.size() >= 2 && d_force.front() > 0 &&
                d_force.back() > d_force.front(),
            "tabulated_model: force_n must have 2 or more rising positive nodes",
            d_force.size());
    require(d_location.size() >= 2 && d_location.back() > d_location.front(),
            "tabulated_model: location_mm must have 2 or more rising nodes",
            d_location.size());
    const auto per_phase = d_force.size() * d_location.size() * columns;
    d_phases = table.size() / per_phase;
    require(d_phases >= 2 && d_phases <= most_phases &&
                table.size() == d_phases * per_phase,
            "tabulated_model: table must have 5 numbers for each of 2 to 32 phases at "
            "every node",
            table.size());
    d_log_step = std::log(d_force.back() / d_force.front()) /
                 static_cast<double>(d_force.size() - 1);
    d_location_step = (d_location.back() - d_location.front()) /
                      static_cast<double>(d_location.size() - 1);
    for (std::size_t i = 0; i < table.size(); i += columns) {
        d_phase.insert(d_phase.end(),
                       { table[i],
                         table[i + 1] * d_log_step,
                         table[i + 2] * d_location_step,
                         table[i + 3] * d_log_step * d_location_step });
        d_variance.push_back(table[i + 4]);
    }
}

double tabulated_model::steps_to(double force_n) const
{
    return std::log(force_n / d_force.front()) / d_log_step;
}

WIFORCE_CLONES
void tabulated_model::interpolate(double steps, double location_mm, values& out) const
{
    const auto along = locate(steps, d_force.size());
    const auto across =
        locate((location_mm - d_location.front()) / d_location_step, d_location.size());
    const auto u = weights(along.rest), du = derivative_weights(along.rest),
               l = weights(across.rest), dl = derivative_weights(across.rest);
    // Weights of the phase and its derivatives at each corner of the cell, for the phase
    // and for its derivatives here.
    constexpr std::size_t four = 4;
    struct {
        std::size_t node;
        double phase[four], by_force[four], by_location[four], variance;
    } corners[four];
    std::size_t count = 0;
    const std::size_t rows = along.rest > 0 ? 2 : 1; // at a node the next has no weight
    for (std::size_t i = 0; i < rows; i++)
        for (std::size_t j = 0; j < 2; j++) {
            auto& c = corners[count++];
            c.node = ((along.node + i) * d_location.size() + across.node + j) * d_phases;
            c.variance =
                (i ? along.rest : 1 - along.rest) * (j ? across.rest : 1 - across.rest);
            const double of_force[] = { u.value[i], u.slope[i] },
                         of_force_slope[] = { du.value[i], du.slope[i] },
                         of_location[] = { l.value[j], l.slope[j] },
                         of_location_slope[] = { dl.value[j], dl.slope[j] };
            for (std::size_t k = 0; k < four; k++) {
                c.phase[k] = of_force[k % 2] * of_location[k / 2];
                c.by_force[k] = of_force_slope[k % 2] * of_location[k / 2];
                c.by_location[k] = of_force[k % 2] * of_location_slope[k / 2];
            }
        }
    for (std::size_t p = 0; p < d_phases; p++) {
        double phase[four] = {}, by_force[four] = {}, by_location[four] = {},
               variance = 0;
        for (std::size_t i = 0; i < count; i++) {
            const auto& c = corners[i];
            const double* const a = &d_phase[four * (c.node + p)];
            for (std::size_t k = 0; k < four; k++) {
                phase[k] += c.phase[k] * a[k];
                by_force[k] += c.by_force[k] * a[k];
                by_location[k] += c.by_location[k] * a[k];
            }
            variance += c.variance * d_variance[c.node + p];
        }
        const auto sum = [](const double* x) { return (x[0] + x[1]) + (x[2] + x[3]); };
        out.phase[p] = sum(phase);
        out.by_log_force[p] = sum(by_force) / d_log_step;
        out.by_location[p] = sum(by_location) / d_location_step;
        out.variance[p] = variance;
    }
}

} // namespace gr::wiforce::kernel
