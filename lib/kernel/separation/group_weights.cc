// SPDX-License-Identifier: GPL-3.0-or-later
#include "group_weights.h"

#include "complex_rows.h"

namespace gr::wiforce::kernel {

const std::vector<std::complex<double>>& group_weights::colorer() const
{
    const std::size_t n = tones();
    if (!d_colorer.empty() || !n)
        return d_colorer;
    // Row by row from those above: each is what the row of the whitener leaves of 1.
    d_colorer.resize(n * n);
    for (std::size_t row = 0; row < n; row++) {
        auto* const found = &d_colorer[row * n];
        found[row] = 1.0;
        for (std::size_t above = 0; above < row; above++)
            add_scaled(
                -d_whitener[row * n + above], &d_colorer[above * n], above + 1, found);
        for (std::size_t column = 0; column <= row; column++)
            found[column] /= d_whitener[row * n + row];
    }
    return d_colorer;
}

} // namespace gr::wiforce::kernel
