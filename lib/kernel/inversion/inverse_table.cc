// SPDX-License-Identifier: GPL-3.0-or-later
#include "inverse_table.h"

#include "../require.h"
#include "hidden_force.h"

#include <algorithm>

namespace gr::wiforce::kernel {

namespace {

// Whether force cannot be told from location. The slopes of force and location by the
// phases are (a, b) and (c, d).
bool hides(double a, double b, double c, double d, double std_1, double std_2)
{
    const double spread_1 = std::max(std_1, 1.0), spread_2 = std::max(std_2, 1.0);
    const double free = a * a * spread_1 * spread_1 + b * b * spread_2 * spread_2;
    if (!(free > hidden_n * hidden_n))
        return false;
    // slopes of the phases by force are (d, -c) over the determinant
    const double determinant = a * d - b * c;
    const double by_force = d * d / (spread_1 * spread_1) + c * c / (spread_2 * spread_2);
    return free * by_force > hidden_ratio * hidden_ratio * determinant * determinant;
}

} // namespace

inverse_table::inverse_table(std::vector<row> rows, std::vector<std::int32_t> row_of)
    : d_rows(std::move(rows)), d_row_of(std::move(row_of)), d_grid(d_row_of.size())
{
    const std::string where = "inverse_table";
    require(!d_row_of.empty() && d_grid.total() == d_row_of.size(),
            where,
            "row_of",
            "must be square",
            d_row_of.size());
    const auto largest = *std::max_element(d_row_of.begin(), d_row_of.end());
    require(largest < static_cast<std::int64_t>(d_rows.size()),
            where,
            "row_of",
            "must name rows that there are",
            largest);
}

std::optional<inverse_table::reading>
inverse_table::read(double psi_1, double psi_2, double std_1, double std_2) const
{
    const auto place = d_grid.locate(psi_1, psi_2);
    const auto index = d_row_of[place.cell];
    if (index < 0)
        return std::nullopt;
    const row& r = d_rows[static_cast<std::size_t>(index)];
    if (!(std::max(std_1, std_2) <= r.trusted_deg))
        return std::nullopt;
    const double x = place.offset_1, y = place.offset_2;
    const auto step = [&](const double* slope, const double* bend) {
        return slope[0] * x + slope[1] * y + 0.5 * bend[0] * x * x + bend[1] * x * y +
               0.5 * bend[2] * y * y;
    };
    const double* const f = r.bend_force;
    const double* const g = r.bend_location;
    const double a = r.slope[0] + f[0] * x + f[1] * y,
                 b = r.slope[1] + f[1] * x + f[2] * y,
                 c = r.slope[2] + g[0] * x + g[1] * y,
                 d = r.slope[3] + g[1] * x + g[2] * y;
    const double noise_1 = std_1 * std_1 + r.variance_1,
                 noise_2 = std_2 * std_2 + r.variance_2;
    return reading{ r.force + step(r.slope, f),
                    r.location + step(r.slope + 2, g),
                    a * a * noise_1 + b * b * noise_2,
                    c * c * noise_1 + d * d * noise_2,
                    a * c * noise_1 + b * d * noise_2,
                    hides(a, b, c, d, std_1, std_2),
                    r.in_span > 0 };
}

} // namespace gr::wiforce::kernel
