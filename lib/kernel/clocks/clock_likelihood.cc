// SPDX-License-Identifier: GPL-3.0-or-later
#include "clock_likelihood.h"

#include "../algebra/complex_rows.h"
#include "../algebra/matrix_product.h"
#include "../clones.h"
#include "../require.h"

namespace gr::wiforce::kernel {

using complex = std::complex<double>;

clock_likelihood::clock_likelihood(std::vector<complex> derivatives,
                                   std::vector<double> lines)
    : d_derivatives(std::move(derivatives)), d_lines(std::move(lines))
{
    require(d_derivatives.size() == 6 * d_lines.size(),
            "clock_likelihood",
            "derivatives",
            "must have shape (6, " + std::to_string(d_lines.size()) + ")",
            d_derivatives.size());
}

WIFORCE_CLONES
std::array<double, 3> clock_likelihood::at(double phase,
                                           const complex* tones,
                                           const double* inverse_noise,
                                           std::size_t subcarriers) const
{
    const std::size_t lines = d_lines.size(), rows = 6; // of u, u' and u'', two each
    // Products with the real and, behind them, with the imaginary parts.
    std::vector<double> turned(2 * rows * lines), packed;
    for (std::size_t line = 0; line < lines; line++) {
        const complex turn = std::polar(1.0, -d_lines[line] * phase);
        for (std::size_t row = 0; row < rows; row++) {
            const complex value = d_derivatives[row * lines + line] * turn;
            turned[row * lines + line] = value.real();
            turned[(rows + row) * lines + line] = value.imag();
        }
    }
    std::vector<complex> sums(2 * rows * subcarriers);
    add_product({ turned.data(), lines, 1 },
                2 * rows,
                lines,
                tones,
                subcarriers,
                sums.data(),
                packed);
    for (std::size_t i = 0; i < rows * subcarriers; i++) {
        const complex by_imag = sums[rows * subcarriers + i];
        sums[i] += complex{ -by_imag.imag(), by_imag.real() };
    }
    std::array<double, 3> found{};
    for (std::size_t element = 0; element < 2; element++)
        for (std::size_t k = 0; k < subcarriers; k++) {
            const complex value = sums[element * subcarriers + k];
            const complex slope = sums[(2 + element) * subcarriers + k];
            const complex curvature = sums[(4 + element) * subcarriers + k];
            found[0] += real_product(value, value) * inverse_noise[k];
            found[1] += 2 * real_product(value, slope) * inverse_noise[k];
            found[2] += 2 *
                        (real_product(value, curvature) + real_product(slope, slope)) *
                        inverse_noise[k];
        }
    return found;
}

} // namespace gr::wiforce::kernel
