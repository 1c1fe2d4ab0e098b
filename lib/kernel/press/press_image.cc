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
                         double spread)
    : d_density(cells * cells, 0.0), d_along(cells * cells, pair_of_ends{})
{
    require(forces >= 2 && locations >= 2 && change.size() == 2 * forces * locations,
            "press_image: change must hold both phases of 2 forces or more at 2 "
            "locations or more",
            change.size());
    const auto at = [&](std::size_t i, std::size_t j) {
        return change.data() + 2 * (i * locations + j);
    };
    for (std::size_t i = 0; i < forces; i++) {
        const auto before = i > 0 ? i - 1 : i, after = std::min(i + 1, forces - 1);
        for (std::size_t j = 0; j < locations; j++) {
            pair_of_ends along;
            for (int e = 0; e < 2; e++)
                along[e] = wrapped(at(after, j)[e] - at(before, j)[e]);
            const double length = std::hypot(along[0], along[1]);
            for (double& part : along)
                part = length > 0 ? part / length : 0;
            add(at(i, j), along, spread);
        }
    }
    double total = 0;
    for (const double density : d_density)
        total += density;
    const double cell = two_pi / cells;
    for (std::size_t i = 0; i < d_density.size(); i++) {
        for (double* each : { &d_density[i], &d_along[i][0], &d_along[i][1] })
            *each /= total * cell * cell;
        d_largest = std::max(d_largest, d_density[i]);
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
    const auto weight_of = [width](long i, double centre) {
        const double away = (static_cast<double>(i) - centre) / width;
        return std::exp(-0.5 * away * away);
    };
    std::vector<double> right;
    for (long j = second - reach; j <= second + reach; j++)
        right.push_back(weight_of(j, column));
    for (long i = first - reach; i <= first + reach; i++) {
        const double down = weight_of(i, row);
        for (long j = second - reach; j <= second + reach; j++) {
            const double weight =
                down * right[static_cast<std::size_t>(j - second + reach)];
            const auto to = index(i) * cells + index(j);
            d_density[to] += weight;
            for (int e = 0; e < 2; e++)
                d_along[to][e] += weight * along[e];
        }
    }
}

std::array<press_image::corner, 4> press_image::around(const pair_of_ends& change)
{
    std::size_t at[2][2];
    double part[2];
    for (int e = 0; e < 2; e++) {
        const double turns = change[e] / two_pi;
        const double cell = (turns - std::floor(turns)) * cells;
        const double first = std::min(std::floor(cell), cells - 1.0);
        at[e][0] = static_cast<std::size_t>(first);
        at[e][1] = (at[e][0] + 1) % cells;
        part[e] = cell - first;
    }
    std::array<corner, 4> found;
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            found[2 * i + j] = { at[0][i] * cells + at[1][j],
                                 (i ? part[0] : 1 - part[0]) *
                                     (j ? part[1] : 1 - part[1]) };
    return found;
}

double press_image::density(const pair_of_ends& change) const
{
    double sum = 0;
    for (const auto& [cell, share] : around(change))
        sum += share * d_density[cell];
    return sum;
}

press_image::heading press_image::direction(const pair_of_ends& change) const
{
    pair_of_ends sum{};
    double all = 0;
    for (const auto& [cell, share] : around(change)) {
        all += share * d_density[cell];
        for (int e = 0; e < 2; e++)
            sum[e] += share * d_along[cell][e];
    }
    const double length2 = sum[0] * sum[0] + sum[1] * sum[1],
                 variance = -std::log(length2 / (all * all)), length = std::sqrt(length2);
    if (!(variance < 1))
        return {};
    return { { sum[0] / length, sum[1] / length }, std::max(variance, 0.0) };
}

} // namespace gr::wiforce::kernel
