// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

namespace gr::wiforce::kernel {

// The plane of two phases, each modulo 360 deg, in square cells.
class phase_grid
{
public:
    struct place {
        std::size_t cell;
        double offset_1, offset_2; // deg from the cell's centre
    };

    // `total` is the square of the number of cells in 360 deg.
    explicit phase_grid(std::size_t total)
        : d_cells(std::llround(std::sqrt(static_cast<double>(total)))),
          d_cells_per_deg(static_cast<double>(d_cells) / 360)
    {
    }

    std::size_t total() const { return static_cast<std::size_t>(d_cells * d_cells); }

    // Phases in degrees, below 1e9.
    place locate(double psi_1, double psi_2) const
    {
        const auto first = axis(psi_1), second = axis(psi_2);
        return { static_cast<std::size_t>(first.cell * d_cells + second.cell),
                 first.offset,
                 second.offset };
    }

private:
    struct along {
        std::int64_t cell;
        double offset;
    };

    along axis(double psi) const
    {
        const double scaled = psi * d_cells_per_deg, whole = std::floor(scaled);
        const auto turned = static_cast<std::int64_t>(whole) % d_cells;
        return { turned < 0 ? turned + d_cells : turned,
                 (scaled - whole - 0.5) / d_cells_per_deg };
    }

    std::int64_t d_cells;
    double d_cells_per_deg;
};

} // namespace gr::wiforce::kernel
