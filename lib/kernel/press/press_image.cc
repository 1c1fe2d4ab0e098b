// SPDX-License-Identifier: GPL-3.0-or-later
#include "press_image.h"

#include "../require.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

double wrapped(double angle) { return angle - two_pi * std::nearbyint(angle / two_pi); }

press_image::press_image(const std::vector<double>& change,
                         std::size_t forces,
                         std::size_t locations,
                         double log_step,
                         double spread)
    : d_density(cells * cells, 0.0), d_along(cells * cells, pair_of_ends{})
{
    require(forces >= 2 && locations >= 2 && change.size() == 2 * forces * locations,
            "press_image",
            "change",
            "must hold both phases of 2 forces or more at 2 locations or more",
            change.size());
    const auto at = [&](std::size_t i, std::size_t j) {
        return change.data() + 2 * (i * locations + j);
    };
    for (std::size_t i = 0; i < forces; i++) {
        const auto before = i > 0 ? i - 1 : i, after = std::min(i + 1, forces - 1);
        for (std::size_t j = 0; j < locations; j++) {
            pair_of_ends along;
            for (int e = 0; e < 2; e++)
                along[e] = wrapped(at(after, j)[e] - at(before, j)[e]) /
                           (static_cast<double>(after - before) * log_step);
            add(at(i, j), along, spread);
        }
    }
    double total = 0;
    for (const double density : d_density)
        total += density;
    const double cell = two_pi / cells;
    for (std::size_t i = 0; i < d_density.size(); i++) {
        d_density[i] /= total * cell * cell;
        auto& along = d_along[i];
        const double length = std::hypot(along[0], along[1]);
        if (length > 0)
            along = { along[0] / length, along[1] / length };
        else
            along = { std::sqrt(0.5), std::sqrt(0.5) };
    }
}

void press_image::add(const double* change, const pair_of_ends& along, double spread)
{
    const double cell = two_pi / cells, width = spread / cell;
    const auto reach = static_cast<long>(std::ceil(3 * width));
    const auto size = static_cast<long>(cells);
    const auto index = [&](long i) {
        return static_cast<std::size_t>((i % size + size) % size);
    };
    const double row = change[0] / cell, column = change[1] / cell;
    const auto first = std::lround(row), second = std::lround(column);
    for (long i = first - reach; i <= first + reach; i++)
        for (long j = second - reach; j <= second + reach; j++) {
            const double down = (static_cast<double>(i) - row) / width,
                         right = (static_cast<double>(j) - column) / width;
            const double weight = std::exp(-0.5 * (down * down + right * right));
            const auto to = index(i) * cells + index(j);
            d_density[to] += weight;
            for (int e = 0; e < 2; e++)
                d_along[to][e] += weight * along[e];
        }
}

press_image::place press_image::locate(const pair_of_ends& change)
{
    double at[2], part[2];
    for (int e = 0; e < 2; e++) {
        const double turns = change[e] / two_pi;
        const double cell = (turns - std::floor(turns)) * cells;
        at[e] = std::min(std::floor(cell), cells - 1.0);
        part[e] = cell - at[e];
    }
    return {
        static_cast<std::size_t>(at[0]), static_cast<std::size_t>(at[1]), part[0], part[1]
    };
}

double press_image::density(const pair_of_ends& change) const
{
    const auto at = locate(change);
    const auto below = (at.row + 1) % cells, beside = (at.column + 1) % cells;
    const auto row = [&](std::size_t i) {
        return (1 - at.right) * d_density[i * cells + at.column] +
               at.right * d_density[i * cells + beside];
    };
    return (1 - at.down) * row(at.row) + at.down * row(below);
}

pair_of_ends press_image::direction(const pair_of_ends& change) const
{
    const auto at = locate(change);
    pair_of_ends mean{};
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            const auto row = (at.row + i) % cells, column = (at.column + j) % cells;
            const double weight =
                (i ? at.down : 1 - at.down) * (j ? at.right : 1 - at.right);
            for (int e = 0; e < 2; e++)
                mean[e] += weight * d_along[row * cells + column][e];
        }
    const double length = std::hypot(mean[0], mean[1]);
    if (length < 0.5)
        return { std::sqrt(0.5), std::sqrt(0.5) };
    return { mean[0] / length, mean[1] / length };
}

} // namespace gr::wiforce::kernel
